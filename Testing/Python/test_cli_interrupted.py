"""Whatever comes between, signals, closed pipes: one line, and an output folder as it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_phantom import SEED, ellipsoid

import VICRegistrationLib
from VICRegistrationLib import cli
from VICRegistrationLib.cli import fitting
from VICRegistrationLib.geometry.surface_file import write_surface

pytestmark = pytest.mark.usefixtures("one_net")

ORGAN = ("--organ", "bladder", "--seed", SEED)


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


def test_ctrl_c_ends_with_one_line(refused, image_path, output, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(fitting, "separate", interrupted)
    line = refused("fit", image_path, *ORGAN, "--output", output, "--quiet", code=130)
    assert line == "vic-registration: interrupted; nothing was written"


def test_numbers_that_overflow_end_with_one_line(refused_fit, image_path, monkeypatch):
    def overflown(*arguments, **options):
        msg = "math range error"
        raise OverflowError(msg)

    monkeypatch.setattr(fitting, "separate", overflown)
    assert "too large (math range error)" in refused_fit(image_path, *ORGAN)


def test_a_bug_is_not_hidden(image_path, output, monkeypatch):
    def broken(*arguments, **options):
        raise ZeroDivisionError

    monkeypatch.setattr(fitting, "separate", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["fit", str(image_path), *ORGAN, "--output", str(output), "--quiet"])
    assert [path.name for path in output.iterdir()] == ["notes.txt"]
