"""The model of several organs: exact pieces, shared points, and the generic pelvis."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from patch_measures import angle_along_borders, distance_from_surfaces

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.multipatch.cuts import OrganCuts
from VICRegistrationLib.multipatch.model import Part, Patch, assembled
from VICRegistrationLib.multipatch.pelvis import pelvis

CUTS = {
    "at knots, across the seam": ([0.125, 0.5, 0.875], [0.0, 0.25, 0.5, 1.0]),
    "between knots": ([0.03, 0.41, 0.7], [0.0, 0.33, 1.0]),
    "from the seam on": ([0.0, 0.3, 0.5], [0.0, 0.6, 1.0]),
    "one row": ([0.2, 0.6], [0.0, 1.0]),
}


def named(cuts):
    u, v = cuts
    return OrganCuts(u, v, [[f"{i}, {j}" for j in range(len(v) - 1)] for i in range(len(u))])


@pytest.fixture(scope="module")
def egg():
    return closed_organ((9, 7), axes=[[0, 20, 0], [0, 0, 14], [31, 0, 0]], center=(5, -3, 8))


@pytest.fixture(scope="module")
def generic():
    return pelvis()


def one_organ(parent, cuts):
    return assembled({"egg": parent}, {"egg": cuts}, [Part("egg", "organ")])


@pytest.mark.parametrize("cuts", CUTS.values(), ids=CUTS)
def test_patches_are_exact_pieces_of_the_closed_surface(egg, cuts):
    # Rounding of a few sums of numbers of 30 mm.
    assert distance_from_surfaces(one_organ(egg, named(cuts)), 6) < 2e-13


def test_pieces_of_a_seam_that_is_not_smooth_begin_at_the_seam():
    paper = closed_organ((9, 7), closure="paper", axes=16.0 * np.eye(3))
    assert distance_from_surfaces(one_organ(paper, named(CUTS["from the seam on"])), 6) < 2e-13
    with pytest.raises(ValueError, match="'egg': The seam of the surface is not as smooth.*first cut in u at the seam"):
        one_organ(paper, named(CUTS["between knots"]))


def test_every_point_of_an_organ_follows_from_few_control_points(egg):
    matrix = one_organ(egg, named(CUTS["from the seam on"])).organ_matrix("egg")
    # Four in each direction.
    assert np.diff(matrix.indptr).max() <= 16
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize(
    ("u", "v", "names", "message"),
    [
        ([0.5, 0.2], [0, 1], [["a"], ["b"]], "cuts in u are .* ascending"),
        ([0.2], [0, 1], [["a"]], "at least two"),
        ([0.2, 0.5], [0, 1], [["a"]], "1 columns with 1 names were given; the cuts make 2 columns of 1 patches"),
        ([0.2, 1.3], [0, 1], [["a"], ["b"]], "'egg': The cuts in u reach from 0.2 to 1.3"),
        ([0.2, 0.5], [0, 0.5], [["a"], ["b"]], "must reach from 0 to 1"),
        ([0.2, 0.5], [0, 1], [["a"], ["a"]], "'a' is there twice"),
    ],
)
def test_cuts_that_make_no_patches_are_refused(egg, u, v, names, message):
    with pytest.raises(ValueError, match=message):
        one_organ(egg, OrganCuts(u, v, names))


def test_an_index_without_a_point_is_refused(egg):
    patch = Patch("band", "band", (1, 1), ([0, 0, 1, 1], [0, 0, 1, 1]), np.array([[0, 1], [2, 9999]]))
    cuts = named(CUTS["one row"])
    with pytest.raises(ValueError, match="'band' has points numbered 0 to 9999; the model has"):
        assembled({"egg": egg}, {"egg": cuts}, [Part("egg", "organ"), Part("band", "sheet", 1.0)], free_patches=[patch])


def test_the_pelvis_has_the_parts_and_patches_that_a_simulation_needs(generic):
    kinds = {part.name: part.kind for part in generic.parts}
    assert generic.organs == ("bladder", "vagina", "rectum")
    # Table 3 of the paper.
    assert [len(generic.patches_of(organ)) >= least for organ, least in zip(generic.organs, (14, 14, 20))] == [True] * 3
    for side in ("right", "left"):
        assert kinds[f"{side} uterosacral ligament"] == kinds[f"{side} pubourethral ligament"] == "cord"
        for sheet in ("cardinal ligament", "pubocervical fascia", "rectovaginal fascia"):
            assert kinds[f"{side} {sheet}"] == "sheet"
    assert kinds["levator ani"] == "sheet"
    assert {part.name for part in generic.parts if not part.estimated} == set(generic.organs)
    assert len(generic.landmarks) == 6


def test_the_fine_pelvis_has_the_paper_s_numbers_of_control_points():
    ranges = pelvis(fine=True).ranges()
    # 1098 is no number that a cut net of four columns can have; 1094 is the nearest sensible one.
    assert [part.stop - part.start for part in ranges.values()] == [4608, 1017, 1094]


def test_what_is_attached_begins_at_an_organ_s_border(generic):
    for part in generic.parts:
        if part.kind == "sheet":
            begins = [patch.indices[:, 0] for patch in generic.patches_of(part.name)]
            assert any(indices.max() < generic.first_free for indices in begins), part.name
        if part.kind == "cord":
            foot, sides = generic.patch(part.foot), generic.patches_of(part.name)[:4]
            shared = np.concatenate([np.intersect1d(side.indices, foot.indices) for side in sides])
            assert set(shared) == set(np.concatenate(list(foot.borders().values())))


def test_a_map_leaves_the_model_watertight_and_organs_follow_their_surfaces(generic):
    shift = np.array([3.0, -2.0, 1.0])
    turn = np.eye(4)
    turn[:3, :3] = [[0.9, -0.1, 0], [0.1, 1.1, 0], [0, 0.05, 1]]
    moved = generic.carried(
        {name: parent.transformed(turn) for name, parent in generic.parents.items()}, lambda points: points + shift
    )
    organs = generic.first_free
    np.testing.assert_array_equal(moved.points[organs:], generic.points[organs:] + shift)
    np.testing.assert_allclose(moved.points[:organs], generic.points[:organs] @ turn[:3, :3].T, atol=1e-12)
    np.testing.assert_array_equal(moved.landmarks["coccyx, tip"], generic.landmarks["coccyx, tip"] + shift)
    assert moved.patches is generic.patches


def test_a_carried_model_needs_every_organ_with_its_knots(generic):
    parents = dict(generic.parents)
    with pytest.raises(ValueError, match="'rectum' has other degrees or knots"):
        generic.carried({**parents, "rectum": parents["rectum"].refined()}, lambda points: points)
    del parents["rectum"]
    with pytest.raises(ValueError, match="organ 'rectum' is missing"):
        generic.carried(parents, lambda points: points)


def test_organs_patches_meet_as_smoothly_as_their_surface(generic):
    assert angle_along_borders(generic, 9) < 1e-4


def test_the_code_of_the_page_draws_a_good_model(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).resolve().parents[2] / "docs" / "generic-model.md"
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        # Others are for Slicer's Python console.
        if "Drawing" in block:
            exec(compile(block, page.name, "exec"), names)
    assert names["model"].patch("band").part == "band"
    assert capsys.readouterr().out == "[]\n"
    assert (tmp_path / "egg.json").is_file()


def test_a_format_that_no_model_has_is_refused(generic, tmp_path):
    with pytest.raises(ValueError, match="organ.obj was asked for; give a file name that ends in .png, .json, .step"):
        generic.save(tmp_path / "organ.obj")
    assert list(tmp_path.iterdir()) == []
