"""Generic models by their names: which one suits an organ, the tube along a bent one, and one that is added outside."""

from __future__ import annotations

import numpy as np
import pytest
from random_organs import painted, random_organ
from scipy.spatial import cKDTree
from small_phantom import CENTER, ellipsoid, ellipsoid_image
from tubes import RADIUS_MM, bent_tube

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.analysis.reference_meshes import mesh_of_mask
from VICRegistrationLib.geometry import centreline as centreline_module
from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.centreline import centreline
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.moments import moments
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.region_image import region_image
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate

NET = (9, 7)


def shape_of(region):
    """What models are told about a region, in the organ's frame, and that frame."""
    pose = moments(region)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = pose.axes.T, pose.center
    return region_image(region, frame, margin=10.0).shape(pose.extents), frame


def tube_shape(degrees):
    tube = bent_tube(degrees)
    return tube, *shape_of(region_from_mask(tube.image, tube.mask))


def mesh_of(tube):
    return mesh_of_mask(Image(tube.mask.astype(float), tube.image.ijk_to_ras))


# ------------------------------------------------------------------ added from outside


def barrel(shape, net, closure):
    """An ellipsoid with a belly: all that a new model needs."""
    longest, middle, shortest = np.sqrt(5.0) * shape.extents

    def place(sphere):
        x, y, z = sphere.T
        belly = 1.0 + 0.3 * (1.0 - z**2)
        return np.column_stack([longest * z, middle * belly * x, shortest * belly * y])

    return models.drawn(place, net, closure=closure)


@pytest.mark.parametrize("closure", ["smooth", "paper"])
def test_a_model_is_added_by_a_function_and_a_name(monkeypatch, closure):
    monkeypatch.setitem(models.GENERIC_MODELS, "barrel", barrel)
    fit = finish(fit_organ(ellipsoid_image(), CENTER[None], FitOptions(model="barrel", closure=closure)))
    assert fit.options.model == "barrel"
    assert fit.problems == ()
    assert deviation(fit.surface, ellipsoid(), n_points=1000).mean < 0.15


def test_the_model_that_is_named_is_the_one_that_is_scaled():
    image = ellipsoid_image()
    first = {
        name: next(fit_organ(image, CENTER[None], FitOptions(model=name))).surface.control_net
        for name in ("automatic", "ellipsoid", "tube")
    }
    np.testing.assert_array_equal(first["automatic"], first["ellipsoid"])
    assert np.abs(first["tube"] - first["ellipsoid"]).max() > 1.0


def test_an_unknown_model_is_refused():
    with pytest.raises(ValueError, match="The generic model is 'cube'; it must be one of automatic, ellipsoid, tube"):
        FitOptions(model="cube")
    with pytest.raises(ValueError, match="The generic model 'cube' was asked for; choose one of automatic"):
        models.generic_model("cube", tube_shape(90)[1], NET, "smooth")


@pytest.mark.parametrize(
    "wrong",
    [
        lambda shape, net, closure: models.bell(20.0),
        lambda shape, net, closure: models.closed_organ((12, 9), closure=closure),
        lambda shape, net, closure: models.closed_organ(net, closure=closure).turned(),
    ],
    ids=["open", "another net", "inside out"],
)
def test_a_model_that_is_no_closed_organ_with_its_net_is_refused(monkeypatch, wrong):
    monkeypatch.setitem(models.GENERIC_MODELS, "wrong", wrong)
    with pytest.raises(ValueError, match="The generic model 'wrong' has a control net of .* closed by a seam and two"):
        models.generic_model("wrong", tube_shape(90)[1], NET, "smooth")


def test_a_drawn_sphere_is_the_sphere():
    drawn = models.drawn(lambda sphere: 20.0 * sphere, NET)
    np.testing.assert_allclose(drawn.control_net, 20.0 * models.closed_organ(NET).control_net, atol=1e-9)


def test_a_surface_is_met_by_another_net():
    fine = models.closed_organ((33, 25), axes=np.diag([10.0, 14.0, 30.0]), center=(1.0, 2.0, 3.0))
    counts = (48, 36)
    points = fine.points(*fine.midpoints(*counts))
    found = models.closed_through(points, counts, (17, 11), closure="smooth")
    assert np.abs(found.points(*found.midpoints(*counts)) - points).max() < 0.3


# ------------------------------------------------------------------ the centreline


@pytest.mark.parametrize("degrees", [90, 180, 250])
def test_the_axis_of_a_bent_organ_is_found(degrees):
    tube, shape, frame = tube_shape(degrees)
    axis = centreline(shape.inside, shape.lattice)
    points = axis.points @ frame[:3, :3].T + frame[:3, 3]
    off, _ = cKDTree(tube.axis).query(points[np.abs(axis.places) < 0.7])
    # The region is known on a grid of some 1.6 mm.
    assert off.max() < 2.0
    assert axis.bend > 1.5
    widths = np.sqrt(np.abs(np.linalg.det(axis.sections)))[np.abs(axis.places) < 0.3]
    assert widths == pytest.approx(RADIUS_MM, rel=0.2)


def test_splines_are_asked_for_one_coordinate_at_a_time(monkeypatch):
    """Slicer 5.8 has a scipy whose splines take no more."""
    _, shape, _ = tube_shape(90)
    asked = []
    spline = centreline_module.make_smoothing_spline
    monkeypatch.setattr(
        centreline_module, "make_smoothing_spline", lambda x, y, **more: asked.append(y.ndim) or spline(x, y, **more)
    )
    assert centreline(shape.inside, shape.lattice) is not None
    assert asked == [1, 1, 1]


def test_frames_do_not_turn_about_the_axis():
    _, shape, _ = tube_shape(180)
    axis = centreline(shape.inside, shape.lattice)
    across = np.einsum("nka,nkb->nab", axis.frames, axis.frames)
    np.testing.assert_allclose(across, np.broadcast_to(np.eye(2), across.shape), atol=1e-9)
    # In a plane, one direction is that across the plane throughout: seen in the frame, it keeps its place.
    turns = np.einsum("nka,nkb->nab", axis.frames[:-1], axis.frames[1:])
    assert np.abs(turns[:, 0, 1] - turns[:, 1, 0]).max() < 0.05


def test_frames_along_a_helix_turn_as_little_as_can_be():
    # Of a helix with curvature k and torsion w, frames that do not turn about it turn against the normal by the
    # integral of the torsion; double reflection meets that to the fourth order of the steps.
    radius, rise, turns = 20.0, 6.0, 1.5
    t = np.linspace(0.0, 2.0 * np.pi * turns, 81)
    points = np.column_stack([radius * np.cos(t), radius * np.sin(t), rise * t])
    tangents = np.column_stack([-radius * np.sin(t), radius * np.cos(t), np.full(len(t), rise)])
    frames = centreline_module._frames(points, tangents)
    normal = -np.column_stack([np.cos(t), np.sin(t), np.zeros(len(t))])
    angle = np.unwrap(np.arctan2(*np.einsum("nkb,nk->bn", frames, normal)[::-1]))
    torsion = rise / (radius**2 + rise**2) * np.hypot(radius, rise)
    assert abs(angle[-1] - angle[0]) == pytest.approx(torsion * t[-1], abs=1e-6)


def test_specks_have_no_axis():
    inside = np.zeros((20, 20, 20), dtype=bool)
    inside[9:11, 9:11, 9:11] = True
    assert centreline(inside, np.eye(4)) is None
    speck = models.OrganShape(np.ones(3), inside, np.eye(4), lambda points: np.zeros(len(points)))
    with pytest.raises(ValueError, match="too small for a tube; choose the generic model 'ellipsoid'"):
        models.generic_model("tube", speck, NET, "smooth")
    assert models.generic_model("automatic", speck, NET, "smooth").closed


# ------------------------------------------------------------------ tube or ellipsoid


@pytest.mark.parametrize("degrees", [90, 180, 250])
@pytest.mark.parametrize("closure", ["smooth", pytest.param("paper", marks=pytest.mark.long)])
def test_the_tube_lies_along_the_organ(degrees, closure):
    tube, shape, frame = tube_shape(degrees)
    model = models.generic_model("tube", shape, NET, closure)
    found = deviation(model.transformed(frame), mesh_of(tube), n_points=1000)
    assert found.mean < 0.25 * RADIUS_MM


def test_a_bent_tube_is_nearer_than_the_ellipsoid():
    _, shape, _ = tube_shape(100)
    start, tube = (models.generic_model(name, shape, NET, "smooth") for name in ("automatic", "tube"))
    np.testing.assert_array_equal(start.control_net, tube.control_net)


def test_a_straight_organ_is_left_to_the_ellipsoid():
    _, shape, _ = tube_shape(5)
    assert centreline(shape.inside, shape.lattice).bend < 0.5
    start, straight = (models.generic_model(name, shape, NET, "smooth") for name in ("automatic", "ellipsoid"))
    np.testing.assert_array_equal(start.control_net, straight.control_net)


@pytest.mark.parametrize("organ", ["bladder", "vagina", "rectum"])
def test_the_demo_s_organs_need_no_tube(organ, pelvis_regions):
    shape, _ = shape_of(pelvis_regions[organ])
    start, straight = (models.generic_model(name, shape, NET, "smooth") for name in ("automatic", "ellipsoid"))
    np.testing.assert_array_equal(start.control_net, straight.control_net)


@pytest.mark.parametrize("seed", [1062, 1070])
def test_eggs_are_left_to_the_ellipsoid(seed):
    """Their axes are crooked, but tubes along them are farther off."""
    image, seeds = painted(random_organ(seed), seed=seed)
    shape, _ = shape_of(separate(image, seeds))
    assert centreline(shape.inside, shape.lattice).bend > 0.7
    start = models.automatic(shape, NET, "smooth", least_bend=0.7)
    np.testing.assert_array_equal(start.control_net, models.ellipsoid(shape, NET, "smooth").control_net)


@pytest.mark.parametrize("degrees", [100, pytest.param(180, marks=pytest.mark.long), 250])
def test_bent_organs_are_fitted_as_well_as_straight_ones(degrees):
    tube = bent_tube(degrees)
    fit = finish(fit_region(tube.image, region_from_mask(tube.image, tube.mask)))
    assert fit.problems == ()
    # From an ellipsoid along the principal axes: 2.9 mm at 100 degrees, 5.1 mm at 180, and folded beyond. The ends of
    # these tubes are half balls, sharper than a net likes; their mask has steps of 3 mm.
    assert deviation(fit.surface, mesh_of(tube), n_points=1500).mean < 0.5


def test_a_flat_bent_organ_keeps_its_flatness():
    tube = bent_tube(120, flat=2.0)
    fit = finish(fit_region(tube.image, region_from_mask(tube.image, tube.mask)))
    assert fit.problems == ()
    assert deviation(fit.surface, mesh_of(tube), n_points=1500).mean < 0.55
