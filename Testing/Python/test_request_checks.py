"""Requests that an image cannot meet are refused before the first fit, and what was meant is told."""

from __future__ import annotations

import json

import numpy as np
import pytest
from reorientation import motion
from small_phantom import CENTER, SEED, ellipsoid_image

from VICRegistrationLib import cli
from VICRegistrationLib.cli import fitting
from VICRegistrationLib.cli.configuration import organ_request
from VICRegistrationLib.cli.request_checks import check_request
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.segmentation.separation import separate


@pytest.fixture(scope="module")
def image():
    """A volume of 40 x 60 x 80 mm whose RAS coordinates are all 100 to 180."""
    matrix = np.array([[-2.0, 0, 0, 140], [0, 0, 2.0, 100], [0, -2.0, 0, 180], [0, 0, 0, 1]])
    return Image(np.arange(40 * 40 * 20, dtype=np.int16).reshape(40, 40, 20), matrix)


def complaint(image, seeds, **options):
    with pytest.raises(ValueError, match="lies outside the volume") as caught:
        check_request(image, organ_request("bladder", seeds, **options))
    return str(caught.value)


def test_what_lies_inside_is_accepted(image):
    check_request(image, organ_request("bladder", [(120, 110, 120), (139, 178, 179)], threshold=(5, 10)))


def test_lps_coordinates_are_recognised(image):
    told = complaint(image, [(-120, -110, 120), (-125.5, -130.25, 140)])
    assert "Taken as LPS coordinates (of DICOM, ITK and ITK-SNAP), all of them would lie inside" in told
    assert "in RAS mm, give --seed=120,110,120 --seed=125.5,130.25,140 (in a configuration" in told
    assert '"seed": [[120, 110, 120], [125.5, 130.25, 140]])' in told
    assert "voxel indices" not in told


def test_voxel_indices_are_recognised(image):
    told = complaint(image, [(5, 10, 30)])
    assert "Taken as voxel indices i,j,k, it would lie inside: in RAS mm, give --seed=130,160,160 (in a" in told
    check_request(image, organ_request("bladder", [(130, 160, 160)]))
    assert "LPS" not in told


@pytest.mark.parametrize("seed", [(5, 10, 40), (5.5, 10, 30), (-5, 10, 30), (500, 0, 0), (1e308, -1e308, 1e308)])
def test_other_places_are_told_without_a_guess(image, seed):
    told = complaint(image, [seed])
    assert "R 101.0 to 141.0, A 99.0 to 179.0, S 101.0 to 181.0 mm" in told
    assert told.endswith("Give RAS coordinates in mm, as Slicer shows them for the mouse pointer.")


def test_a_place_within_the_bounds_of_an_oblique_volume_is_not_told_to_be_within_the_volume(image):
    oblique = Image(image.array, motion(45.0, (0.0, 0.0, 1.0)) @ image.ijk_to_ras)
    beside = oblique.to_ras([-10.5, 0.0, 20.0])
    told = complaint(oblique, [beside])
    assert "(R -55.2 to 29.7, A 141.4 to 226.3, S 101.0 to 181.0 mm, but oblique: its nearest voxel is 20.0 mm" in told
    with pytest.raises(ValueError, match="but oblique: its nearest voxel is 20.0 mm away"):
        separate(oblique, beside)


def test_nothing_is_guessed_if_it_holds_for_some_seeds_only(image):
    assert "Taken as" not in complaint(image, [(120, 110, 120), (-120, -110, 120)])


def test_boundary_points_may_lie_beside_the_volume_but_not_elsewhere(image):
    check_request(image, organ_request("bladder", [(120, 110, 120)], boundary=[(75, 110, 120)]))
    told = complaint(image, [(120, 110, 120)], boundary=[(-120, -110, 120)])
    assert "boundary point (-120.0, -110.0, 120.0) mm" in told
    assert "--boundary=120,110,120" in told


def test_a_threshold_that_holds_no_voxel_is_refused(image):
    with pytest.raises(ValueError, match="threshold 40000 to 50000 contains no voxel: .* go from 0 to 31999"):
        check_request(image, organ_request("bladder", [(120, 110, 120)], threshold=(4e4, 5e4)))


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        ({"seed": [500, 0, 0]}, "lies outside the volume"),
        ({"threshold": [5000, 6000]}, "contains no voxel"),
        ({"threshold": [600, 700]}, "outside the threshold"),
        ({"seed": [-12, 8, 6], "threshold": [600, 1000]}, "outside the threshold"),
        ({"erosion": 19}, "erosion of 19 mm leaves nothing"),
    ],
)
def test_the_last_organ_is_checked_before_the_first_is_fitted(tmp_path, capsys, monkeypatch, bad, told):
    def never(*arguments, **options):
        pytest.fail("the first organ must not be fitted")

    monkeypatch.setattr(fitting, "fit_region", never)
    write_image(ellipsoid_image(), tmp_path / "mri.nrrd")
    organs = [{"organ": "bladder", "seed": CENTER.tolist()}, {"organ": "rectum", "seed": CENTER.tolist(), **bad}]
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (tmp_path / "organs.json").write_text(json.dumps(content))
    words = ["fit", tmp_path / "mri.nrrd", "--config", tmp_path / "organs.json", "--output", tmp_path / "out"]
    assert cli.main([*map(str, words), "--no-pictures", "--quiet"]) == 2
    line = capsys.readouterr().err
    assert "rectum: " in line
    assert told in line
    assert not (tmp_path / "out").exists()


def test_all_bad_organs_are_told_at_once(tmp_path, capsys):
    write_image(ellipsoid_image(), tmp_path / "mri.nrrd")
    organs = [{"organ": name, "seed": [place, 0, 0]} for name, place in (("one", 500), ("two", 600))]
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (tmp_path / "organs.json").write_text(json.dumps(content))
    words = ["fit", tmp_path / "mri.nrrd", "--config", tmp_path / "organs.json", "--output", tmp_path / "out"]
    assert cli.main([*map(str, words), "--no-pictures", "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "one: The seed (500.0" in line
    assert "two: The seed (600.0" in line


def test_a_missing_reference_is_told_before_the_image_is_read(tmp_path, capsys):
    words = ["fit", tmp_path / "none.nrrd", "--organ", "b", "--seed", SEED, "--output", tmp_path / "out"]
    assert cli.main([*map(str, words), "--reference", str(tmp_path / "none.nii.gz")]) == 2
    line = capsys.readouterr().err
    assert "none.nii.gz" in line
    assert "none.nrrd" not in line
