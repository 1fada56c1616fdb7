"""Coloured surfaces: nothing is mirrored, and colours stand for their numbers."""

from __future__ import annotations

import io

import numpy as np
import pytest

from VICRegistrationLib.analysis.comparison import compare, distances_from
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.report.canvas import blank_figure, png_bytes
from VICRegistrationLib.report.coloured_surface import SIDES, draw_colour_bar, draw_coloured, draw_sides
from VICRegistrationLib.report.deviation_picture import colour_limit, deviation_figure, deviation_picture
from VICRegistrationLib.report.shading import Camera

pytest.importorskip("matplotlib", reason="pictures need matplotlib")

CENTER = np.array([7.0, -30.0, 12.0])


@pytest.fixture(scope="module")
def fitted():
    return closed_organ(axes=20.0 * np.eye(3), center=CENTER)


@pytest.fixture(scope="module")
def mesh(fitted):
    return triangulate(fitted, resolution=(48, 30))


def painted(figure):
    """Pixels of a figure, (rows, columns, 3) from 0 to 1."""
    from matplotlib.image import imread

    return imread(io.BytesIO(png_bytes(figure)))[..., :3]


def middle_of(pixels, *, red):
    """Place of the strongly red, or blue, pixels in a picture: column and row, from 0 to 1."""
    difference = (pixels[..., 0] - pixels[..., 2]) * (1.0 if red else -1.0)
    rows, columns = np.nonzero(difference > 0.3)
    assert len(rows) > 50
    return columns.mean() / pixels.shape[1], rows.mean() / pixels.shape[0]


def shown_from(mesh, values, side):
    figure = blank_figure((3.0, 3.0))
    camera = Camera.from_direction(side.towards)
    draw_coloured(figure.add_axes((0, 0, 1, 1)), mesh, values, camera=camera, limits=(-1.0, 1.0), colour_map="coolwarm")
    return painted(figure)


@pytest.mark.parametrize(
    ("number", "axis", "positive_is_left"), [(0, 0, True), (1, 1, True), (2, 0, False), (3, 1, False)]
)
def test_sides_are_not_mirrored(mesh, number, axis, positive_is_left):
    # From the front, the patient's right is on the viewer's left, as in an encounter; and so on.
    height = (mesh.points - CENTER) / 10.0
    pixels = shown_from(mesh, height[:, axis], SIDES[number])
    red, blue = middle_of(pixels, red=True)[0], middle_of(pixels, red=False)[0]
    assert (red < blue) == positive_is_left
    top, bottom = (middle_of(shown_from(mesh, height[:, 2], SIDES[number]), red=red)[1] for red in (True, False))
    assert top < bottom


def test_every_part_is_seen_from_a_side(mesh):
    directions = np.array([side.towards for side in SIDES])
    facing = (mesh.normals @ directions.T / np.linalg.norm(directions, axis=1)).max(axis=1)
    # No place is seen at less than 15 degrees.
    assert facing.min() > np.sin(np.deg2rad(15.0))


def test_letters_tell_the_patients_sides(mesh):
    figure = blank_figure((8.0, 2.5))
    values = np.zeros(len(mesh.points))
    draw_sides(figure, (0.0, 0.0, 1.0, 0.9), mesh, values, limits=(0.0, 1.0), colour_map="viridis")
    letters = [[text.get_text() for text in axes.texts] for axes in figure.axes]
    assert letters == [["R", "L"], ["A", "P"], ["L", "R"], ["P", "A"]]


def test_colours_are_those_of_the_bar(mesh):
    from matplotlib import colormaps

    for value, expected in ((-5.0, 0.0), (0.0, 0.5), (5.0, 1.0)):
        pixels = shown_from(mesh, np.full(len(mesh.points), value), SIDES[0])
        colour = pixels[120:270, 120:270].reshape(-1, 3)
        # The light changes the brightness, never the shares of red, green and blue.
        shares = np.median(colour / colour.sum(axis=1, keepdims=True), axis=0)
        wanted = np.array(colormaps["coolwarm"](expected)[:3])
        np.testing.assert_allclose(shares, wanted / wanted.sum(), atol=0.02)


def test_a_colour_bar_has_its_label():
    figure = blank_figure((4.0, 1.0))
    draw_colour_bar(figure, (0.1, 0.5, 0.8, 0.2), limits=(0.0, 2.0), colour_map="viridis", label="confidence")
    assert figure.axes[0].get_xlabel() == "confidence"
    assert figure.axes[0].get_xlim() == (0.0, 2.0)


def test_the_ends_of_the_colours_are_round_and_hold_nearly_all():
    distances = np.concatenate([np.full(99, 0.24), [-9.0]])
    assert colour_limit(distances) == pytest.approx(0.3)
    assert colour_limit(np.zeros(5)) > 0.0
    assert colour_limit(np.full(5, 12345.0)) == pytest.approx(12345.0)


def test_the_picture_tells_the_numbers(fitted, mesh, tmp_path):
    reference = closed_organ(axes=19.0 * np.eye(3), center=CENTER)
    found = compare(fitted, reference, n_points=500)
    distances = distances_from(reference, mesh.points)
    figure = deviation_figure(mesh, distances, found, "price in $", "truth.json")
    texts = [text.get_text() for text in figure.texts]
    assert {r"price in \$", "compared with truth.json", "+1.00", "0.000 at 0.5 mm"} <= set(texts)
    path = tmp_path / "deviation.png"
    deviation_picture(path, mesh, distances, found, "ball", "truth.json")
    assert path.read_bytes().startswith(b"\x89PNG")
