"""Surfaces in 3D: nothing is mirrored, shading is smooth, and colours stand for their numbers."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import pixels_of

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.report.figure import blank_figure
from VICRegistrationLib.report.scene import (
    CONFIDENCE,
    DEVIATION,
    FRONT,
    OPPOSITE,
    SIDES,
    USUAL,
    Shape,
    camera,
    draw_scalars,
    draw_scene,
)

pytest.importorskip("matplotlib", reason="pictures need matplotlib")

CENTER = np.array([7.0, -30.0, 12.0])
GREY = np.array([0.6, 0.6, 0.6])


@pytest.fixture(scope="module")
def mesh():
    """A ball."""
    return triangulate(closed_organ(axes=20.0 * np.eye(3), center=CENTER), resolution=(48, 30))


def scene(shape, viewpoint, **how):
    """Pixels of a scene without its arrows and its scale, (rows, columns, 3) from 0 to 1."""
    figure = blank_figure(3.0, 3.0)
    axes = figure.add_axes((0, 0, 1, 1))
    draw_scene(axes, [shape], viewpoint, **how)
    for other in [*axes.texts, *axes.lines]:
        other.remove()
    return pixels_of(figure)


def coloured(mesh, values):
    from matplotlib import colormaps

    return Shape(mesh.points, mesh.triangles, colormaps["coolwarm"]((values + 1.0) / 2.0)[:, :3], mesh.normals)


def middle_of(pixels, *, red):
    """Place of the strongly red, or blue, pixels in a picture: column and row, from 0 to 1."""
    difference = (pixels[..., 0] - pixels[..., 2]) * (1.0 if red else -1.0)
    rows, columns = np.nonzero(difference > 0.3)
    assert len(rows) > 50
    return columns.mean() / pixels.shape[1], rows.mean() / pixels.shape[0]


@pytest.mark.parametrize(
    ("viewpoint", "axis", "positive_is_left"),
    [(*SIDES[:1], 0, True), (SIDES[1], 1, True), (SIDES[2], 0, False), (SIDES[3], 1, False)]
    # From the patient's left and front, anterior is on the left; from the right and back, on the right.
    + [(USUAL, 1, True), (OPPOSITE, 1, False), (FRONT, 0, True)],
)
def test_nothing_is_mirrored(mesh, viewpoint, axis, positive_is_left):
    height = np.clip((mesh.points - CENTER) / 10.0, -1.0, 1.0)
    pixels = scene(coloured(mesh, height[:, axis]), viewpoint, matt=True)
    assert (middle_of(pixels, red=True)[0] < middle_of(pixels, red=False)[0]) == positive_is_left
    pixels = scene(coloured(mesh, height[:, 2]), viewpoint, matt=True)
    assert middle_of(pixels, red=True)[1] < middle_of(pixels, red=False)[1]


def test_the_near_side_hides_the_far_side(mesh):
    # From the front, the front half is seen, which is red here.
    pixels = scene(coloured(mesh, np.sign(mesh.points[:, 1] - CENTER[1])), ("", (0.0, 1.0, 0.0)), matt=True)
    assert np.count_nonzero(pixels[..., 0] - pixels[..., 2] > 0.3) > 10_000
    assert np.count_nonzero(pixels[..., 2] - pixels[..., 0] > 0.3) < 100


def test_a_nearer_organ_hides_a_farther_one(mesh):
    near = Shape(mesh.points + [0.0, 60.0, 0.0], mesh.triangles, np.array([1.0, 0.0, 0.0]), mesh.normals)
    far = Shape(mesh.points, mesh.triangles, np.array([0.0, 0.0, 1.0]), mesh.normals)
    for shapes in ((near, far), (far, near)):
        figure = blank_figure(3.0, 3.0)
        draw_scene(figure.add_axes((0, 0, 1, 1)), shapes, ("", (0.0, 1.0, 0.0)))
        pixels = pixels_of(figure)
        assert np.count_nonzero((pixels[..., 0] > 0.3) & (pixels[..., 2] < 0.2)) > 10_000
        assert np.count_nonzero((pixels[..., 2] > 0.3) & (pixels[..., 0] < 0.2)) < 100


def test_shading_is_smooth_and_that_of_a_mesh_is_flat(mesh):
    smooth, flat = (
        scene(Shape(mesh.points, mesh.triangles, GREY, normals), SIDES[0])[..., 0] for normals in (mesh.normals, None)
    )
    middle = slice(130, 260)
    steps, edges = (np.abs(np.diff(each[middle, middle], axis=1)) for each in (smooth, flat))
    # Of a ball that is 240 pixels wide, light changes by less than 1 % from one pixel to the next; facets and their
    # edges are steps.
    assert steps.max() < 0.02
    assert edges.max() > 0.2
    assert len(np.unique(np.round(smooth[middle, middle], 3))) > 50


def test_four_sides_show_every_part(mesh):
    directions = np.array([camera(towards)[2] for _, towards in SIDES])
    # No place is seen at less than 15 degrees.
    assert (mesh.normals @ directions.T).max(axis=1).min() > np.sin(np.deg2rad(15.0))


def test_colours_are_those_of_the_bar(mesh):
    from matplotlib import colormaps

    for value, expected in ((-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)):
        pixels = scene(coloured(mesh, np.full(len(mesh.points), value)), SIDES[0], matt=True)
        colour = pixels[150:240, 150:240].reshape(-1, 3)
        # The light changes the brightness, never the shares of red, green and blue.
        shares = np.median(colour / colour.sum(axis=1, keepdims=True), axis=0)
        wanted = np.array(colormaps["coolwarm"](expected)[:3])
        np.testing.assert_allclose(shares, wanted / wanted.sum(), atol=0.02)


def test_the_ends_of_the_colours_are_round_and_hold_nearly_all():
    distances = np.concatenate([np.full(99, 0.24), [-9.0]])
    assert DEVIATION.limits(distances) == pytest.approx((-0.3, 0.3))
    assert CONFIDENCE.limits(np.abs(distances)) == pytest.approx((0.0, 0.3))
    assert DEVIATION.limits(np.zeros(5))[1] > 0.0
    assert DEVIATION.limits(np.full(5, 12345.0))[1] == pytest.approx(12345.0)


def test_bars_are_shares_of_the_area_and_scenes_have_one_scale(mesh):
    figure = blank_figure(11.0, 5.3)
    values = (mesh.points[:, 2] - CENTER[2]) / 10.0
    draw_scalars(figure, mesh, values, DEVIATION, other=np.zeros(10))
    *scenes, bar, histogram = figure.axes
    assert len(scenes) == len(SIDES)
    assert len({round(float(np.ptp(axes.get_xlim())), 9) for axes in scenes}) == 1
    assert bar.get_xlabel() == DEVIATION.label
    heights = np.array([patch.get_height() for patch in histogram.patches if hasattr(patch, "get_x")])
    assert heights.sum() == pytest.approx(100.0)
    # Heights along an axis of a ball are spread evenly over its area: a quarter is below half its radius.
    edges = np.array([patch.get_x() for patch in histogram.patches if hasattr(patch, "get_x")])
    assert heights[edges < -1.0 - 1e-9].sum() == pytest.approx(25.0, abs=2.0)
    assert heights[edges < -1e-9].sum() == pytest.approx(50.0, abs=2.0)
    names = [text.get_text() for text in histogram.get_legend().get_texts()]
    assert names == ["from the fitted surface", "from the reference"]
