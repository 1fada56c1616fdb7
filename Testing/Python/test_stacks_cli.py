"""Further stacks on the command line: ``fit --also``, configurations, the report; the phantom in three directions."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk
from dicom_files import single, write_series
from quick_fits import without_shapes
from small_phantom import CENTER, SEED
from stack_phantom import MOTION, dented, stack_of

from VICRegistrationLib import cli
from VICRegistrationLib.cli.configuration import organ_request
from VICRegistrationLib.cli.fitting import fit_to_folder
from VICRegistrationLib.cli.organ_entries import organ_entry, restored_organ
from VICRegistrationLib.cli.stack_entries import restored_stack, stack_place
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image, write_image
from VICRegistrationLib.phantoms.stacks import further_stacks, write_stacks

pytestmark = pytest.mark.usefixtures("grown_regions")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A sagittal and an axial stack of one organ, and one of noise."""
    folder = tmp_path_factory.mktemp("stacks")
    axial = stack_of(dented(), "axial", motion=MOTION, seed=2)
    noise = np.random.default_rng(3).normal(200.0, 80.0, axial.array.shape)
    write_image(stack_of(dented(), "sagittal"), folder / "sag.nii.gz")
    write_image(axial, folder / "ax.nii.gz")
    write_image(Image(noise.astype(np.float32), axial.ijk_to_ras), folder / "noise.nii.gz")
    return folder


def fit(folder, *words):
    return cli.main(["fit", str(folder / "sag.nii.gz"), "--quiet", "--net", "9x7", *map(str, words)])


def stacks_of(output, organ="bladder"):
    return json.loads((output / "report.json").read_text())["organs"][organ]["stacks"]


@pytest.fixture(scope="module")
def output(folder, small_pictures, tmp_path_factory):
    """Results with a stack that is used and one that is left out."""
    output = tmp_path_factory.mktemp("out")
    also = ["--also", folder / "ax.nii.gz", "--also", folder / "noise.nii.gz"]
    with pytest.MonkeyPatch.context() as patch:
        without_shapes(patch)
        assert fit(folder, *also, "--organ", "bladder", "--seed", SEED, "--output", output) == 0
    return output


def test_the_report_shows_what_became_of_each_stack(folder, output):
    used, noise = stacks_of(output)
    assert (used["file"], used["used"], used["reason"]) == (str(folder / "ax.nii.gz"), True, None)
    assert used["translation_mm"] == pytest.approx([2.0, -1.5, 1.5], abs=0.4)
    assert 0.0 < used["translation_sd_mm"] < 0.2
    assert 0.0 < used["rotation_sd_degrees"] < 2.0
    assert used["share_of_area_seen"] == pytest.approx(1.0)
    assert used["cost"] < 0.1
    assert not noise["used"]
    assert (noise["translation_sd_mm"], noise["rotation_sd_degrees"]) == (None, None)
    assert noise["reason"]["sentence"].startswith("Wherever the stack is moved, it shows no edge")


def test_the_page_shows_the_contour_in_the_stack_that_was_used(folder, output):
    page = (output / "report.html").read_text(encoding="utf-8")
    assert "Further stacks" in page
    assert page.count("in its own plane") == 1
    assert page.count(" ± ") >= 2
    assert "Wherever the stack is moved, it shows no edge" in page


def test_an_organ_is_added_beside_one_with_stacks_and_keeps_them(folder, output):
    before = stacks_of(output)
    assert fit(folder, "--organ", "second", "--seed", SEED, "--output", output) == 0
    assert stacks_of(output) == before
    assert "stacks" not in json.loads((output / "report.json").read_text())["organs"]["second"]
    assert (output / "report.html").read_text(encoding="utf-8").count("in its own plane") == 1


def test_a_region_that_was_completed_from_a_stack_comes_back(folder, tmp_path):
    sagittal = read_image(folder / "sag.nii.gz")
    # It ends 5 mm beside the organ's centre.
    image = sagittal.crop((0, 0, 0), (10, *sagittal.array.shape[1:]))
    write_image(image, tmp_path / "cut.nii.gz")
    requests = [organ_request("bladder", [CENTER], also=[str(folder / "ax.nii.gz")], net=(9, 7))]
    (organ,) = fit_to_folder(tmp_path / "cut.nii.gz", requests, tmp_path / "out", pictures=False).organs
    assert organ.fit.whole_region.volume_ml > 1.1 * organ.fit.region.volume_ml
    back = restored_organ("bladder", json.loads(json.dumps(organ_entry(organ))), tmp_path / "out", image)
    np.testing.assert_array_equal(back.fit.whole_region.mask, organ.fit.whole_region.mask)
    np.testing.assert_allclose(back.fit.whole_region.ijk_to_ras, organ.fit.whole_region.ijk_to_ras, atol=1e-6)
    assert organ_entry(back) == organ_entry(organ)


@pytest.mark.parametrize("place", ["beside the organs", "in an organ"])
def test_a_configuration_names_stacks_relative_to_it(folder, tmp_path, place):
    (tmp_path / "ax.nii.gz").write_bytes((folder / "ax.nii.gz").read_bytes())
    organ = {"organ": "bladder", "seed": [float(x) for x in SEED.split(",")]}
    content = {"schema": "vic-registration/organs", "version": 1, "organs": [organ]}
    (content if place == "beside the organs" else organ)["also"] = ["ax.nii.gz"]
    (tmp_path / "organs.json").write_text(json.dumps(content))
    words = ["--config", tmp_path / "organs.json", "--no-pictures", "--output", tmp_path / "out"]
    assert fit(folder, *words) == 0
    (stack,) = stacks_of(tmp_path / "out")
    assert (stack["file"], stack["used"]) == (str(tmp_path / "ax.nii.gz"), True)


@pytest.mark.parametrize("also", ["ax.nii.gz", [3], [""]])
def test_a_list_of_stacks_that_is_none_is_refused(folder, tmp_path, capsys, also):
    organ = {"organ": "bladder", "seed": [[0, 0, 0]]}
    content = {"schema": "vic-registration/organs", "version": 1, "organs": [organ], "also": also}
    (tmp_path / "organs.json").write_text(json.dumps(content))
    assert fit(folder, "--config", tmp_path / "organs.json", "--output", tmp_path / "out") == 2
    assert "key 'also'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["missing", "flat", "four"])
def test_a_stack_that_is_no_volume_is_one_sentence(folder, tmp_path, capsys, kind):
    path = tmp_path / "other.nii.gz"
    if kind != "missing":
        shape = (40, 40) if kind == "flat" else (3, 5, 40, 40)
        sitk.WriteImage(sitk.GetImageFromArray(np.zeros(shape, dtype=np.float32), isVector=False), str(path))
    words = ["--also", path, "--organ", "bladder", "--seed", SEED, "--no-pictures", "--output", tmp_path / "out"]
    assert fit(folder, *words) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "other.nii.gz" in line
    assert (f"Choose it with --also {path}@N" in line) == (kind == "four")
    assert "--frame" not in line
    assert not (tmp_path / "out").exists()


def test_one_of_several_series_is_chosen_behind_an_at_sign(folder, tmp_path, capsys):
    study, axial = tmp_path / "study", read_image(folder / "ax.nii.gz")
    datasets = [
        single(axial.to_ras([[0, 0, k]])[0] * [-1, -1, 1], series=f"1.2.{number}", SeriesNumber=number)
        for number in (7, 8)
        for k in range(3)
    ]
    write_series(study, datasets)
    words = ["--organ", "bladder", "--seed", SEED, "--no-pictures", "--output", tmp_path / "out"]
    assert fit(folder, "--also", study, *words) == 2
    assert f"Choose it with --also {study}@N, N the number of the series." in capsys.readouterr().err
    assert fit(folder, "--also", f"{study}@9", *words) == 2
    assert "none of them match '9'" in capsys.readouterr().err
    assert fit(folder, "--also", f"{study}@8", *words) == 0
    (stack,) = stacks_of(tmp_path / "out")
    assert stack["file"] == f"{study}@8"
    assert restored_stack(stack).image.array.shape[0] == 3


def test_one_of_several_volumes_is_chosen_behind_an_at_sign(folder, tmp_path, capsys):
    axial, path = read_image(folder / "ax.nii.gz"), tmp_path / "two.nii.gz"
    image = sitk.JoinSeries(
        [sitk.ReadImage(str(folder / f"{name}.nii.gz"), sitk.sitkFloat32) for name in ("noise", "ax")]
    )
    sitk.WriteImage(image, str(path))
    place, choice = stack_place(f"{path}@2")
    assert np.array_equal(read_image(place, **choice).array, axial.array)
    words = ["--organ", "bladder", "--seed", SEED, "--no-pictures", "--output", tmp_path / "out"]
    assert fit(folder, "--also", f"{path}@second", *words) == 2
    assert "after a file and @ the number of a volume is needed" in capsys.readouterr().err


def test_a_name_with_an_at_sign_is_a_name(tmp_path):
    (tmp_path / "mri@2").mkdir()
    assert stack_place(str(tmp_path / "mri@2")) == (str(tmp_path / "mri@2"), {})
    assert stack_place("missing@2") == ("missing@2", {})


def test_the_stacks_of_the_phantom_are_moved_as_far_as_asked_and_the_truth_is_written(tmp_path):
    small = {"spacing": (3.0, 3.0, 6.0), "size": (80, 80), "n_slices": 30}
    stacks = further_stacks(2, shift_mm=3.0, turn_degrees=2.0, **small)
    assert write_stacks(stacks, tmp_path) == ["mri_axial.nii.gz", "mri_coronal.nii.gz"]
    motions = json.loads((tmp_path / "truth" / "motion.json").read_text())
    for stack, motion in zip(stacks, motions.values()):
        assert np.array_equal(motion, stack.motion)
        assert np.degrees(np.arccos((np.trace(stack.motion[:3, :3]) - 1.0) / 2.0)) == pytest.approx(2.0)
    thick = [int(np.abs(stack.image.ijk_to_ras[:3, 2]).argmax()) for stack in stacks]
    assert thick == [2, 1]


@pytest.mark.parametrize(
    ("words", "needed"),
    [(["--motion", "3,2"], "--stacks 2 or 3"), (["--stacks", "3", "--motion", "3"], "such as 3,2")],
)
def test_a_motion_that_makes_no_sense_is_refused(tmp_path, capsys, words, needed):
    try:
        code = cli.main(["phantom", str(tmp_path / "phantom"), *words])
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert needed in capsys.readouterr().err
    assert not (tmp_path / "phantom").exists()
