"""Volumes under parent transforms: everything lands where the transform takes the organ, whatever kind it is."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.analysis.distances import deviation

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

ELLIPSOID_ML = 4.0 / 3.0 * np.pi * 14.0 * 18.0 * 22.0 / 1000.0
# The phantom has slices of 3 mm and noise: so near is the fit to the truth without any transform.
NEAR_MM = 0.25


def scaling():
    """Stretched by half along one oblique direction, and mirrored: left becomes right."""
    turn = motion(30, (1, 1, 0))
    return turn @ np.diag([1.5, -1.0, 1.1, 1.0]) @ np.linalg.inv(turn)


MATRICES = {
    "rotation": motion(75, (1, 2, -1), (30, -60, 12)),
    "scaling and mirror": scaling(),
    "identity": np.eye(4),
}


def applied(matrix):
    return lambda points: np.atleast_2d(points) @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("name", MATRICES)
def test_under_a_linear_transform_the_organ_is_where_the_transform_takes_it(logic, name):
    matrix = MATRICES[name]
    volume = mrml_scenes.add_volume(under=mrml_scenes.add_linear_transform(matrix))
    organ = logic.fit(volume, applied(matrix)(CENTER))
    truth = mrml_scenes.true_triangles(applied(matrix))
    distances = mrml_scenes.distances_to(truth, mrml_scenes.hardened_points(organ.surface)[::5])
    stretch = np.linalg.norm(matrix[:3, :3], 2)
    assert distances.mean() < NEAR_MM * stretch


@pytest.mark.parametrize("name", MATRICES)
def test_the_fit_does_not_depend_on_a_linear_transform(logic, name):
    expected = logic.surface(logic.fit(mrml_scenes.add_volume(), [CENTER])).control_net
    matrix = MATRICES[name]
    volume = mrml_scenes.add_volume(under=mrml_scenes.add_linear_transform(matrix))
    found = logic.surface(logic.fit(volume, applied(matrix)(CENTER))).control_net
    # The seed comes back through the inverse of the matrix; rounding may move it by as little as this.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", MATRICES)
def test_the_volume_is_that_in_the_world(logic, name):
    factor = abs(np.linalg.det(MATRICES[name][:3, :3]))
    volume = mrml_scenes.add_volume(under=mrml_scenes.add_linear_transform(MATRICES[name]))
    seed = applied(MATRICES[name])(CENTER)
    organ = logic.addOrgan(volume, seed)
    region_ml = np.count_nonzero(mrml_scenes.segment_voxels(organ, volume)) * 1.2 * 1.2 * 3.0 / 1000.0
    assert organ.volumeMl == pytest.approx(region_ml * factor, rel=1e-9)
    organ = logic.fit(volume, seed)
    assert organ.volumeMl == pytest.approx(logic.surface(organ).volume() / 1000.0 * factor, rel=1e-9)


def test_an_oblique_volume_under_a_chain_of_transforms(logic):
    outer = mrml_scenes.add_linear_transform(MATRICES["rotation"])
    inner = mrml_scenes.add_linear_transform(motion(20, (0, 1, 1), (5, 5, 5)))
    inner.SetAndObserveTransformNodeID(outer.GetID())
    local = motion(40, (1, 2, -1), (10, -5, 3))
    whole = MATRICES["rotation"] @ motion(20, (0, 1, 1), (5, 5, 5)) @ local
    volume = mrml_scenes.add_volume(mrml_scenes.oblique(matrix=local), under=inner)
    organ = logic.fit(volume, applied(whole)(CENTER))
    truth = mrml_scenes.true_triangles(applied(whole))
    assert mrml_scenes.distances_to(truth, mrml_scenes.hardened_points(organ.surface)[::5]).mean() < NEAR_MM


NONLINEAR = {
    "thin plate spline": lambda: (mrml_scenes.thin_plate_spline(), False),
    "thin plate spline from the parent": lambda: (mrml_scenes.thin_plate_spline(), True),
    "displacement grid": lambda: (mrml_scenes.displacement_grid(), False),
    "displacement grid from the parent": lambda: (mrml_scenes.displacement_grid(), True),
}


@pytest.fixture(params=NONLINEAR)
def bent(request, scene):
    """A volume under a nonlinear transform, and what takes its local frame to the world."""
    transform, from_parent = NONLINEAR[request.param]()
    node = mrml_scenes.add_nonlinear_transform(transform, from_parent=from_parent)
    # Made anew, so that what is expected does not come from the node.
    other, _ = NONLINEAR[request.param]()
    if from_parent:
        other.Inverse()
    return mrml_scenes.add_volume(under=node), lambda points: mrml_scenes.through(other, points)


def test_under_a_nonlinear_transform_the_organ_is_where_the_transform_takes_it(logic, bent):
    volume, to_world = bent
    # The bend is seen: the seed is elsewhere, and the truth is no ellipsoid.
    assert np.linalg.norm(to_world(CENTER) - CENTER) > 0.5
    organ = logic.fit(volume, to_world(CENTER))
    truth = mrml_scenes.true_triangles(to_world)
    found = mrml_scenes.hardened_points(organ.surface)[::20]
    assert mrml_scenes.distances_to(truth, found).mean() < NEAR_MM * 1.3
    assert mrml_scenes.distances_to(mrml_scenes.true_triangles(np.asarray), found).mean() > 1.0


def test_the_volume_under_a_nonlinear_transform_is_near_that_in_the_world(logic, bent):
    volume, to_world = bent
    true_ml = mrml_scenes.enclosed_ml(mrml_scenes.true_triangles(to_world))
    # The voxels of the region are worth some per cent, the fit is worth 3 %.
    assert logic.addOrgan(volume, to_world(CENTER)).volumeMl == pytest.approx(true_ml, rel=0.06)
    assert logic.fit(volume, to_world(CENTER)).volumeMl == pytest.approx(true_ml, rel=0.03)


def test_the_fit_does_not_depend_on_a_nonlinear_transform(logic, bent):
    volume, to_world = bent
    expected = logic.surface(logic.fit(mrml_scenes.add_volume(name="straight"), [CENTER])).control_net
    found = logic.surface(logic.fit(volume, to_world(CENTER))).control_net
    # Inverses of nonlinear transforms are found by iteration, to 1e-3 mm: the seed stays in its voxel.
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02)


def test_points_come_back_from_the_world(logic, bent):
    from VICRegistrationLib.mrml.volumes import localPoints, worldPoints

    volume, to_world = bent
    points = CENTER + np.array([[0, 0, 0], [10, 4, -7], [-12, 15, 20]])
    np.testing.assert_allclose(worldPoints(volume, points), to_world(points), atol=5e-3)
    np.testing.assert_allclose(localPoints(volume, worldPoints(volume, points)), points, atol=5e-3)


def test_everything_is_under_the_transform_of_the_volume(logic):
    node = mrml_scenes.add_linear_transform(MATRICES["rotation"])
    volume = mrml_scenes.add_volume(under=node)
    organ = logic.fit(volume, applied(MATRICES["rotation"])(CENTER), boundaryPoints=np.empty((0, 3)))
    for below in (organ.seeds, organ.boundaryPoints, organ.regions, organ.surface):
        assert below.GetParentTransformNode() is node


@pytest.mark.parametrize("change", ["matrix", "node", "none", "nonlinear"])
def test_everything_follows_when_the_volume_is_moved_later(logic, change):
    from VICRegistrationLib.mrml.organ_nodes import followVolume

    node = mrml_scenes.add_linear_transform(MATRICES["rotation"])
    volume = mrml_scenes.add_volume(under=node)
    organ = logic.fit(volume, applied(MATRICES["rotation"])(CENTER))
    surface = logic.surface(organ).control_net
    to_world = applied(motion(-20, (0, 0, 1), (0, 5, 0)))
    if change == "matrix":
        moved = slicer.util.vtkMatrixFromArray(motion(-20, (0, 0, 1), (0, 5, 0)))
        node.SetMatrixTransformToParent(moved)
    elif change == "node":
        other = mrml_scenes.add_linear_transform(motion(-20, (0, 0, 1), (0, 5, 0)))
        volume.SetAndObserveTransformNodeID(other.GetID())
    elif change == "none":
        volume.SetAndObserveTransformNodeID(None)
        to_world = applied(np.eye(4))
    else:
        spline = mrml_scenes.thin_plate_spline()
        volume.SetAndObserveTransformNodeID(mrml_scenes.add_nonlinear_transform(spline).GetID())
        to_world = lambda points: mrml_scenes.through(spline, points)  # noqa: E731
    followVolume(organ, volume)
    found = mrml_scenes.hardened_points(organ.surface)[::5]
    truth = mrml_scenes.true_triangles(to_world)
    assert mrml_scenes.distances_to(truth, found).mean() < NEAR_MM * 1.3
    seed = slicer.util.arrayFromMarkupsControlPoints(organ.seeds, world=True)
    np.testing.assert_allclose(seed, to_world(CENTER), atol=1e-6)
    # Nothing was lost on the way, and a new fit is the same.
    again = logic.fit(volume, seed)
    np.testing.assert_allclose(logic.surface(again).control_net, surface, rtol=0, atol=0.02)
    assert deviation(logic.surface(organ), ellipsoid(), n_points=500).mean < NEAR_MM
