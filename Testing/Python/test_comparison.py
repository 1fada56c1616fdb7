"""Comparison of a fitted surface with a reference, on shapes whose measures are known."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.analysis.comparison import compare, distances_from
from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, mesh_of_mask
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image

CENTER = np.array([12.0, -7.0, 30.0])
# The net of 25 x 19 is a ball to 1e-5 of its radius; triangles with this error lie up to 0.01 mm inside.
CHORD = 0.01


def ball(radius, shift=(0.0, 0.0, 0.0)):
    return closed_organ((25, 19), axes=radius * np.eye(3), center=CENTER + shift)


def mesh_of(surface):
    mesh = triangulate(surface, chord_error=CHORD)
    return ReferenceMesh(mesh.points, mesh.triangles)


@pytest.fixture(scope="module")
def outer_and_inner():
    return compare(ball(31.0), ball(30.0), n_points=1000, tolerances=(0.9, 1.1))


@pytest.fixture(scope="module")
def shifted():
    return compare(ball(30.0, (3.0, 0.0, 0.0)), mesh_of(ball(30.0)))


# ------------------------------------------------------------------ known shapes


def test_concentric_balls_are_their_radii_apart(outer_and_inner):
    for way in (outer_and_inner.to_surface, outer_and_inner.to_reference):
        assert (way.mean, way.rms, way.median, way.p95, way.maximum) == pytest.approx([1.0] * 5, abs=1e-4)
        assert way.std < 1e-4
        assert way.n == 1000
    assert outer_and_inner.hausdorff == pytest.approx(1.0, abs=1e-4)
    assert outer_and_inner.surface_dice == ((0.9, 0.0), (1.1, 1.0))


def test_the_fitted_surface_outside_is_positive_both_ways(outer_and_inner):
    assert outer_and_inner.to_surface.mean_signed == pytest.approx(1.0, abs=1e-4)
    assert outer_and_inner.to_reference.mean_signed == pytest.approx(1.0, abs=1e-4)
    assert outer_and_inner.volume_difference_ml == pytest.approx(4.18879e-3 * (31.0**3 - 30.0**3), rel=1e-3)
    inside = compare(ball(29.0), mesh_of(ball(30.0)), n_points=500)
    assert inside.signed_to_surface.max() < 0.0
    assert inside.signed_to_reference.max() < 0.0
    assert inside.volume_difference_ml < 0.0


def test_the_volume_dice_of_balls_is_that_of_the_formula(outer_and_inner, shifted):
    # Nested: 2 r^3 / (r^3 + R^3). Shifted by d: the lens of two equal balls, (1 - d / 2R)^2 (1 + d / 4R).
    assert outer_and_inner.volume_dice == pytest.approx(2.0 * 30.0**3 / (30.0**3 + 31.0**3), abs=1e-3)
    assert shifted.volume_dice == pytest.approx((1.0 - 0.05) ** 2 * (1.0 + 0.025), abs=1e-3)


def test_a_shifted_ball_has_the_distances_of_a_shift(shifted):
    # Along the normal, a shift d is d cos(theta) - d^2 sin^2(theta) / 2R: of the size d / 2 in the mean. The standard
    # error of 10,000 points is 0.6 %.
    for way in (shifted.to_surface, shifted.to_reference):
        assert way.mean == pytest.approx(1.5, rel=0.02)
        assert way.rms == pytest.approx(3.0 / np.sqrt(3.0), rel=0.02)
        assert way.maximum <= 3.0 + CHORD
    assert shifted.hausdorff == pytest.approx(3.0, abs=0.02)
    # |cos| below 1/3 and 2/3 on a third and two thirds of a ball; the second order of the shift moves it by 0.002.
    assert dict(shifted.surface_dice) == pytest.approx({0.5: 1 / 6, 1.0: 1 / 3, 2.0: 2 / 3}, abs=0.015)


def test_the_surface_dice_weighs_both_surfaces_by_their_area():
    # A small ball inside a large one: its whole area is within the tolerance, of the large one's only a part.
    small, large = ball(5.0, (24.0, 0.0, 0.0)), ball(30.0)
    found = compare(small, large, n_points=4000, tolerances=(11.5,))
    ((_, share),) = found.surface_dice
    parts = [np.mean(np.abs(each) <= 11.5) for each in (found.signed_to_reference, found.signed_to_surface)]
    assert parts[0] == 1.0
    assert share == pytest.approx((25.0 * parts[0] + 900.0 * parts[1]) / 925.0, rel=1e-4)


def test_a_surface_compared_with_itself_is_the_same():
    found = compare(ball(20.0), ball(20.0), n_points=300)
    assert found.hausdorff < 1e-8
    assert found.volume_dice == 1.0
    assert found.volume_difference_ml == 0.0
    assert all(share == 1.0 for _, share in found.surface_dice)


def test_organs_apart_have_nothing_in_common():
    found = compare(ball(10.0), mesh_of(ball(10.0, (100.0, 0.0, 0.0))), n_points=100)
    assert found.volume_dice == 0.0
    assert found.hausdorff == pytest.approx(100.0, abs=1.0)


# ------------------------------------------------------------------ kinds of references


def test_a_mesh_and_the_surface_it_was_made_of_agree():
    fitted, truth = ball(30.0, (1.0, 0.5, 0.0)), closed_organ(axes=np.diag([29.0, 30.0, 31.0]), center=CENTER)
    surface, mesh = (compare(fitted, each, n_points=2000) for each in (truth, mesh_of(truth)))
    # The two ways to spread points over the same area: a standard error of 0.6 mm / sqrt(2000) each.
    assert mesh.to_surface.mean == pytest.approx(surface.to_surface.mean, abs=0.05)
    assert mesh.to_reference.mean == pytest.approx(surface.to_reference.mean, abs=CHORD)
    assert mesh.volume_dice == pytest.approx(surface.volume_dice, abs=1e-3)
    assert mesh.reference_ml == pytest.approx(surface.reference_ml, rel=2e-3)


def test_distances_to_triangles_are_not_those_to_their_corners():
    cube = ReferenceMesh(*_cube())
    places = np.array([[5.0, 5.0, 12.0], [5.0, 5.0, 9.0], [13.0, 14.0, 5.0], [-1.0, -1.0, -1.0]])
    np.testing.assert_allclose(distances_from(cube, places), [2.0, -1.0, 5.0, np.sqrt(3.0)], atol=1e-12)


def test_distances_from_a_surface_are_exact():
    surface = ball(20.0)
    u, v = np.array([0.1, 0.4, 0.8]), np.array([0.3, 0.5, 0.9])
    feet, normals = surface.points(u, v), surface.normals(u, v)
    heights = np.array([[2.0], [-3.0], [0.5]])
    np.testing.assert_allclose(distances_from(surface, feet + heights * normals), heights[:, 0], atol=1e-9)


@pytest.mark.parametrize("handedness", [1.0, -1.0])
def test_a_label_on_an_oblique_grid_is_met(handedness):
    angle = np.deg2rad(25.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    matrix, shape = np.eye(4), (36, 60, 60)
    matrix[:3, :3] = turn @ np.diag([handedness, 1.0, 1.7])
    matrix[:3, 3] = CENTER - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    grid = Image(np.zeros(shape), matrix)
    k, j, i = np.indices(shape).reshape(3, -1)
    inside = np.linalg.norm(grid.to_ras(np.column_stack([i, j, k])) - CENTER, axis=1) <= 25.0
    found = compare(ball(25.0), mesh_of_mask(Image(inside.reshape(shape), matrix)), n_points=2000)
    # Terraces of voxels of 1 x 1 x 1.7 mm: within half a diagonal, and as often outside as inside.
    assert found.hausdorff < 1.1
    assert abs(found.to_reference.mean_signed) < 0.06
    assert found.volume_dice == pytest.approx(1.0, abs=0.015)
    assert found.volume_difference_ml == pytest.approx(0.0, abs=0.01 * found.volume_ml)


# ------------------------------------------------------------------ meshes as they come


def _cube():
    """Corners and triangles of a cube of 10 mm, outward."""
    corners = 10.0 * np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners, np.array([part for a, b, c, d in faces for part in ((a, b, c), (a, c, d))])


def test_a_mesh_that_is_inside_out_or_partly_turned_is_put_right():
    points, triangles = _cube()
    some = triangles.copy()
    some[::3] = some[::3, ::-1]
    for turned in (triangles[:, ::-1], some):
        middle, far = distances_from(ReferenceMesh(points, turned), [[5.0, 5.0, 5.0], [5.0, 5.0, 15.0]])
        assert (middle, far) == pytest.approx((-5.0, 5.0))


def test_a_surface_that_is_inside_out_is_put_right(outer_and_inner):
    found = compare(ball(31.0).turned(), ball(30.0).turned(), n_points=200)
    assert found.to_surface.mean_signed == pytest.approx(1.0, abs=1e-4)
    assert found.to_reference.mean_signed == pytest.approx(1.0, abs=1e-4)
    assert found.volume_ml == pytest.approx(outer_and_inner.volume_ml)


def test_points_that_are_there_for_each_triangle_are_merged():
    points, triangles = _cube()
    soup = ReferenceMesh(points[triangles].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert distances_from(soup, [[5.0, 5.0, 11.0]]) == pytest.approx([1.0])


def test_what_encloses_nothing_is_refused():
    points, triangles = _cube()
    with pytest.raises(ValueError, match="The mesh is open: 3 edges have a triangle without a neighbour"):
        compare(ball(5.0), ReferenceMesh(points, triangles[1:]))
    with pytest.raises(ValueError, match="The mesh has no triangles"):
        compare(ball(5.0), ReferenceMesh(points, triangles[:0]))
    with pytest.raises(ValueError, match="points that are not finite"):
        compare(ball(5.0), ReferenceMesh(points * [1.0, 1.0, np.nan], triangles))
    with pytest.raises(ValueError, match="The mesh encloses no volume"):
        compare(ball(5.0), ReferenceMesh(points * [1.0, 1.0, 0.0], triangles))
    net = ball(5.0).control_net.copy()
    net[:, 0] = net[:, 1]
    open_surface = ball(5.0).with_control_net(net)
    with pytest.raises(ValueError, match="The surface is open"):
        compare(open_surface, ball(5.0))
    with pytest.raises(ValueError, match="The surface is open"):
        distances_from(open_surface, np.zeros((1, 3)))


def test_numbers_out_of_range_are_refused():
    with pytest.raises(ValueError, match="0 points were asked for; give at least one"):
        compare(ball(5.0), ball(5.0), n_points=0)
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="must be positive lengths"):
            compare(ball(5.0), ball(5.0), tolerances=(1.0, wrong))
