"""Fits that start from labels in place of seeds: ``vic-registration fit --region``."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from small_phantom import CENTER, SEED, ellipsoid, ellipsoid_image

from VICRegistrationLib import cli
from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image, write_image


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An image, and a label map of voxels of 3 mm in which the organ is 5 and something beside it 2."""
    folder = tmp_path_factory.mktemp("region")
    write_image(ellipsoid_image(), folder / "mri.nii.gz")
    matrix = np.diag([3.0, 3.0, 3.0, 1.0])
    matrix[:3, 3] = np.asarray(CENTER) - 36.0
    k, j, i = np.indices((25, 25, 25)) - 12.0
    labels = np.where((i / 14.0) ** 2 + (j / 18.0) ** 2 + (k / 22.0) ** 2 <= 1.0 / 9.0, 5, 0).astype(np.uint8)
    labels[0, 0, :3] = 2
    write_image(Image(labels, matrix), folder / "labels.nii.gz")
    return folder


def fit(folder, *words):
    return cli.main(["fit", str(folder / "mri.nii.gz"), "--no-pictures", "--quiet", *map(str, words)])


def test_a_label_is_enough_to_start_from(folder, tmp_path):
    words = ["--organ", "bladder", "--region", folder / "labels.nii.gz", "--label", "5", "--output", tmp_path / "out"]
    assert fit(folder, *words) == 0
    assert deviation(read_surface(tmp_path / "out" / "bladder.json"), ellipsoid(), n_points=1000).mean < 0.3
    entry = json.loads((tmp_path / "out" / "report.json").read_text())["organs"]["bladder"]
    assert (entry["seed"], entry["threshold"], entry["erosion"]) == ([], None, None)


def test_a_configuration_names_labels_beside_it_and_seeds(folder, tmp_path):
    (tmp_path / "labels.nii.gz").write_bytes((folder / "labels.nii.gz").read_bytes())
    organs = [{"organ": "a", "region": "labels.nii.gz", "label": 5}, {"organ": "b", "seed": SEED.split(",")}]
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (tmp_path / "organs.json").write_text(json.dumps(content))
    assert fit(folder, "--config", tmp_path / "organs.json", "--output", tmp_path / "out") == 0
    first, second = (read_surface(tmp_path / "out" / f"{name}.json") for name in "ab")
    assert deviation(first, second, n_points=1000).mean < 0.1


def test_seeds_of_an_organ_count_before_a_region_for_all_organs(folder, tmp_path):
    organs = [{"organ": "a"}, {"organ": "b", "seed": SEED.split(",")}]
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    (tmp_path / "organs.json").write_text(json.dumps(content))
    words = ["--region", folder / "labels.nii.gz", "--label", "5", "--output", tmp_path / "out"]
    assert fit(folder, "--config", tmp_path / "organs.json", *words) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())["organs"]
    assert [report[name]["threshold"] is None for name in "ab"] == [True, False]


@pytest.mark.parametrize(
    ("words", "needed"),
    [
        (["--label", "5", "--threshold", "1,2"], "taken as it is"),
        (["--label", "5", "--seed", SEED], "its seed was given too"),
        (["--label", "7"], "holds no label 7"),
        ([], "choose one with --label"),
    ],
)
def test_what_cannot_be_met_is_told(folder, tmp_path, capsys, words, needed):
    region = ["--organ", "bladder", "--region", folder / "labels.nii.gz", "--output", tmp_path / "out"]
    assert fit(folder, *region, *words) == 2
    assert needed in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_mesh_is_no_region(folder, tmp_path, capsys):
    words = ["--organ", "bladder", "--region", tmp_path / "bladder.stl", "--output", tmp_path / "out"]
    assert fit(folder, *words) == 2
    assert "bladder.stl is a mesh or a surface, but a region is a label image" in capsys.readouterr().err


def test_what_a_label_leaves_open_is_a_warning_of_the_command(folder, tmp_path, capsys):
    label = read_image(folder / "labels.nii.gz")
    path = tmp_path / "labels.nii"
    write_image(label, path)
    content = bytearray(path.read_bytes())
    # Its pixdim, which is not what its sform says.
    content[80:84] = struct.pack("<f", 1.0)
    path.write_bytes(content)
    words = ["--organ", "bladder", "--region", path, "--label", "5", "--output", tmp_path / "out"]
    assert fit(folder, *words) == 0
    assert f"bladder: warning: {path}: its sform has voxels of 3 x 3 x 3 mm, its pixdim says" in capsys.readouterr().err
