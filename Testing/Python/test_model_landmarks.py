"""Landmarks come from Slicer's point lists or from an object of names."""

from __future__ import annotations

import json

import numpy as np
import pytest

from VICRegistrationLib.multipatch.landmarks import read_landmarks


def written(tmp_path, content, name="marks.json"):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def markups(points, system="LPS"):
    entries = [{"label": name, "position": place, **more} for name, place, more in points]
    return {"markups": [{"type": "Fiducial", "coordinateSystem": system, "controlPoints": entries}]}


def test_an_object_of_names_is_in_ras(tmp_path):
    found = read_landmarks(written(tmp_path, {"coccyx, tip": [1, 2, 3.5]}))
    assert list(found) == ["coccyx, tip"]
    assert np.array_equal(found["coccyx, tip"], [1.0, 2.0, 3.5])


@pytest.mark.parametrize(
    ("system", "expected"), [("LPS", [-1.0, -2.0, 3.0]), ("RAS", [1.0, 2.0, 3.0]), (None, [-1.0, -2.0, 3.0])]
)
def test_a_point_list_of_slicer_says_its_frame_or_is_in_lps(tmp_path, system, expected):
    content = markups([("coccyx, tip", [1, 2, 3], {})], system)
    if system is None:
        del content["markups"][0]["coordinateSystem"]
    path = written(tmp_path, content, "marks.mrk.json")
    assert np.array_equal(read_landmarks(path)["coccyx, tip"], expected)


def test_points_that_are_not_placed_are_left_out(tmp_path):
    points = [("a", [1, 2, 3], {"positionStatus": "defined"}), ("b", None, {"positionStatus": "undefined"})]
    assert list(read_landmarks(written(tmp_path, markups(points)))) == ["a"]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("{", "not valid JSON"),
        ({}, "holds no landmarks"),
        ([1, 2], "holds no landmarks"),
        ({"a": [1, 2]}, r"'a' in .* is \[1, 2\]; three numbers R, A, S"),
        ({"a": [1, 2, "x"]}, "three numbers R, A, S"),
        ({"markups": [{}]}, "no point list of Slicer"),
        (markups([("a", [1, 2, 3], {}), ("a", [1, 2, 4], {})]), "hold 'a' twice"),
    ],
)
def test_what_is_no_file_of_landmarks_is_refused(tmp_path, content, told):
    with pytest.raises(ValueError, match=told):
        read_landmarks(written(tmp_path, content))


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(OSError, match="cannot be read"):
        read_landmarks(tmp_path / "none.json")
