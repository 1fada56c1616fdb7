"""Files of models: no bit is lost, and a bad file gets one sentence that says what to do."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_model import egg_with_band

from VICRegistrationLib.multipatch.file import is_model_file, model_text, read_model, write_model
from VICRegistrationLib.multipatch.pelvis import pelvis


@pytest.fixture(scope="module")
def content():
    return json.loads(model_text(egg_with_band()))


def written(tmp_path, content):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("model", [pelvis, egg_with_band], ids=["pelvis", "egg"])
def test_a_file_brings_the_same_model_back_to_the_last_bit(model, tmp_path):
    first = model()
    write_model(first, tmp_path / "model.json")
    second = read_model(tmp_path / "model.json")
    np.testing.assert_array_equal(second.points, first.points)
    for before, after in zip(first.patches, second.patches):
        assert (after.name, after.part, after.degrees) == (before.name, before.part, before.degrees)
        np.testing.assert_array_equal(after.indices, before.indices)
        for old, new in zip(before.knots, after.knots):
            np.testing.assert_array_equal(new, old)
    for part in first.parts:
        assert vars(second.part(part.name)) == vars(part)
    for organ, parent in first.parents.items():
        np.testing.assert_array_equal(second.parents[organ].control_net, parent.control_net)
    for place, point in first.landmarks.items():
        np.testing.assert_array_equal(second.landmarks[place], point)
    for place, group in first.fixed.items():
        np.testing.assert_array_equal(second.fixed[place], group)
    assert model_text(second) == model_text(first)
    assert is_model_file(tmp_path / "model.json")


CHANGES = {
    "schema": ({"schema": "vic-registration/surface"}, "has the schema 'vic-registration/surface'.*give a model file"),
    "version": ({"version": 2}, "has version 2; version 1 is understood, update the program"),
    "frame": ({"frame": "LPS"}, "has the frame 'LPS'; convert the model to 'RAS'"),
    "unit": ({"unit": "cm"}, "has the unit 'cm'; convert the model to 'mm'"),
    "points": ({"points": {}}, "The key 'points' of the file .* is not a list; give a list"),
    "name": ({"name": 3}, "The key 'name' of the file .* is not text; give text"),
    "ragged points": ({"points": [[0, 1], [1, 2, 3]]}, "The points must be a list of points"),
    "landmark": ({"landmarks": {"peg": [1, "two", 3]}}, "The landmark 'peg' must be a list of numbers"),
    "fixed": ({"fixed": {"wall": [1.5]}}, "fixed points 'wall' must be a list of whole numbers"),
    "no points": ({"points": []}, "has points numbered"),
    "parts": ({"parts": []}, "The organs are none, with surfaces of egg"),
}


@pytest.mark.parametrize(("change", "message"), CHANGES.values(), ids=CHANGES)
def test_a_file_that_is_no_model_is_refused(change, message, content, tmp_path):
    with pytest.raises(ValueError, match=message):
        read_model(written(tmp_path, {**content, **change}))


@pytest.mark.parametrize("key", ["organs", "points", "landmarks"])
def test_a_file_that_lacks_a_key_is_refused(key, content, tmp_path):
    rest = {word: value for word, value in content.items() if word != key}
    with pytest.raises(ValueError, match=f"lacks {key}; write the model again with all keys"):
        read_model(written(tmp_path, rest))


PARTS = {
    "an organ's key": (("organs", "egg", "cuts_u"), None, "The organ 'egg' lacks cuts_u"),
    "cuts": (("organs", "egg", "cuts_v"), [0.0, 0.25, 0.75, 0.9], "'egg': The cuts in v reach from 0 to 0.9"),
    "count": (("organs", "egg", "points"), 3, "The organ 'egg' is said to have 3 points; its net and cuts give"),
    "knots": (("patches", 0, "knots_u"), [0, 0, 1, 1], "degree 3 needs at least 8"),
    "degrees": (("patches", 0, "degrees"), [3, 3.0], r"'band' has the degrees \[3, 3.0\]; give two whole numbers"),
    "net": (
        ("organs", "egg", "control_net"),
        [[[1, 2]]],
        "The control_net of 'egg' must be rows of",
    ),
    "a number for a net": (
        ("organs", "egg", "control_net"),
        5,
        "The control_net of 'egg' must be rows of",
    ),
    "indices": (
        ("patches", 0, "indices"),
        [[1], [1, 2]],
        "The indices of 'band' must be rows of",
    ),
    "index": (("patches", 0, "indices", 0, 0), -1, "'band' has points numbered -1"),
    "part": (("patches", 0, "part"), "ribbon", "The patch 'band' belongs to 'ribbon', which is no part"),
    "name": (("patches", 1, "name"), "band", "'band' is there twice"),
    "kind": (("parts", 1, "kind"), "muscle", "'band' is of the kind 'muscle'; choose one of organ, sheet, cord"),
    "thickness": (("parts", 1, "thickness"), None, "'band' has the thickness None; give a positive number of mm"),
    "foot": (("parts", 2, "foot"), "toe", "'string' stands on 'toe', which is no patch"),
}


@pytest.mark.parametrize(("place", "value", "message"), PARTS.values(), ids=PARTS)
def test_what_is_wrong_inside_is_said_with_its_name(place, value, message, content, tmp_path):
    content = json.loads(json.dumps(content))
    holder = content
    for step in place[:-1]:
        holder = holder[step]
    if value is None and place[0] == "organs":
        del holder[place[-1]]
    else:
        holder[place[-1]] = value
    with pytest.raises(ValueError, match=message):
        read_model(written(tmp_path, content))


def test_a_file_that_is_missing_or_no_json_is_refused(tmp_path):
    with pytest.raises(OSError, match="cannot be read .*; give a file that exists"):
        read_model(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"schema": ')
    with pytest.raises(ValueError, match="is not valid JSON"):
        read_model(tmp_path / "half.json")
    assert not is_model_file(tmp_path / "none.json")
