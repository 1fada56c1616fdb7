"""``vic-registration compare``."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from VICRegistrationLib import cli
from VICRegistrationLib.export.mesh_files import write_mesh
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image

pytestmark = pytest.mark.usefixtures("one_net", "small_pictures")

CENTERS = {"bladder": (20.0, -10.0, 5.0), "rectum": (-20.0, -10.0, 5.0)}


def ball(radius, center):
    return closed_organ((17, 13), axes=radius * np.eye(3), center=np.array(center))


@pytest.fixture
def fitted(tmp_path):
    """Balls of 11 mm: paths by name."""
    paths = {}
    for name, center in CENTERS.items():
        paths[name] = tmp_path / f"{name}.json"
        write_surface(ball(11.0, center), paths[name], name=name)
    return paths


@pytest.fixture
def truth(tmp_path):
    """Folder with balls of 10 mm, one as a surface, one as triangles."""
    folder = tmp_path / "truth"
    folder.mkdir()
    write_surface(ball(10.0, CENTERS["bladder"]), folder / "bladder.json", name="bladder")
    write_mesh(ball(10.0, CENTERS["rectum"]), folder / "rectum.stl", name="rectum", chord_error=0.01)
    return folder


@pytest.fixture
def label(tmp_path):
    """Label image with both balls of 10 mm: 3 and 5."""
    matrix = np.diag([-1.0, 1.0, 1.5, 1.0])
    matrix[:3, 3] = [34.0, -24.0, -10.0]
    grid = Image(np.zeros((20, 28, 70), dtype=np.uint8), matrix)
    k, j, i = np.indices(grid.array.shape).reshape(3, -1)
    places = grid.to_ras(np.column_stack([i, j, k]))
    array = np.zeros(len(places), dtype=np.uint8)
    for value, center in zip((3, 5), CENTERS.values()):
        array[np.linalg.norm(places - center, axis=1) <= 10.0] = value
    path = tmp_path / "label.nii.gz"
    write_image(Image(array.reshape(grid.array.shape), matrix), path)
    return path


def run(*words):
    return cli.main(["compare", *map(str, words)])


def rows(text):
    return [line.split() for line in text.splitlines() if line]


# ------------------------------------------------------------------ table


def test_a_surface_that_is_no_valid_one_is_compared_with_a_warning(tmp_path, truth, capsys):
    surface = ball(11.0, CENTERS["bladder"])
    net = surface.control_net.copy()
    net[:, [3, 6]] = net[:, [6, 3]]
    write_surface(surface.with_control_net(net), tmp_path / "bladder.json", name="bladder")
    assert run(tmp_path / "bladder.json", truth / "bladder.json", "--points", 500) == 0
    assert "warning: bladder: The surface" in capsys.readouterr().err


def test_an_organ_gets_its_distances_both_ways(fitted, truth, capsys):
    assert run(fitted["bladder"], truth / "bladder.json", "--points", 500) == 0
    titles, there, back, others, common = rows(capsys.readouterr().out)
    assert titles[:5] == ["distances,", "mm", "mean", "std", "RMS"]
    for row, way in ((there, "reference to surface"), (back, "surface to reference")):
        assert row[0] == "bladder"
        assert " ".join(row[1:4]) == way
        mean, std, *_, signed = row[4:]
        assert (mean, std, signed) == ("1.00", "0.00", "+1.00")
    assert others[0] == "Hausdorff"
    # Radii of 10 and 11 mm: volumes of 4.19 and 5.58 ml, Dice 2 * 1000 / (1000 + 1331).
    assert common[:3] == ["bladder", "1.00", "mm"]
    assert common[3] == "0.000"
    assert float(common[6]) == pytest.approx(2000.0 / 2331.0, abs=2e-3)
    assert " ".join(common[7:]) == "5.6 ml 4.2 ml +1.4 ml"


def test_organs_find_their_references_in_a_folder(fitted, truth, capsys):
    assert run(*fitted.values(), truth, "--points", 200, "--tolerance", "0.5", "--tolerance", "1.5") == 0
    text = capsys.readouterr().out
    lines = rows(text)
    assert [line[0] for line in lines[1:5]] == ["bladder", "bladder", "rectum", "rectum"]
    # The triangles lie up to 0.01 mm inside of their ball.
    assert [float(line[-1]) for line in lines[1:5]] == pytest.approx([1.0] * 4, abs=0.011)
    assert "Dice 0.5 mm   Dice 1.5 mm   volume Dice" in text
    assert [line[3:5] for line in lines[6:]] == [["0.000", "1.000"]] * 2


def test_labels_are_chosen_for_each_organ(fitted, label, capsys):
    assert run(*fitted.values(), label, "--label", "bladder=3", "--label", "rectum=5", "--points", 1000) == 0
    for line in rows(capsys.readouterr().out)[1:5]:
        # Voxels of 1 x 1 x 1.5 mm.
        assert float(line[-1]) == pytest.approx(1.0, abs=0.15)


def test_what_has_little_in_common_is_warned_of(fitted, truth, capsys):
    assert run(fitted["rectum"], truth / "rectum.stl", "--frame", "RAS", "--points", 100) == 0
    warning = capsys.readouterr().err
    assert warning.startswith(
        "warning: rectum: The surface fits rectum.stl better with left and right, and front and back exchanged"
    )
    assert "in another frame (LPS or RAS)" in warning


# ------------------------------------------------------------------ files


def test_the_numbers_are_written_for_programs(fitted, label, tmp_path):
    out = tmp_path / "out"
    assert run(fitted["bladder"], label, "--label", 3, "--output", out, "--no-pictures", "--points", 2000) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "bladder_deviation.vtp",
        "comparison.csv",
        "comparison.json",
    ]
    content = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert (content["schema"], content["version"], content["points"]) == ("vic-registration/comparison", 1, 2000)
    organ = content["organs"]["bladder"]
    assert (organ["kind"], organ["label"], organ["files"]) == ("label image", "3", ["bladder_deviation.vtp"])
    assert organ["to_surface"]["mean"] == pytest.approx(1.0, abs=0.15)
    assert organ["to_reference"]["n"] == 2000
    assert [entry["tolerance"] for entry in organ["surface_dice"]] == [0.5, 1.0, 2.0]
    (row,) = csv.DictReader((out / "comparison.csv").read_text(encoding="utf-8").splitlines())
    assert (row["organ"], row["label"]) == ("bladder", "3")
    assert float(row["to_surface_p95_mm"]) == organ["to_surface"]["p95"]
    assert float(row["surface_dice_2mm"]) == organ["surface_dice"][2]["dice"]
    assert float(row["volume_difference_ml"]) == organ["volume_difference_ml"]


def test_the_triangles_carry_the_deviation_in_lps(fitted, tmp_path):
    shifted = tmp_path / "shifted.json"
    write_surface(ball(11.0, np.add(CENTERS["bladder"], [1.0, 0.0, 0.0])), shifted, name="bladder")
    assert run(fitted["bladder"], shifted, "--output", tmp_path / "out", "--no-pictures", "--points", 100) == 0
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "out" / "bladder_deviation.vtp"))
    reader.Update()
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData()) * [-1.0, -1.0, 1.0]
    found = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars())
    assert reader.GetOutput().GetPointData().GetScalars().GetName() == "Deviation"
    # From a ball that is 1 mm farther to the right.
    expected = np.linalg.norm(points - np.add(CENTERS["bladder"], [1.0, 0.0, 0.0]), axis=1) - 11.0
    np.testing.assert_allclose(found, expected, atol=5e-3)


def test_pictures_are_drawn_and_removed_when_they_are_out_of_date(fitted, truth, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    out = tmp_path / "out"
    assert run(fitted["bladder"], truth, "--output", out, "--points", 100) == 0
    assert (out / "bladder_deviation.png").read_bytes().startswith(b"\x89PNG")
    files = json.loads((out / "comparison.json").read_text(encoding="utf-8"))["organs"]["bladder"]["files"]
    assert files == ["bladder_deviation.vtp", "bladder_deviation.png"]
    assert run(fitted["bladder"], truth, "--output", out, "--points", 100, "--no-pictures") == 0
    assert not (out / "bladder_deviation.png").exists()


def test_an_earlier_comparison_is_replaced_and_that_is_said(fitted, truth, tmp_path, capsys):
    words = (truth, "--output", tmp_path / "out", "--points", 100, "--no-pictures")
    assert run(fitted["bladder"], *words) == 0
    assert capsys.readouterr().err == f"results written to {tmp_path / 'out'}\n"
    assert run(fitted["rectum"], *words) == 0
    told = f"results written to {tmp_path / 'out'}, in place of the comparison of bladder there\n"
    assert capsys.readouterr().err == told
    assert list(json.loads((tmp_path / "out" / "comparison.json").read_text())["organs"]) == ["rectum"]


@pytest.mark.parametrize(
    ("name", "text"), [("comparison.csv", "mine"), ("comparison.json", "[]"), ("comparison.json", '{"schema": 1}')]
)
def test_files_of_something_else_are_not_replaced(fitted, truth, tmp_path, capsys, name, text):
    (tmp_path / name).write_text(text)
    assert run(fitted["bladder"], truth, "--output", tmp_path, "--points", 100, "--no-pictures") == 2
    assert f"{tmp_path / name} exists and is no comparison; choose another folder" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == text


def test_a_reference_is_not_replaced_by_the_results(fitted, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    reference = out / "bladder_deviation.vtp"
    write_mesh(ball(10.0, CENTERS["bladder"]), reference, name="bladder")
    before = reference.read_bytes()
    assert run(fitted["bladder"], reference, "--output", out) == 2
    assert "would replace" in capsys.readouterr().err
    assert reference.read_bytes() == before


# ------------------------------------------------------------------ complaints


def test_what_is_wrong_is_said_in_one_line(fitted, truth, label, tmp_path, capsys):
    bladder, blocked = fitted["bladder"], tmp_path / "file"
    blocked.write_text("in the way")
    for words, sentence in (
        ((bladder, tmp_path / "missing.nii.gz"), "There is no file or folder"),
        ((bladder, label), "holds 2 labels, 3, 5; choose one with --label"),
        ((bladder, label, "--label", 4), "holds no label 4, but 3, 5; choose one of these"),
        ((bladder, label, "--label", "uterus=3"), "--label uterus=3 was given, but the organs are bladder"),
        ((bladder, label, "--label", 3, "--label", 5), "--label was given 2 times; give the organ of each"),
        ((bladder, truth / "rectum.stl", "--label", 3), "--label was given, which does not fit"),
        ((bladder, tmp_path / "truth", "--frame", "RAS"), "The frame of a mesh was given, which does not fit"),
        ((bladder, truth, "--output", blocked), "is not a folder; choose a folder for the output"),
    ):
        assert run(*words) == 2
        error = capsys.readouterr().err
        assert error.startswith("vic-registration: error: ")
        assert sentence in error
        assert error.count("\n") == 1
    (truth / "rectum.stl").unlink()
    assert run(*fitted.values(), truth, "--output", tmp_path / "out") == 2
    assert "holds no reference for rectum; give one that holds rectum.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--points", "-5"], "'-5' was given; distances are taken at 1 to 10000000 points"),
        (["--tolerance", "-1"], "'-1' was given; a positive length in mm is needed"),
        (["--tolerance", "nan"], "'nan' was given; a positive length in mm is needed"),
    ],
)
def test_numbers_out_of_range_are_refused(fitted, truth, capsys, words, sentence):
    with pytest.raises(SystemExit) as left:
        run(fitted["bladder"], truth, *words)
    assert left.value.code == 2
    assert sentence in capsys.readouterr().err
