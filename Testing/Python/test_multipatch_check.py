"""What is wrong with a model is found and reported with the names of its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_model import egg_with_band

from VICRegistrationLib.multipatch.check import check_model, require_meshable
from VICRegistrationLib.multipatch.model import MultiPatchModel
from VICRegistrationLib.multipatch.pelvis import pelvis


@pytest.fixture(scope="module")
def model():
    return egg_with_band()


def codes(model: MultiPatchModel) -> list[str]:
    return [diagnostic.code for diagnostic in check_model(model)]


def first_sentence(model: MultiPatchModel) -> str:
    return check_model(model)[0].sentence()


def of_other_points(model, name, indices):
    patches = [
        replace(patch, indices=indices(patch.indices)) if patch.name == name else patch for patch in model.patches
    ]
    return replace(model, patches=tuple(patches))


def moved(model, numbers, shift):
    points = model.points.copy()
    points[numbers] += shift
    return replace(model, points=points)


def scaled(model, matrix):
    """The model after a linear map, as if its file was in another unit or frame."""
    matrix = np.asarray(matrix, dtype=float)
    whole = np.eye(4)
    whole[:3, :3] = matrix
    parents = {name: parent.transformed(whole) for name, parent in model.parents.items()}
    return model.carried(parents, lambda points: points @ matrix.T)


@pytest.mark.parametrize("make", [egg_with_band, pelvis, lambda: pelvis(fine=True)], ids=["egg", "pelvis", "fine"])
def test_nothing_is_wrong_with_the_models_that_are_drawn(make):
    assert check_model(make()) == ()


def test_a_sheet_that_shares_no_points_is_found_and_refused(model):
    own = len(model.points) + np.arange(model.patch("band").indices.shape[0])
    points = np.concatenate([model.points, model.points[model.patch("band").indices[:, 0]]])
    loose = of_other_points(replace(model, points=points), "band", lambda old: np.column_stack([own, old[:, 1:]]))
    assert first_sentence(loose).startswith("band shares no points with any other part")
    with pytest.raises(ValueError, match="cannot be meshed: band shares no points"):
        require_meshable(loose)


def test_a_cord_beside_its_foot_is_found(model):
    parts = [replace(part, foot="egg middle third") if part.name == "string" else part for part in model.parts]
    assert "string shares 5 of the 18 points" in first_sentence(replace(model, parts=tuple(parts)))


def test_a_cord_that_is_turned_inside_out_somewhere_is_found(model):
    assert "string does not bound a solid" in first_sentence(
        of_other_points(model, "string end", lambda old: old[::-1])
    )


def test_a_folded_patch_is_found(model):
    middle = model.patch("band").indices[:, 2]
    assert "The patch band is folded at R" in first_sentence(moved(model, middle, (0, 60, 0)))


def test_a_sheet_and_a_cord_through_an_organ_are_found(model):
    band = model.patch("band").indices[:, 1:].ravel()
    assert "band passes through egg" in first_sentence(moved(model, band, (0, 45, 5)))
    # The right ligament, led straight to the sacrum, meets the rectum.
    generic = pelvis()
    cord = generic.indices_of("right uterosacral ligament")
    free = cord[cord >= generic.first_free]
    (found,) = check_model(moved(generic, free, (-16, 0, 0)))
    assert found.code == "passes_through_organ"
    assert (found.values["part"], found.values["organ"]) == ("right uterosacral ligament", "rectum")
    assert found.values["depth_mm"] > 1.0


def test_a_sheet_through_a_cord_is_found():
    generic = pelvis()
    end = generic.patch("right pubocervical fascia").indices[:, 1:].ravel()
    found = {
        (item.code, item.values["cord"])
        for item in check_model(moved(generic, end, (-16, 8, 18)))
        if "cord" in item.values
    }
    assert ("passes_through_cord", "right pubourethral ligament") in found


def test_a_sheet_through_a_sheet_is_found_though_both_begin_at_one_corner():
    generic = pelvis()
    end = generic.patch("right pubocervical fascia").indices[:, 1:].ravel()
    found = check_model(moved(generic, end, (0, 0, -25)))
    assert ("right pubocervical fascia", "levator ani") in {
        (item.values["part"], item.values["sheet"]) for item in found if item.code == "passes_through_sheet"
    }


def test_nothing_is_wrong_with_a_model_without_a_sheet(model):
    parts, patches = ([each for each in whole if "band" not in each.name] for whole in (model.parts, model.patches))
    assert check_model(replace(model, parts=tuple(parts), patches=tuple(patches))) == ()


def test_another_unit_is_found_and_refused(model):
    centimetres = scaled(model, np.eye(3) / 10.0)
    assert "egg is 8.5 mm large" in first_sentence(centimetres)
    with pytest.raises(ValueError, match=r"cannot be meshed: egg is 8\.5 mm large"):
        require_meshable(centimetres)


def test_a_landmark_far_from_everything_is_found(model):
    far = replace(model, landmarks={**model.landmarks, "toe": np.array([0.0, 0.0, -700.0])})
    assert codes(far) == ["model_landmark_far"]
    assert "The landmark toe at R 0, A 0, S -700 mm is 6" in first_sentence(far)


def test_another_frame_is_found():
    turned = scaled(pelvis(), np.diag([-1.0, -1.0, 1.0]))
    assert "The model may be in another frame (LPS)" in first_sentence(turned)


def test_an_organ_that_is_inside_out_is_found(model):
    assert codes(scaled(model, np.diag([1.0, 1.0, -1.0])))[0] == "organ_invalid"


def test_organs_that_overlap_are_found_once():
    generic = pelvis()
    # The gap between the rectum and the vagina is 4 mm wide.
    shift = np.eye(4)
    shift[1, 3] = 8.0
    parents = {**generic.parents, "rectum": generic.parents["rectum"].transformed(shift)}
    found = [
        item for item in check_model(generic.carried(parents, lambda points: points)) if item.code == "organs_overlap"
    ]
    assert [(item.values["part"], item.values["organ"]) for item in found] == [("vagina", "rectum")]
    assert found[0].values["depth_mm"] == pytest.approx(3.8, abs=0.3)
