"""Whatever is wrong: exit code 2, one line that says what and what to do, and an untouched output folder."""

from __future__ import annotations

import json
import os
import shutil
import sys

import numpy as np
import pytest
import SimpleITK as sitk
from small_phantom import SEED

from VICRegistrationLib import cli
from VICRegistrationLib.cli.process import silenced_stderr
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image

pytestmark = pytest.mark.usefixtures("one_net", "grown_regions")

ORGAN = ("--organ", "bladder", "--seed", SEED)


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


def written(volume, path):
    sitk.WriteImage(volume, str(path))
    return path


def missing(folder, image):
    return folder / "none.nrrd"


def corrupt(folder, image):
    (folder / "corrupt.nrrd").write_bytes(b"NRRD0004\ntype: short\ngarbage")
    return folder / "corrupt.nrrd"


def no_image(folder, image):
    (folder / "notes.txt").write_text("not an image")
    return folder / "notes.txt"


def cut_short(folder, image):
    write_image(image, folder / "short.nii")
    content = (folder / "short.nii").read_bytes()
    (folder / "short.nii").write_bytes(content[: len(content) // 2])
    return folder / "short.nii"


def empty_folder(folder, image):
    (folder / "dicom").mkdir()
    return folder / "dicom"


def colour(folder, image):
    return written(sitk.GetImageFromArray(np.zeros((5, 6, 7, 3), np.uint8), isVector=True), folder / "colour.nrrd")


def four_dimensional(folder, image):
    return written(sitk.GetImageFromArray(np.zeros((2, 5, 6, 7), np.int16), isVector=False), folder / "frames.nrrd")


def one_slice(folder, image):
    return written(sitk.GetImageFromArray(np.zeros((1, 6, 7), np.int16)), folder / "slice.nrrd")


def not_a_number(folder, image):
    array = image.array.astype(np.float32)
    array[3, 4, 5] = np.nan
    volume = sitk.GetImageFromArray(array)
    return written(volume, folder / "nan.nrrd")


def in_metres(folder, image):
    path = folder / "metres.nrrd"
    write_image(Image(image.array, np.diag([1e-3, 1e-3, 1e-3, 1.0]) @ image.ijk_to_ras), path)
    return path


def micrometres_that_are_none(folder, image):
    path = folder / "unit.nii"
    write_image(image, path)
    # The code of its unit.
    content = bytearray(path.read_bytes())
    content[123] = 3
    path.write_bytes(content)
    return path


def locked(folder, image):
    path = folder / "locked.nrrd"
    write_image(image, path)
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read every file")
    return path


def constant(folder, image):
    path = folder / "constant.nrrd"
    write_image(Image(np.full_like(image.array, 7), image.ijk_to_ras), path)
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (missing, ["There is no file or folder", "none.nrrd", "check the path"]),
        (corrupt, ["corrupt.nrrd cannot be read as an image", "check that the file is complete"]),
        (no_image, ["notes.txt cannot be read as an image (its format is not known)"]),
        (cut_short, ["short.nii is cut short", "copy or download it again"]),
        (in_metres, ["metres.nrrd: The volume is", "smaller than any organ", "1000 times as large"]),
        (micrometres_that_are_none, ["unit.nii: its lengths are in micrometres", "smaller than any organ"]),
        (locked, ["locked.nrrd cannot be read (Permission denied)"]),
        (empty_folder, ["holds no DICOM slices", "choose the folder that holds the slices"]),
        (colour, ["colour.nrrd has 3 values per voxel", "--frame 1 to --frame 3"]),
        (four_dimensional, ["frames.nrrd has 4 dimensions with 2 frames", "one volume is needed"]),
        (one_slice, ["slice.nrrd holds a single slice", "choose the whole volume"]),
        (not_a_number, ["1 of the image's", "not finite", "Replace them"]),
        (constant, ["bladder: No edge of an organ was found", "give the threshold"]),
    ],
)
def test_an_image_that_cannot_be_used(refused_fit, tmp_path, image, make, words):
    line = refused_fit(make(tmp_path, image), *ORGAN)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--threshold", "900,300"], ["The threshold is 900,300", "the lowest first"]),
        (
            ["--threshold", "2000,3000"],
            ["threshold 2000 to 3000 contains no voxel", "grey levels of the image go from"],
        ),
        (["--threshold", "600,700"], ["outside the threshold 600 to 700", "move the seed"]),
        (["--seed", "500,0,0"], ["seed (500.0, 0.0, 0.0) mm lies outside the volume", "Give RAS coordinates in mm"]),
        (["--seed", "-12,8,6", "--threshold", "600,1000"], ["outside the threshold 600 to 1000"]),
        (["--erosion", "40"], ["The erosion is 40", "from 0 to 20 mm"]),
        (["--erosion", "19"], ["bladder: The erosion of 19 mm leaves nothing"]),
        (["--threshold", "-10000,10000"], ["bladder: The separated region", "With a threshold of"]),
        (["--net", "3x3"], ["--net", "ROWSxCOLUMNS from 5 to 65"]),
        (["--net", "5x5", "--closure", "paper"], ["bladder: A net of 5x5", "need at least 6x5"]),
        (["--seed", "1,2"], ["--seed", "three numbers R,A,S"]),
        (["--seed", "1,2,nan"], ["--seed", "three numbers R,A,S"]),
        (["--seed", "one,two,three"], ["--seed", "three numbers R,A,S"]),
        (["--threshold", "5"], ["--threshold", "two numbers LOW,HIGH"]),
        (["--dilation", "1e308"], ["The dilation is 1e308", "from 0 to 20 mm"]),
        (["--boundary", "1,2"], ["--boundary", "a point is three numbers R,A,S"]),
        (["--boundary", "1,2,nan"], ["--boundary", "three numbers R,A,S"]),
        (["--boundary", "20,40,10"], ["bladder: Boundary point 1", "mm from the surface", "within 30 mm"]),
        (["--boundary", "60,8,-20"], ["bladder: The boundary point (60.0, 8.0, -20.0) mm lies outside the volume"]),
        (["--boundary", "1e308,0,0"], ["bladder: The boundary point (1e+308, 0.0, 0.0) mm lies outside the volume"]),
        (["--tau", "0.05"], ["bladder: A tau of 0.05 mm", "voxels are 1.2 mm", "two to three voxels"]),
        (["--smoothness", "-1e-5"], ["--smoothness", "The smoothness is -1e-5"]),
        (["--inside", "5"], ["bladder: A grey level inside or outside was given", "is 'local'; make it 'given'"]),
        (["--levels", "given", "--inside", "5"], ["bladder: The profile level is 'given'", "both grey levels"]),
        (["--label", "5"], ["--label was given without --reference or --region", "leave --label out"]),
        (["--largest"], ["--largest was given without --reference,", "leave --largest out"]),
        (["--frame", "2"], ["Volume 2 was asked for", "holds 1 volume; leave it out"]),
        (["--organ", "a/b"], ["--organ", "'a/b'", "file name"]),
        (["--organ", "a\\b"], ["--organ", "file name"]),
        (["--organ", ".."], ["--organ", "file name"]),
        (["--organ", ""], ["--organ", "is empty"]),
        (["--organ", "report"], ["--organ", "choose another"]),
        (["--organ", "Model"], ["--organ", "choose another"]),
        (["--organ", "x" * 300], ["--organ", "at most 100"]),
        (["--organ", "膀" * 90], ["--organ", "270 bytes", "room for 239"]),
        (["--organ", "con"], ["--organ", "device on Windows"]),
        (["--organ", "Nul.x"], ["--organ", "device on Windows"]),
        (["--seed", "-inf,0,0"], ["--seed", "three numbers R,A,S"]),
        (["--seed", "1e308,-1e308,1e308"], ["seed (1e+308, -1e+308, 1e+308) mm lies outside the volume"]),
        (["--threshold", "-inf,inf"], ["--threshold", "two numbers LOW,HIGH"]),
        (["--net", "-9x7"], ["--net", "The control net is -9x7"]),
        (["--erosion", "-inf"], ["--erosion", "The erosion is -inf"]),
        (["--series", "1.2.3"], ["--series was given", "is a file"]),
        (["--config", "organs.json"], ["Both --config and --organ were given; leave --organ out"]),
        (["--organ", "rectum"], ["--organ was given twice, bladder and rectum", "--config FILE"]),
    ],
)
def test_options_that_cannot_be_met(refused_fit, image_path, options, words):
    line = refused_fit(image_path, *ORGAN, *options)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["fit", "mri.nrrd", "--frame", "RAS"], "'RAS' was given; the number of a volume is 1 or more (the frame of a"),
        (["model", "fit", "mri.nrrd", "--frame", "0"], "'0' was given; the number of a volume is 1 or more; see"),
        (["phantom", "out", "--motion", "-3,2"], "'-3,2' was given; two numbers from 0 are needed, mm and degrees"),
    ],
)
def test_a_word_that_cannot_be_is_refused_with_flags_of_its_own_command(capsys, arguments, told):
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["fit", "mri.nrrd", "--sead", "1,2,3"], "error: fit has no flag --sead (similar: --seed); see"),
        (["compare", "a.json", "b.nrrd", "--lable=3"], "error: compare has no flag --lable (similar: --label); see"),
        (["gaps", "a.json", "b.json", "--quickly"], "error: gaps has no flag --quickly; see"),
        (["phantom", "out", "more"], "more is one argument too many; see"),
    ],
)
def test_an_unknown_flag_shows_the_usage_of_its_command(capsys, arguments, told):
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 2
    *usage, line = capsys.readouterr().err.splitlines()
    assert usage[0].startswith(f"usage: vic-registration {arguments[0]} ")
    assert line.startswith("vic-registration: error: ")
    assert f"{told} vic-registration {arguments[0]} --help." in line


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "COMMAND, one of fit, "),
        (["model"], "ACTION, one of fit, show, check"),
        (["fit"], "IMAGE"),
        (["fti", "mri.nrrd"], "fti"),
        (["phantom"], "DIR"),
        (["fit", "mri.nrrd"], "No --organ was given"),
        (["fit", "mri.nrrd", "--organ", "bladder"], "No --seed was given"),
        (["fit", "mri.nrrd", "--seed", "1,2,3"], "No --organ was given"),
    ],
)
def test_words_that_make_no_command(refused, arguments, word):
    assert word in refused(*arguments)


def organs(*entries, schema="vic-registration/organs", version=1, **more):
    return json.dumps({"schema": schema, "version": version, "organs": entries, **more})


GOOD = {"organ": "bladder", "seed": [1, 2, 3]}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ["is not valid JSON"]),
        ("\xff", ["is not valid JSON"]),
        ("[]", ["has no schema", "vic-registration/organs"]),
        (organs(GOOD, schema="other"), ["has the schema 'other'"]),
        (organs(GOOD, version=2), ["has version 2", "version 1 is understood"]),
        (organs(), ["lists no organs"]),
        (organs(GOOD, colour="red"), ["unknown key 'colour'"]),
        (organs("bladder"), ["organ 1: 'bladder' was given"]),
        (organs({**GOOD, "treshold": [1, 2]}), ["organ 1: the key 'treshold' is unknown (similar: threshold)"]),
        (organs({**GOOD, "region": "l.nii"}), ["bladder: the region", "but its seed was given too"]),
        (organs({**GOOD, "label": 5}), ["the key 'label' was given without 'region'"]),
        (organs({"organ": "bladder"}), ["organ 1: the key 'seed' is missing"]),
        (organs({"seed": [1, 2, 3]}), ["organ 1: the key 'organ' is missing"]),
        (organs({**GOOD, "seeds": [[1, 2, 3]]}), ["'seeds' is unknown"]),
        (organs({**GOOD, "organ": 5}), ["key 'organ'", "no text"]),
        (organs({**GOOD, "organ": "../x"}), ["key 'organ'", "file name"]),
        (organs({**GOOD, "seed": []}), ["key 'seed'", "a list of points"]),
        (organs({**GOOD, "seed": [[1, 2]]}), ["key 'seed'", "three numbers"]),
        (organs({**GOOD, "seed": [1, 2, True]}), ["key 'seed'", "three numbers"]),
        (organs({**GOOD, "threshold": 5}), ["key 'threshold'", "two numbers"]),
        (organs({**GOOD, "erosion": None}), ["key 'erosion'", "The erosion is None"]),
        (organs({**GOOD, "dilation": -1}), ["key 'dilation'", "The dilation is -1"]),
        (organs({**GOOD, "boundary": []}), ["key 'boundary'", "a list of points"]),
        (organs({**GOOD, "boundary": [[1, 2]]}), ["key 'boundary'", "three numbers"]),
        (organs({**GOOD, "net": 9}), ["key 'net'", "ROWSxCOLUMNS"]),
        (organs({**GOOD, "net": "5x5", "closure": "paper"}), ["bladder: A net of 5x5"]),
        (organs({**GOOD, "solver": ["gauss-newton"]}), ["key 'solver'", "must be one of"]),
        (organs(GOOD, {**GOOD, "organ": "Bladder"}), ["Bladder, bladder twice", "rename one"]),
        (organs({**GOOD, "organ": "Bl\u00e4se"}, {**GOOD, "organ": "bla\u0308se"}), ["twice", "rename one"]),
        ('{"schema": 1, "schema": 2}', ["'schema' occurs twice"]),
    ],
)
def test_a_configuration_that_cannot_be_understood(refused_fit, image_path, tmp_path, text, words):
    path = tmp_path / "organs.json"
    path.write_bytes(text.encode("latin-1"))
    line = refused_fit(image_path, "--config", path)
    for word in ["organs.json", *words]:
        assert word in line


def test_a_configuration_that_is_not_there(refused_fit, image_path, tmp_path):
    line = refused_fit(image_path, "--config", tmp_path / "none.json")
    assert "none.json cannot be read (No such file or directory); give a file that exists" in line


def test_one_bad_organ_leaves_no_file_of_the_good_one(refused_fit, image_path, tmp_path):
    good = {"organ": "bladder", "seed": [float(number) for number in SEED.split(",")]}
    bad = {"organ": "rectum", "seed": [500, 0, 0]}
    (tmp_path / "organs.json").write_text(organs(good, bad))
    assert "rectum: The seed (500.0, 0.0, 0.0) mm" in refused_fit(image_path, "--config", tmp_path / "organs.json")


@pytest.mark.parametrize(
    ("folder", "word"), [("", "is empty"), (" ", "is empty"), ("x/" + "y" * 256, "more than 255 bytes")]
)
@pytest.mark.parametrize("command", [["fit", "none.nrrd", *ORGAN, "--output"], ["phantom"], ["reproduce"]])
def test_an_output_that_has_no_name(refused, command, folder, word):
    assert word in refused(*command, folder)


def test_a_result_that_would_replace_the_image(refused, image_path, output):
    shutil.copyfile(image_path, output.parent / "b.vtp")
    folder = output.parent
    line = refused("fit", folder / "b.vtp", "--organ", "b", "--seed", SEED, "--output", folder, "--quiet")
    assert "b.vtp, which is read; choose another output folder or name" in line


def test_stderr_is_silenced_only_for_a_while(capfd):
    with silenced_stderr():
        os.write(2, b"noise")
    os.write(2, b"words")
    assert capfd.readouterr().err == "words"


@pytest.mark.parametrize("below", [[], ["deeper"]])
@pytest.mark.parametrize("command", [["fit", "IMAGE", *ORGAN, "--output"], ["phantom"], ["reproduce"]])
def test_an_output_that_is_no_folder(refused, image_path, tmp_path, command, below):
    (tmp_path / "file").write_text("")
    words = [image_path if word == "IMAGE" else word for word in command]
    line = refused(*words, tmp_path.joinpath("file", *below))
    assert "file is not a folder; choose a folder for the output" in line


@pytest.mark.parametrize("name", ["mri.nii.gz", "organs.json"])
def test_a_phantom_does_not_replace_the_files_of_a_user(refused, tmp_path, name):
    folder = tmp_path / "patient"
    folder.mkdir()
    (folder / name).write_text("mine")
    assert f"{folder / name} exists and is not part of a phantom; choose another folder" in refused("phantom", folder)
    assert (folder / name).read_text() == "mine"
    assert [path.name for path in folder.iterdir()] == [name]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a user who may not write everywhere")
def test_an_output_folder_without_the_right_to_write(refused, image_path, output):
    output.chmod(0o500)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet")
    assert "cannot be written to" in line


def test_without_matplotlib_the_fit_does_not_begin(refused, output, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    line = refused("fit", "none.nrrd", *ORGAN, "--output", output)
    assert "pip install matplotlib" in line
    assert "--no-pictures" in line


def test_the_configuration_is_not_replaced_by_a_surface(image_path, tmp_path, capsys):
    config = tmp_path / "bladder.json"
    content = json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": [GOOD]})
    config.write_text(content)
    assert cli.main(["fit", str(image_path), "--config", str(config), "--output", str(tmp_path), "--no-pictures"]) == 2
    line = capsys.readouterr().err
    assert "would replace" in line
    assert "choose another output folder or name" in line
    assert config.read_text() == content


def test_readers_written_in_c_do_not_add_lines(tmp_path, output, capfd):
    path = tmp_path / "short.mha"
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 8, 8), np.int16)), str(path))
    path.write_bytes(path.read_bytes()[:-100])
    assert cli.main(["fit", str(path), *ORGAN, "--output", str(output), "--quiet"]) == 2
    assert len(capfd.readouterr().err.splitlines()) == 1


@pytest.mark.long
def test_a_name_that_looks_like_a_formula_is_drawn_as_it_is(image_path, tmp_path):
    words = [
        "fit",
        str(image_path),
        "--organ",
        "$_$ a_b^2",
        "--seed",
        SEED,
        "--output",
        str(tmp_path / "out"),
        "--quiet",
    ]
    assert cli.main(words) == 0
    assert (tmp_path / "out" / "$_$ a_b^2.png").is_file()
