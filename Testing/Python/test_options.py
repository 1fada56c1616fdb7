"""Options of a fit are declared once: flags, keys, sentences and the page follow from their table."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from VICRegistrationLib import cli
from VICRegistrationLib.cli.arguments import parsed_arguments
from VICRegistrationLib.cli.configuration import read_requests
from VICRegistrationLib.cli.fit_command import option_table
from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import CLOSURES
from VICRegistrationLib.registration import options as module
from VICRegistrationLib.registration.options import MAX_ITERATIONS, OPTIONS, FitOptions
from VICRegistrationLib.registration.solvers import SOLVERS

ROOT = Path(__file__).resolve().parents[2]
# A value of each option that is not its default, as it is typed, and as the library has it.
GIVEN = {
    "net": ("11x9", (11, 9)),
    "closure": ("paper", "paper"),
    "model": ("tube", "tube"),
    "threshold": ("-5,1200.5", (-5.0, 1200.5)),
    "erosion": ("1.5", 1.5),
    "dilation": ("0", 0.0),
    "solver": ("gradient-descent", "gradient-descent"),
    "tau": ("2.25", 2.25),
    "profile": ("paper", "paper"),
    "levels": ("given", "given"),
    "inside": ("812.5", 812.5),
    "outside": ("-100", -100.0),
    "smoothness": ("2e-4", 2e-4),
    "loss": ("huber", "huber"),
    "tolerance": ("0.05", 0.05),
    "stopping": ("published", "published"),
    "max_iterations": ("70", 70),
    "boundary_weight": ("2", 2.0),
}
# What each refuses, and what it says then.
REFUSED = [
    ("net", (4, 3), "4x3", "it must be two whole numbers ROWSxCOLUMNS from 5 to 65."),
    ("net", (9.5, 7), "9.5x7", "it must be two whole numbers ROWSxCOLUMNS from 5 to 65."),
    ("net", (9, 7, 5), "9x7x5", "it must be two whole numbers ROWSxCOLUMNS from 5 to 65."),
    ("threshold", (900, 300), "900,300", "numbers LOW,HIGH from -1000000 to 1000000, the lowest first."),
    ("threshold", (300, float("inf")), "300,inf", "numbers LOW,HIGH from -1000000 to 1000000, the lowest first."),
    ("erosion", -1.0, "-1.0", "The erosion is -1.0; it must be a number from 0 to 20 mm."),
    ("dilation", 20.5, "20.5", "The dilation is 20.5; it must be a number from 0 to 20 mm."),
    ("tau", 0.0, "0.0", "The edge width (tau) is 0.0; it must be a number from 0.01 to 20 mm."),
    ("tau", float("nan"), "nan", "The edge width (tau) is nan; it must be a number from 0.01 to 20 mm."),
    ("smoothness", 5.0, "5.0", "The smoothness is 5.0; it must be 0, or a number from 1e-08 to 1."),
    ("smoothness", 1e-10, "1e-10", "The smoothness is 1e-10; it must be 0, or a number from 1e-08 to 1."),
    ("tolerance", 0.0, "0.0", "The tolerance is 0.0; it must be a number from 0.001 to 5 mm."),
    ("max_iterations", 2.5, "2.5", "The iteration limit is 2.5; it must be a whole number from 1 to 10000."),
    ("max_iterations", 0, "0", "The iteration limit is 0; it must be a whole number from 1 to 10000."),
    ("boundary_weight", 11.0, "11.0", "The weight of points is 11.0; it must be a number from 0 to 10."),
    ("loss", "cauchy", "cauchy", "The loss is 'cauchy'; it must be one of squares, huber."),
    ("solver", "adam", "adam", "The solver is 'adam'; it must be one of gauss-newton, gradient-descent."),
    ("levels", "auto", "auto", "The profile level is 'auto'; it must be one of local, organ, given."),
    ("tau", "wide", "wide", "The edge width (tau) is 'wide'; it must be a number from 0.01 to 20 mm."),
]


def flag(name):
    return "--" + name.replace("_", "-")


def configuration(path, **keys):
    organ = {"organ": "bladder", "seed": [1, 2, 3], **{name.replace("_", "-"): value for name, value in keys.items()}}
    path.write_text(json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": [organ]}))
    return path


def test_every_option_is_a_flag_and_a_key_of_a_configuration(tmp_path):
    assert set(GIVEN) == set(OPTIONS)
    words = [word for name, (typed, _) in GIVEN.items() for word in (flag(name), typed)]
    expected = {name: value for name, (_, value) in GIVEN.items()}
    parsed = vars(parsed_arguments(["fit", "mri.nrrd", *words]))
    assert {name: parsed[name] for name in OPTIONS} == expected
    path = configuration(tmp_path / "organs.json", **{name: typed for name, (typed, _) in GIVEN.items()})
    (request,) = read_requests(path)
    assert request.options == FitOptions(**expected)
    # Numbers may be numbers there.
    path = configuration(tmp_path / "organs.json", **expected)
    assert read_requests(path)[0].options == request.options


@pytest.mark.parametrize(("name", "value", "typed", "sentence"), REFUSED)
def test_a_value_outside_of_the_range_is_refused_everywhere_by_the_same_sentence(
    name, value, typed, sentence, tmp_path, capsys
):
    with pytest.raises(ValueError, match=r"; it must be ") as caught:
        FitOptions(**{name: value})
    assert sentence in str(caught.value)
    with pytest.raises(SystemExit, match="2"):
        cli.main(["fit", "mri.nrrd", "--organ", "a", "--seed", "1,2,3", f"{flag(name)}={typed}"])
    line = capsys.readouterr().err
    assert sentence.rstrip(".") in line
    assert f"argument {flag(name)}: The " in line
    path = configuration(tmp_path / "organs.json", **{name: typed})
    with pytest.raises(ValueError, match=f"key '{name.replace('_', '-')}': The ") as caught:
        read_requests(path)
    assert sentence in str(caught.value)


@pytest.mark.parametrize("value", [None, True, [1.0], {}, "", float("inf"), 10**400])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(ValueError, match="The tolerance is .*; it must be a number from 0.001 to 5 mm"):
        FitOptions(tolerance=value)


@pytest.mark.parametrize("written", ["", " ", "1 2", "0.1,0.2"])
def test_texts_that_are_not_one_number_are_refused(written):
    with pytest.raises(ValueError, match="The tolerance is .*; it must be a number from 0.001 to 5 mm"):
        OPTIONS["tolerance"].read(written)


def test_values_come_in_their_own_types():
    options = FitOptions(net=np.array([11, 9]), tau=np.float32(1.5), max_iterations=np.int64(7), smoothness=0)
    assert (options.net, options.tau, options.max_iterations, options.smoothness) == ((11, 9), 1.5, 7, 0.0)
    kinds = [type(value) for value in (*options.net, options.tau, options.max_iterations, options.smoothness)]
    assert kinds == [int, int, float, int, float]
    assert FitOptions(net=[11.0, 9.0]).net == (11, 9)


def test_levels_are_given_with_their_values_or_not_at_all():
    with pytest.raises(ValueError, match="both grey levels, inside and outside, are needed"):
        FitOptions(levels="given", inside=1.0)
    with pytest.raises(ValueError, match="make it 'given'"):
        FitOptions(inside=1.0)


def test_what_a_fit_has_found_may_lie_beyond_the_ranges():
    assert FitOptions(tau=2.0).filled_in(smoothness=1e-12, net=(129, 67)).smoothness == 1e-12


def test_words_are_those_that_the_library_knows():
    known = {"closure": CLOSURES, "solver": tuple(SOLVERS), "model": tuple(models.GENERIC_MODELS)}
    for name, words in known.items():
        assert tuple(OPTIONS[name].choices) == words
    assert set(MAX_ITERATIONS) == set(SOLVERS)


def test_a_generic_model_that_was_added_is_a_word(monkeypatch):
    monkeypatch.setitem(models.GENERIC_MODELS, "barrel", models.GENERIC_MODELS["ellipsoid"])
    assert FitOptions(model="barrel").model == "barrel"
    with pytest.raises(ValueError, match="one of automatic, ellipsoid, tube, barrel"):
        FitOptions(model="cube")


def test_every_text_is_marked_for_translation():
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "_")
    marked = {call.args[0].value for call in calls}
    texts = {text for each in OPTIONS.values() for text in (each.label, each.help, each.automatic)}
    assert {*texts, *(label for each in OPTIONS.values() for label in each.choices.values())} - {""} <= marked


def test_the_page_holds_the_table():
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    assert option_table() in page


def test_the_help_lists_every_option(capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main(["fit", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    for name, option in OPTIONS.items():
        assert f"{flag(name)} {option.metavar}" in told
        assert option.help[1:] in told
