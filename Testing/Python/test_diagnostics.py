"""What looks wrong with a region or a fit, by codes and values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_phantom import CENTER

import VICRegistrationLib as vic
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.diagnostics import border_sides, fit_diagnostics
from VICRegistrationLib.registration.verdict import verdict_of


def test_a_sound_fit_gives_no_warning(small_image, small_fit):
    assert fit_diagnostics(small_image, small_fit) == []


def test_a_thin_part_that_the_surface_leaves_out_is_told_with_its_side(small_image, small_fit):
    image, found = small_image, small_fit
    mask = found.region.mask
    k, j, i = np.argwhere(mask)[np.argmax(np.argwhere(mask)[:, 0])]
    # A tail of 2 x 2 voxels at the last slice, as long as the mask is deep.
    tail = np.zeros((len(mask), *mask.shape[1:]), dtype=bool)
    tail[:, j : j + 2, i : i + 2] = True
    longer = replace(found, region=replace(found.region, mask=np.concatenate([mask, tail])))
    (told,) = fit_diagnostics(image, longer)
    length = round(len(mask) * float(image.spacing[2]))
    assert told.code == "part_left_out"
    assert abs(told.values["reach_mm"] - length) <= 4
    assert told.values["side"] == border_sides(image, replace(found.region, touches_border=("k+",)))[0]
    # A larger net leaves thin parts out as well.
    assert "place points on the wall" in told.sentence()
    # A region that further stacks have completed counts in place of the one that was cut.
    assert fit_diagnostics(image, replace(found, whole_region=longer.region)) == [told]


def test_a_surface_that_reaches_beyond_its_region_leaves_nothing_out(small_image, small_fit):
    mask = small_fit.region.mask.copy()
    # Without the last 6 mm of the organ in one direction.
    mask[:, np.flatnonzero(mask.any(axis=(0, 2)))[-5:]] = False
    assert fit_diagnostics(small_image, replace(small_fit, region=replace(small_fit.region, mask=mask))) == []


def test_a_boundary_point_where_the_image_shows_no_edge_is_told(small_image, small_fit):
    # On the wall at the left, and 5 mm outside of it at the front, in the middle of what lies around the lumen.
    points = CENTER + np.array([[-14.0, 0.0, 0.0], [0.0, 23.0, 0.0]])
    found = vic.refit(small_image, small_fit.surface, small_fit.options, boundary_points=points)
    told = [
        diagnostic for diagnostic in fit_diagnostics(small_image, found) if diagnostic.code == "points_without_edge"
    ]
    assert told == [Diagnostic("points_without_edge", {"count": 1, "points": 2})]
    assert verdict_of(found, told).word == "check"
    found = vic.refit(small_image, small_fit.surface, small_fit.options, boundary_points=points[:1])
    assert fit_diagnostics(small_image, found) == []


def test_boundary_points_that_contradict_each_other_are_told_with_the_distance_left(small_image, small_fit):
    # Both in front of the organ, on one normal: one on the wall, one 4 mm outside of it.
    points = CENTER + np.array([[0.0, 18.0, 0.0], [0.0, 22.0, 0.0]])
    found = vic.refit(small_image, small_fit.surface, small_fit.options, boundary_points=points)
    (told,) = [diagnostic for diagnostic in fit_diagnostics(small_image, found) if diagnostic.code == "points_left"]
    left = np.abs(boundary_deviations(found.surface, points)).max()
    assert told == Diagnostic("points_left", {"count": 2, "points": 2, "left_mm": left})
    assert 1.5 < left < 2.5
    assert verdict_of(found, [told]).word == "check"


def test_the_stage_that_did_not_converge_is_that_of_the_surface_that_is_kept(small_image, small_fit):
    *earlier, last = small_fit.history
    last = replace(last, stopped_by="iterations", displacement=0.3)
    kept = replace(last, stage="coarser net kept", iteration=1, displacement=0.0)
    (told,) = fit_diagnostics(small_image, replace(small_fit, converged=False, history=(*earlier, last, kept)))
    values = {"iterations": last.iteration, "stage": last.stage, "displacement_mm": 0.3}
    assert told == Diagnostic("still_moving", values)


def test_the_sides_of_the_border_are_those_of_the_patient(small_image, small_fit):
    # Slices run from left to right (k), pixels from front to back (i) and from top to bottom (j).
    whole, region = small_image, small_fit.region
    assert border_sides(whole, region) == []
    touching = replace(region, touches_border=("k+", "j-", "i+"))
    assert border_sides(whole, touching) == ["right", "superior", "posterior"]


def test_what_looks_wrong_about_a_fit_is_found(small_image, small_fit):
    image, found, region = small_image, small_fit, small_fit.region
    inside_out = found.surface.transformed(np.diag([-2.0, 1.0, 1.0, 1.0]))
    leak = Diagnostic(
        "region_larger_than_seen", {"region_ml": 9.0, "seen_ml": 5.0, "low": 1, "high": 2, "erosion_mm": 2}
    )
    bad = replace(
        found,
        surface=inside_out,
        converged=False,
        cost_final=0.7,
        region=replace(region, diagnostics=(leak,)),
        history=(*found.history[:-1], replace(found.history[-1], stopped_by="no better point")),
    )
    told = fit_diagnostics(image, bad)
    assert [found.code for found in told] == [
        "invalid_surface",
        "no_further_step",
        "region_larger_than_seen",
        "no_clear_edge",
        "no_edge_in_places",
        "volume_differs",
        "part_left_out",
    ]
    assert told[0].values["problem"].code == "inside_out"
    assert told[2] is leak
    # What helps somebody with the control net at hand is not for them.
    sentences = [found.sentence() for found in told]
    assert not [sentence for sentence in sentences if "control net" in sentence or "weight" in sentence]
    assert all(sentence[0].isupper() and sentence.endswith(".") for sentence in sentences)
