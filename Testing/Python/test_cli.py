"""``vic-registration fit`` and its files."""

from __future__ import annotations

import csv
import gzip
import json
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from small_phantom import CENTER, SEED, ellipsoid, ellipsoid_image

from VICRegistrationLib import __version__, cli
from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.cli.arguments import parsed_arguments
from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.geometry.surface_file import read_surface_record
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "small_pictures")

ELLIPSOID_ML = 4.0 / 3.0 * np.pi * 14.0 * 18.0 * 22.0 / 1000.0


@pytest.fixture
def config(tmp_path):
    """Write a configuration of the given organs."""

    def write(*organs, **content):
        path = tmp_path / "organs.json"
        path.write_text(json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": organs, **content}))
        return path

    return write


def fit(*words):
    return cli.main(["fit", *map(str, words)])


@pytest.fixture(scope="module")
def fitted(image_path, tmp_path_factory, small_pictures):
    """Folder of a fit from flags."""
    folder = tmp_path_factory.mktemp("fit") / "out"
    assert fit(image_path, "--organ", "bladder", "--seed", SEED, "--output", folder, "--quiet") == 0
    return folder


@pytest.fixture(scope="module")
def report(fitted):
    return json.loads((fitted / "report.json").read_text())


def test_every_file_of_the_organ_is_there(fitted, report):
    expected = ["bladder.json", "bladder.png", "bladder.stl", "bladder.vtp", "bladder_convergence.csv"]
    assert sorted(path.name for path in fitted.iterdir()) == [*expected, "report.html", "report.json"]
    assert sorted(report["organs"]["bladder"]["files"]) == expected


def test_the_surface_is_that_of_the_organ(fitted):
    record = read_surface_record(fitted / "bladder.json")
    assert (record.name, record.closure) == ("bladder", "smooth")
    found = deviation(record.surface, ellipsoid(), n_points=2000)
    # Slices of 3 mm and noise; it is 0.07 mm.
    assert found.mean < 0.15
    assert abs(found.mean_signed) < 0.1


def test_the_vtp_file_holds_the_same_surface(fitted):
    record = read_surface_record(fitted / "bladder.json")
    np.testing.assert_array_equal(
        read_vtp_record(fitted / "bladder.vtp").surface.control_net, record.surface.control_net
    )


def test_the_report_shows_what_was_found(fitted, report, image_path):
    assert (report["schema"], report["version"]) == ("vic-registration/report", 2)
    assert report["image"] == str(image_path)
    organ = report["organs"]["bladder"]
    surface = read_surface_record(fitted / "bladder.json").surface
    assert organ["volume_ml"] == pytest.approx(surface.volume() / 1000.0)
    assert organ["volume_ml"] == pytest.approx(ELLIPSOID_ML, rel=0.02)
    assert organ["separated_volume_ml"] == pytest.approx(ELLIPSOID_ML, rel=0.05)
    assert organ["area_mm2"] == pytest.approx(surface.area())
    # Squared residuals over the squared contrast: the noise alone is 10 of 700 grey levels.
    assert 0.0 < organ["cost_final"] < 0.05
    assert organ["seconds"] > organ["seconds_separation"] > 0.0
    assert organ["seconds_load"] > 0.0
    assert organ["net"] == read_surface_record(fitted / "bladder.json").net
    assert organ["net"] in ("9x7", "17x11")
    assert organ["seed"] == [list(CENTER)]
    low, high = organ["threshold"]
    assert low < 800.0 < high
    assert organ["converged"] is True
    assert organ["stopped_by"] in ("displacement", "parameters", "cost")
    assert organ["valid"] is True
    assert organ["touches_border"] == []
    assert organ["warnings"] == []


def test_the_convergence_has_a_row_for_every_iteration(fitted, report):
    with (fitted / "bladder_convergence.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    organ = report["organs"]["bladder"]
    assert len(rows) == organ["iterations"]
    assert [int(row["iteration"]) for row in rows] == list(range(1, len(rows) + 1))
    assert float(rows[-1]["cost"]) == organ["cost_final"]
    assert rows[-1]["converged"] == "true"
    last_stage = [row for row in rows if row["stage"] == rows[-1]["stage"]]
    assert last_stage[0]["stage_iteration"] == "1"
    # The first cost is that of the model as placed, which no row has; the fit must be better than it.
    assert organ["cost_initial"] > organ["cost_final"]


def test_there_is_a_line_of_progress_for_every_stage(image_path, tmp_path, capsys):
    words = (image_path, "--organ", "bladder", "--seed", SEED, "--output", tmp_path / "out", "--no-pictures")
    assert fit(*words) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    with (tmp_path / "out" / "bladder_convergence.csv").open(newline="") as file:
        stages = list(dict.fromkeys(row["stage"] for row in csv.DictReader(file)))
    # That is a choice, nothing is computed in it.
    stages = [stage for stage in stages if stage != "coarser net kept"]
    told = [line for line in lines if re.search(r"bladder: .*, \d+ iterations, cost \S+ -> \S+, \d+\.\d+ s", line)]
    assert len(told) == len(stages)
    assert all(stage in line for stage, line in zip(stages, told))
    assert "separation" in lines[1]


def test_quiet_is_quiet_and_pictures_can_be_left_out(image_path, tmp_path, capsys):
    words = (image_path, "--organ", "bladder", "--seed", SEED, "--output", tmp_path / "out")
    assert fit(*words, "--no-pictures", "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert not (tmp_path / "out" / "bladder.png").exists()


def test_options_reach_the_fit(image_path, tmp_path):
    words = (image_path, "--organ", "b", "--seed", SEED, "--seed", "-12,10,-22", "--output", tmp_path, "--no-pictures")
    options = ("--threshold", "450,1200", "--erosion", "1.5", "--net", "11x8", "--closure", "paper", "--tau", "3")
    assert fit(*words, *options, "--smoothness", "0", "--quiet") == 0
    organ = json.loads((tmp_path / "report.json").read_text())["organs"]["b"]
    assert organ["threshold"] == [450.0, 1200.0]
    assert organ["erosion"] == 1.5
    assert organ["net"] == "11x8"
    assert organ["options"]["closure"] == "paper"
    assert (organ["options"]["tau"], organ["options"]["smoothness"]) == (3.0, 0.0)
    assert [choice["value"] for choice in organ["choices"]] == ["11x8", "3.00 mm", "0"]
    assert {reason["code"] for choice in organ["choices"] for reason in choice["reasons"]} == {"option_given"}
    assert len(organ["seed"]) == 2
    assert read_surface_record(tmp_path / "b.json").surface.control_net.shape[:2] == (11, 8)


def test_what_was_chosen_is_in_the_report_with_its_reason(report):
    organ = report["organs"]["bladder"]
    chosen = {choice["option"]: (choice["value"], choice["reasons"]) for choice in organ["choices"]}
    assert list(chosen) == ["net", "tau", "smoothness"]
    assert (chosen["net"][0], chosen["tau"][0]) == (organ["net"], f"{organ['options']['tau']:.2f} mm")
    assert chosen["smoothness"][0] == f"{organ['options']['smoothness']:.2g}"
    assert "noise explains" in chosen["net"][1][0]["sentence"]
    assert chosen["tau"][1][0]["values"]["pixels"] == pytest.approx(organ["options"]["tau"] / 1.2, abs=1.0)


def test_boundary_points_and_a_dilation_reach_the_fit(image_path, tmp_path, capsys):
    # The organ's wall lies 14 mm to the right of its centre.
    words = ("--boundary", f"{CENTER[0] + 18.0},8,-20", "--boundary=-12,8,3", "--erosion", "2", "--dilation", "1.2")
    common = ("--organ", "b", "--seed", SEED, "--output", tmp_path, "--no-pictures")
    assert fit(image_path, *common, *words) == 0
    assert "b: 2 boundary points, up to 0." in capsys.readouterr().err
    organ = json.loads((tmp_path / "report.json").read_text())["organs"]["b"]
    assert organ["boundary"] == [[6.0, 8.0, -20.0], [-12.0, 8.0, 3.0]]
    np.testing.assert_allclose(organ["boundary_deviation_mm"], 0.0, atol=0.2)
    assert organ["options"]["dilation"] == 1.2
    assert organ["separated_volume_ml"] < 0.98 * ELLIPSOID_ML
    record = read_surface_record(tmp_path / "b.json")
    assert organ["net"] == record.net != "9x7"
    net = next(choice for choice in organ["choices"] if choice["option"] == "net")
    assert net["value"] == record.net
    assert net["reasons"][-1]["code"] == "made_finer"
    with (tmp_path / "b_convergence.csv").open(newline="") as file:
        assert [row["stage"] for row in csv.DictReader(file)][-1] == "boundary points"


def test_without_boundary_points_the_report_has_none(report):
    assert not [key for key in report["organs"]["bladder"] if "boundary" in key]


def test_boundary_points_and_a_dilation_come_from_a_configuration(image_path, tmp_path, config):
    path = config(
        {"organ": "one", "seed": CENTER.tolist(), "boundary": [4.0, 8.0, -20.0], "dilation": 1},
        {"organ": "two", "seed": CENTER.tolist(), "boundary": [[4.0, 8.0, -20.0], [-12.0, 8.0, 4.0]]},
    )
    assert fit(image_path, "--config", path, "--dilation", "3", "--output", tmp_path, "--no-pictures", "--quiet") == 0
    organs = json.loads((tmp_path / "report.json").read_text())["organs"]
    assert {name: len(organ["boundary_deviation_mm"]) for name, organ in organs.items()} == {"one": 1, "two": 2}
    assert {name: organ["options"]["dilation"] for name, organ in organs.items()} == {"one": 1.0, "two": 3.0}


def test_several_organs_come_from_a_configuration(image_path, tmp_path, config):
    path = config(
        {"organ": "one", "seed": CENTER.tolist()},
        {"organ": "two", "seed": [CENTER.tolist()], "threshold": [450, 1200], "net": "7x6", "smoothness": 1e-4},
    )
    words = ("--config", path, "--net", "8x7", "--output", tmp_path / "out", "--no-pictures", "--quiet")
    assert fit(image_path, *words) == 0
    organs = json.loads((tmp_path / "out" / "report.json").read_text())["organs"]
    assert {name: organ["net"] for name, organ in organs.items()} == {"one": "8x7", "two": "7x6"}
    assert organs["two"]["threshold"] == [450.0, 1200.0]
    assert organs["two"]["options"]["smoothness"] == 1e-4


def test_a_darker_organ_is_fitted_too(tmp_path):
    write_image(ellipsoid_image(level=20.0, wall=300.0), tmp_path / "mri.nrrd")
    words = (
        "--organ",
        "b",
        "--seed",
        SEED,
        "--threshold",
        "-100,160",
        "--output",
        tmp_path,
        "--no-pictures",
        "--quiet",
    )
    assert fit(tmp_path / "mri.nrrd", *words) == 0
    volume = json.loads((tmp_path / "report.json").read_text())["organs"]["b"]["volume_ml"]
    assert volume == pytest.approx(ELLIPSOID_ML, rel=0.03)


@pytest.mark.parametrize(
    "words", [["--seed", "-3,10,5"], ["--seed=-3,10,5"], ["--seed", "-3, 10, 5"], ["--seed", "-.3e1,10,5"]]
)
def test_a_seed_may_begin_with_a_minus_sign(words):
    boundary = ["--boundary", "-1,2,3"]
    options = parsed_arguments(["fit", "image.nii", "--organ", "b", *words, "--threshold", "-5,7", *boundary])
    assert options.boundary == [(-1.0, 2.0, 3.0)]
    assert options.seed == [(-3.0, 10.0, 5.0)]
    assert options.threshold == (-5.0, 7.0)


@pytest.mark.usefixtures("one_net")
def test_what_the_file_contradicts_itself_in_is_told_everywhere(image_path, tmp_path, capsys):
    path, out = tmp_path / "mri.nii", tmp_path / "out"
    content = bytearray(gzip.decompress(image_path.read_bytes()))
    # Sform and qform are there, and pixdim says 1 mm for slices of 3 mm.
    struct.pack_into("<f", content, 88, 1.0)
    struct.pack_into("<2h", content, 252, 0, 1)
    path.write_bytes(content)
    assert fit(path, "--organ", "bladder", "--seed", SEED, "--output", out, "--quiet") == 0
    sentence = (
        f"{path}: its sform has voxels of 1.2 x 1.2 x 3 mm, its pixdim says 1.2 x 1.2 x 1 mm; the sform was taken"
    )
    assert f"warning: {sentence}\n" in capsys.readouterr().err
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert (report["image_warnings"], report["image_frame"]) == ([sentence], None)
    assert "its pixdim says 1.2 x 1.2 x 1 mm" in (out / "report.html").read_text(encoding="utf-8")


def test_one_of_several_volumes_is_fitted(tmp_path, capsys):
    image, path, out = ellipsoid_image(), tmp_path / "mri.nrrd", tmp_path / "out"
    volumes = [sitk.GetImageFromArray(levels) for levels in (np.flip(image.array, axis=2), image.array)]
    for volume in volumes:
        lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ image.ijk_to_ras
        volume.SetDirection((lps[:3, :3] / image.spacing).ravel().tolist())
        volume.SetSpacing(image.spacing.tolist())
        volume.SetOrigin(lps[:3, 3].tolist())
    sitk.WriteImage(sitk.Compose(volumes), str(path))
    words = (path, "--organ", "bladder", "--seed", SEED, "--output", out, "--quiet", "--no-pictures")
    assert fit(*words) == 2
    assert "Choose it with --frame 1 to --frame 2" in capsys.readouterr().err
    assert fit(*words, "--frame", 2) == 0
    assert json.loads((out / "report.json").read_text())["image_frame"] == 2
    with pytest.raises(SystemExit):
        fit(*words, "--frame", "RAS")
    assert "the frame of a mesh is --reference-frame" in capsys.readouterr().err


def test_a_label_map_in_the_place_of_an_mri_is_told(tmp_path, capsys):
    image, path = ellipsoid_image(), tmp_path / "label.nrrd"
    write_image(Image((image.array > 600).astype(np.uint8), image.ijk_to_ras), path)
    fit(path, "--organ", "bladder", "--seed", SEED, "--output", tmp_path / "out", "--quiet", "--no-pictures")
    assert f"warning: {path}: it has only 2 different values, like a label map" in capsys.readouterr().err


def test_an_organ_at_the_border_is_fitted_with_a_warning(tmp_path, capsys):
    whole = ellipsoid_image()
    # Slices run from left to right (k), pixels from front to back (i) and from top to bottom (j).
    cut = whole.crop((0, 0, 0), (11, *whole.array.shape[1:]))
    write_image(cut, tmp_path / "mri.nrrd")
    seed = "-18,8,-20"
    words = ("--organ", "b", "--seed", seed, "--output", tmp_path, "--no-pictures", "--quiet")
    assert fit(tmp_path / "mri.nrrd", *words) == 0
    organ = json.loads((tmp_path / "report.json").read_text())["organs"]["b"]
    assert organ["touches_border"] == ["right"]
    told = capsys.readouterr().err
    assert "reaches the border of the image (right)" in told
    assert all("warning" in line for line in told.splitlines())
    assert [warning["code"] for warning in organ["warnings"]] == ["reaches_border", "no_edge_at_side"]
    values = organ["warnings"][0]["values"]
    assert values["sides"] == ["right"]
    assert 0.3 < values["share"] < 0.5
    assert organ["warnings"][0]["sentence"] in told


@pytest.mark.parametrize("words", [["--help"], ["fit", "--help"], ["phantom", "--help"], ["reproduce", "--help"]])
def test_help_is_there(words, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert end.value.code == 0
    shown = capsys.readouterr().out
    assert "usage: vic-registration" in shown
    if words[0] == "fit":
        assert '"schema": "vic-registration/organs"' in shown
        for flag in ("--organ", "--seed", "--threshold", "--erosion", "--net", "--solver", "--config", "--output"):
            assert flag in shown


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"vic-registration {__version__}\n"


def test_the_program_runs_as_a_process(tmp_path):
    """Without a fit: the start alone."""
    root = Path(__file__).resolve().parents[2] / "VICRegistration"
    words = [sys.executable, "-m", "VICRegistrationLib", "fit", "none.nii", "--organ", "b", "--seed", "-1,2,3"]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    ended = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr == "vic-registration: error: There is no file or folder none.nii; check the path.\n"
    assert list(tmp_path.iterdir()) == []
