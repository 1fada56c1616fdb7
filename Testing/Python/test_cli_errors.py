"""Whatever is wrong: exit code 2, one line that says what and what to do, and an untouched output folder."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from small_phantom import SEED, ellipsoid, ellipsoid_image

import VICRegistrationLib
from VICRegistrationLib import cli
from VICRegistrationLib.cli import fitting, results_folder
from VICRegistrationLib.cli.process import silenced_stderr
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image

pytestmark = pytest.mark.usefixtures("one_net")

ORGAN = ("--organ", "bladder", "--seed", SEED)


@pytest.fixture(scope="module")
def image():
    return ellipsoid_image()


@pytest.fixture(scope="module")
def image_path(tmp_path_factory, image):
    path = tmp_path_factory.mktemp("image") / "mri.nrrd"
    write_image(image, path)
    return path


@pytest.fixture
def output(tmp_path):
    """Folder with a file of the user, which has to survive."""
    folder = tmp_path / "output"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    return folder


@pytest.fixture
def refused(output, capsys):
    """Run a command that has to fail, and return its one line."""

    def run(*words, code=2):
        try:
            found = cli.main([str(word) for word in words])
        except SystemExit as end:
            found = end.code
        captured = capsys.readouterr()
        assert found == code
        assert captured.out == ""
        lines = captured.err.splitlines()
        assert len(lines) == 1, lines
        assert [path.name for path in output.iterdir()] == ["notes.txt"]
        assert (output / "notes.txt").read_text() == "mine"
        assert [path.name for path in output.parent.iterdir() if path.name.startswith(".")] == []
        return lines[0]

    return run


@pytest.fixture
def refused_fit(refused, output):
    def run(*words):
        line = refused("fit", *words, "--output", output, "--quiet", "--no-pictures")
        assert line.startswith("vic-registration: error: ")
        return line

    return run


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
        (["--threshold", "2000,3000"], ["threshold 2000 to 3000 holds no voxel", "grey levels of the image go from"]),
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
        (["--frame", "2"], ["--frame 2 was given", "holds 1 volume; leave it out"]),
        (["--organ", "a/b"], ["--organ", "'a/b'", "file name"]),
        (["--organ", "a\\b"], ["--organ", "file name"]),
        (["--organ", ".."], ["--organ", "file name"]),
        (["--organ", ""], ["--organ", "is empty"]),
        (["--organ", "report"], ["--organ", "choose another"]),
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


def with_closed_pipe(folder, words, **streams):
    """Run the program with a stdout that nobody reads."""
    environment = {**os.environ, "PYTHONPATH": str(Path(VICRegistrationLib.__file__).parents[1])}
    program = [sys.executable, "-m", "VICRegistrationLib", *words]
    with subprocess.Popen(program, cwd=folder, env=environment, stdout=subprocess.PIPE, **streams) as run:
        run.stdout.close()
        told = "" if run.stderr is None else run.stderr.read()
    return run.returncode, told


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes of this kind")
@pytest.mark.parametrize(
    ("words", "code"), [(["--help"], 0), (["compare", "truth.json", "truth.json", "--points", "100"], 141)]
)
def test_a_pipe_that_nobody_reads_ends_quietly(tmp_path, words, code):
    write_surface(ellipsoid(), tmp_path / "truth.json", name="bladder")
    assert with_closed_pipe(tmp_path, words, stderr=subprocess.PIPE, text=True) == (code, "")


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes of this kind")
def test_the_work_goes_on_if_nobody_reads_about_it(tmp_path):
    write_surface(ellipsoid(), tmp_path / "truth.json", name="bladder")
    words = ["export", "truth.json", "--stl", "out.stl"]
    assert with_closed_pipe(tmp_path, words, stderr=subprocess.STDOUT) == (0, "")
    assert (tmp_path / "out.stl").is_file()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "COMMAND"),
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
        ("[]", ["has the schema None", "vic-registration/organs"]),
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


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal to send")
@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize(
    ("number", "code", "told"), [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")]
)
def test_a_signal_ends_with_one_line(refused, image_path, output, monkeypatch, request, number, code, told, wrapped):
    usual = {signal.SIGTERM: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}[number]
    # What runs in the background may ignore Ctrl-C.
    before = signal.signal(number, usual)
    request.addfinalizer(lambda: signal.signal(number, before))

    def stopped(*arguments, **options):
        try:
            os.kill(os.getpid(), number)
            time.sleep(10.0)
        except BaseException as error:
            if wrapped:
                raise RuntimeError from error
            raise

    monkeypatch.setattr(fitting, "separate", stopped)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet", code=code)
    assert line == f"vic-registration: {told}; nothing was written"
    assert signal.getsignal(number) is usual


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal to send")
def test_a_signal_that_python_drops_is_told_again(refused, image_path, output, monkeypatch):
    class Thing:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGTERM)
            # Python looks at signals between its own steps.
            sum(range(10))

    def stopped(*arguments, **options):
        Thing()
        time.sleep(10.0)

    monkeypatch.setattr(fitting, "separate", stopped)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet", code=143)
    assert line == "vic-registration: terminated; nothing was written"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signal to send")
def test_ctrl_c_while_modules_are_imported_ends_with_one_line():
    program = """if True:
        import os, signal, sys

        class Finder:
            def find_spec(self, name, *others):
                if name == "VICRegistrationLib.cli.arguments":
                    os.kill(os.getpid(), signal.SIGINT)

        sys.meta_path.insert(0, Finder())
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from VICRegistrationLib.cli import main

        os._exit(main(["--version"]))
    """
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(VICRegistrationLib.__file__).parents[1],
    )
    assert ended.returncode == 130
    assert ended.stderr == "vic-registration: interrupted; nothing was written\n"


def test_numbers_that_overflow_end_with_one_line(refused_fit, image_path, monkeypatch):
    def overflown(*arguments, **options):
        msg = "math range error"
        raise OverflowError(msg)

    monkeypatch.setattr(fitting, "separate", overflown)
    assert "too large to be worked with (math range error)" in refused_fit(image_path, *ORGAN)


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
    assert f"{folder / name} is there and is not of a phantom; choose another folder" in refused("phantom", folder)
    assert (folder / name).read_text() == "mine"
    assert [path.name for path in folder.iterdir()] == [name]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a user who may not write everywhere")
def test_an_output_folder_without_the_right_to_write(refused, image_path, output):
    output.chmod(0o500)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet")
    assert "cannot be written to" in line


def test_a_disk_that_fills_up(refused_fit, image_path, output, monkeypatch):
    def full(organ, folder):
        (folder / "bladder.json").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device", str(folder / "bladder.vtp"))

    monkeypatch.setattr(results_folder, "write_organ", full)
    line = refused_fit(image_path, *ORGAN)
    assert "No space left on device" in line
    assert str(output / "bladder.vtp") in line


def test_a_disk_that_fills_up_while_files_are_moved(refused_fit, image_path, output, monkeypatch):
    replace = os.replace

    def full(source, target):
        if str(target) == str(output / "bladder_convergence.csv"):
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    line = refused_fit(image_path, *ORGAN)
    assert "No space left on device" in line
    assert "left as it was" in line


def test_ctrl_c_ends_with_one_line(refused, image_path, output, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(fitting, "separate", interrupted)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet", code=130)
    assert line == "vic-registration: interrupted; nothing was written"


def test_without_matplotlib_the_fit_does_not_begin(refused, output, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    line = refused("fit", "none.nrrd", *ORGAN, "--output", output)
    assert "pip install matplotlib" in line
    assert "--no-pictures" in line


def test_a_bug_is_not_hidden(image_path, output, monkeypatch):
    def broken(*arguments, **options):
        raise ZeroDivisionError

    monkeypatch.setattr(fitting, "separate", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["fit", str(image_path), *ORGAN, "--output", str(output), "--quiet"])
    assert [path.name for path in output.iterdir()] == ["notes.txt"]


def test_the_configuration_is_not_replaced_by_a_surface(image_path, tmp_path, capsys):
    config = tmp_path / "bladder.json"
    content = json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": [GOOD]})
    config.write_text(content)
    assert cli.main(["fit", str(image_path), "--config", str(config), "--output", str(tmp_path), "--no-pictures"]) == 2
    line = capsys.readouterr().err
    assert "would replace" in line
    assert "choose another output folder or name" in line
    assert config.read_text() == content


def test_an_output_without_a_name_is_refused(image_path, refused):
    assert "--output" in refused("fit", image_path, *ORGAN, "--output", "")


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


def test_sigterm_leaves_nothing_behind(image_path, output, monkeypatch):
    monkeypatch.setattr(fitting, "read_with_warnings", lambda *words, **options: os.kill(os.getpid(), signal.SIGTERM))
    assert cli.main(["fit", str(image_path), *ORGAN, "--output", str(output), "--no-pictures"]) == 143
    assert [path.name for path in output.iterdir()] == ["notes.txt"]
