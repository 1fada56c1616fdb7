"""Pictures show slices the way radiologists see them, with contours and points in their places, and nothing covered."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drawn import pixels_in, pixels_of
from scipy.spatial.transform import Rotation
from small_phantom import CENTER, ellipsoid, ellipsoid_image

from VICRegistrationLib.analysis.references import ReadReference
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.organ_colours import ORGAN_COLOURS, rgb
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.report import pictures
from VICRegistrationLib.report.contents import ReportedOrgan, compared_organ, fine_mesh
from VICRegistrationLib.report.figure import axes_at, blank_figure, jpeg_bytes, require_packages, save_figure
from VICRegistrationLib.report.slices import Contour, Marks, draw_slices
from VICRegistrationLib.report.views import (
    AXIAL,
    CORONAL,
    ORIENTATIONS,
    SAGITTAL,
    View,
    cut,
    orientations_of,
    slice_of,
    views_in_own_plane,
    views_of,
)

matplotlib = pytest.importorskip("matplotlib", reason="pictures need matplotlib")
pytestmark = pytest.mark.usefixtures("one_net")

# Of the slices of a ball of 20 mm: with a margin of 18 mm.
HALF_WIDTH = 38.0
SEEDS = [tuple(CENTER), tuple(CENTER + [3.0, -4.0, 12.0])]


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(small_fit):
    return small_fit


@pytest.fixture(scope="module")
def organ(fit):
    compared = compared_organ(
        "bladder", fit.surface, ReadReference(ellipsoid(), "surface"), Path("truth.json"), points=99
    )
    return ReportedOrgan("bladder", fit, "good", seeds=SEEDS, seconds=0.3, compared=compared)


# ------------------------------------------------------------------ slices


@pytest.mark.parametrize(
    ("orientation", "direction", "side"),
    [
        (AXIAL, (1, 0, 0), "left"),
        (AXIAL, (0, 1, 0), "top"),
        (CORONAL, (1, 0, 0), "left"),
        (CORONAL, (0, 0, 1), "top"),
        (SAGITTAL, (0, 1, 0), "left"),
        (SAGITTAL, (0, 0, 1), "top"),
    ],
)
def test_a_bright_spot_appears_on_the_side_of_the_convention(orientation, direction, side):
    array = np.zeros((21, 21, 21))
    place = 10 + 6 * np.array(direction)
    array[place[2], place[1], place[0]] = 1.0
    matrix = np.eye(4)
    matrix[:3, 3] = -10.0
    grey = slice_of(Sampler(Image(array, matrix)), View(orientation, np.zeros(3), 10.0), count=41)
    row, column = np.unravel_index(np.argmax(grey), grey.shape)
    # Rows run from the bottom to the top; 6 of 10 mm from the middle of 41 pixels.
    assert {"left": (row, 40 - column), "top": (column, row)}[side] == (20, 32)
    assert orientation.labels[{"left": 0, "top": 3}[side]] == "RAS"[direction.index(1)]


def test_organ_contour_and_point_are_drawn_in_one_place_and_not_mirrored():
    """A small ball to the right, front and top of a large one: in the image, as a contour, and as a point."""
    offset = np.array([4.5, 3.5, 2.5])
    k, j, i = np.indices((61, 61, 61)) - 30
    matrix = np.eye(4)
    matrix[:3, 3] = CENTER - 30.0
    inside = np.linalg.norm(np.stack([i, j, k], axis=-1) - offset, axis=-1) < 6.0
    large, small = (
        triangulate(closed_organ(axes=radius * np.eye(3), center=center), resolution=(40, 24))
        for radius, center in ((20.0, CENTER), (6.0, CENTER + offset))
    )
    contours = [Contour(large, "#00ff00", "large"), Contour(small, "#ff0000", "small", thin=True)]
    figure = blank_figure(9.0, 3.6)
    marks = [Marks([CENTER + offset], "seed", "#0000ff", "o")]
    draw_slices(figure, 3.5, Image(100.0 * inside, matrix), contours, marks=marks)
    # Where R, A and S are in each picture: to the left (-1) or right, to the bottom (-1) or top.
    for axes, (right, up) in zip(figure.axes, (((-1, 0), (1, 1)), ((-1, 0), (1, 2)), ((-1, 1), (1, 2)))):
        # Without the white letters and the scale at the edges.
        pixels = pixels_in(figure, axes)
        half, edge = len(pixels) / 2.0, len(pixels) // 5
        red, green, blue = np.moveaxis(pixels[edge:-edge, edge:-edge], -1, 0)
        masks = {
            "contour": (red > 0.6) & (green < 0.4) & (blue < 0.4),
            "grey levels": (red > 0.8) & (green > 0.8) & (blue > 0.8),
            # It is 2.5 mm beside the axial slice, so that it is hollow there, and farther from the others.
            "point": (blue > 0.6) & (red < 0.4) & (green < 0.4),
        }
        for name, mask in masks.items():
            rows, columns = np.nonzero(mask)
            assert len(rows) or (name == "point" and axes is not figure.axes[0])
            if len(rows):
                middle = np.array([columns.mean() + edge - half, half - rows.mean() - edge]) / half * HALF_WIDTH
                wanted = [right[0] * offset[right[1]], up[0] * offset[up[1]]]
                np.testing.assert_allclose(middle, wanted, atol=1.0, err_msg=name)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_the_contour_is_the_cut_of_the_surface(orientation):
    mesh = triangulate(ellipsoid(), resolution=(96, 64))
    view = View(orientation, CENTER + [2.0, 3.0, 4.0], 30.0)
    lines = cut(mesh, view)
    assert len(lines) == 1
    np.testing.assert_allclose(lines[0][0], lines[0][-1], atol=1e-6)
    right, up = np.array(orientation.right), np.array(orientation.up)
    across = np.cross(right, up)
    points = lines[0][:, :1] * right + lines[0][:, 1:] * up + (view.center @ across) * across
    radii = np.linalg.norm((points - CENTER) / [14.0, 18.0, 22.0], axis=1)
    # The 9 x 7 net and its triangles follow the ellipsoid within 1 % of its size.
    np.testing.assert_allclose(radii, 1.0, atol=0.01)


def test_a_plane_beside_the_organ_cuts_nothing():
    assert cut(triangulate(ellipsoid(), resolution=(12, 8)), View(AXIAL, CENTER + [0.0, 0.0, 40.0], 30.0)) == []


def test_what_lies_outside_of_the_volume_is_masked(image):
    grey = slice_of(Sampler(image), View(AXIAL, CENTER, 200.0), count=50)
    assert grey.mask[0, 0]
    assert not grey.mask[25, 25]


def test_the_planes_of_an_overview_cut_as_many_organs_as_they_can():
    corners = (np.array([[0.0, 0, 0], [10, 10, 10]]), np.array([[40.0, 1, 1], [44, 9, 9]]))
    views = views_of([SimpleNamespace(points=points) for points in corners])
    np.testing.assert_array_equal(views[0].center, [22.0, 5.0, 5.0])
    np.testing.assert_array_equal(views[1].center, [22.0, 5.0, 5.0])
    # The middle, R 22, is beside both organs; the middle of the first is 17 mm from it, that of the second 20 mm.
    np.testing.assert_array_equal(views[2].center, [5.0, 5.0, 5.0])


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0)])
def test_an_oblique_image_is_shown_along_its_own_axes(order):
    """Turned by 18 degrees, image and surface look as if they were not, but for the planes' names."""
    straight = ellipsoid_image()
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("x", 18.0, degrees=True).as_matrix()
    axes = np.eye(4)[:, [*order, 3]]
    turned = Image(straight.array.transpose([2 - axis for axis in order[::-1]]), turn @ straight.ijk_to_ras @ axes)
    pictures_of = []
    for image, surface in ((straight, ellipsoid()), (turned, ellipsoid().transformed(turn))):
        mesh = triangulate(surface, resolution=(24, 16))
        views = views_of([mesh], orientations_of(image)) + views_in_own_plane(image, mesh)
        pictures_of.append([(slice_of(Sampler(image), view, count=60), *cut(mesh, view)) for view in views])
    for view, before, after in zip(views, *pictures_of):
        assert view.title.split()[1] == "oblique"
        np.testing.assert_allclose(after[0].filled(-1.0), before[0].filled(-1.0), atol=1e-4)
        for end in (np.min, np.max):
            np.testing.assert_allclose(end(after[1], axis=0), end(before[1], axis=0), atol=0.1)


def test_planes_of_a_stack_are_where_it_shows_the_surface():
    surface = closed_organ(axes=np.diag([10.0, 10.0, 30.0]), center=(0.0, 0.0, 0.0))
    matrix = np.diag([-1.0, -1.0, 4.0, 1.0])
    matrix[:3, 3] = 30.0, 30.0, -40.0
    # Its last slice is at -4 mm.
    stack = Image(np.zeros((10, 60, 60), np.float32), matrix)
    views = views_in_own_plane(stack, triangulate(surface))
    places = [view.center[2] for view in views]
    np.testing.assert_allclose(places, -30.0 + 26.0 * np.array([0.25, 0.5, 0.75]), atol=0.3)
    assert not any(slice_of(Sampler(stack), view).mask.all() for view in views)


def test_every_point_is_in_a_slice_and_hollow_where_it_is_beside_it(image, fit):
    # In all planes; in none, nearest to the coronal one; and 4 mm in front of it, which is far.
    points = CENTER + np.array([[0.0, 0.0, 0.0], [8.0, 4.0, 9.0], [-6.0, 5.0, -9.0]])
    figure = blank_figure(9.0, 3.6)
    contours = [Contour(fine_mesh(ellipsoid()), "#f5b82e", "bladder")]
    draw_slices(figure, 3.5, image, contours, marks=[Marks(points, "seed", "#ffffff", "o")])
    filled, hollow = [], []
    for axes in figure.axes[:3]:
        for collection in axes.collections:
            faces = filled if len(collection.get_facecolor()) else hollow
            faces.append(len(collection.get_offsets()))
    # Each is drawn twice: a dark rim below it.
    assert sum(filled) == 2 * 3
    assert sum(hollow) == 2 * 2
    coronal = figure.axes[1]
    places = np.concatenate([collection.get_offsets() for collection in coronal.collections])
    for point in points:
        assert np.abs(places - [-point[0], point[2]]).max(axis=1).min() < 1e-9


# ------------------------------------------------------------------ whole pictures


def lines_of(axes):
    """Colour and width of the contours in a slice."""
    return {(line.get_color(), line.get_linewidth()) for line in axes.lines if line.get_color() != "white"}


def test_the_reference_has_a_colour_of_its_own_and_a_thin_line(image, organ):
    figure = pictures.organ_figure(image, organ)
    for axes in figure.axes[:3]:
        (colour, width), (other, thin) = sorted(lines_of(axes), key=lambda style: -style[1])
        assert colour == ORGAN_COLOURS["bladder"]
        assert other == pictures.REFERENCE_COLOUR
        assert thin < 0.5 * width
    for each in ORGAN_COLOURS.values():
        assert np.abs(np.subtract(rgb(each), rgb(pictures.REFERENCE_COLOUR))).max() > 0.35


def test_seeds_and_boundary_points_are_in_the_pictures(image, organ):
    corrected = replace(organ, fit=replace(organ.fit, boundary_points=(tuple(CENTER + [14.0, 0.0, 0.0]),)))
    for figure in (
        pictures.organ_figure(image, corrected),
        pictures.overview_figure(image, [corrected, replace(organ, name="rectum")]),
        pictures.page_figures(image, corrected)["organ"],
    ):
        drawn = np.concatenate(
            [collection.get_offsets() for collection in figure.axes[2].collections if hasattr(collection, "get_sizes")]
        )
        # Sagittal: anterior is on the left. The second seed and the boundary point are nearer to other planes.
        assert np.abs(drawn - [-CENTER[1], CENTER[2]]).max(axis=1).min() < 1e-9
        strip = figure.axes[3].get_legend()
        names = [text.get_text() for text in strip.get_texts()]
        assert [name.partition(" (")[0] for name in names[-2:]] == ["seed", "boundary point"]


@pytest.mark.parametrize(
    "stages",
    [
        # A second fit, after boundary points have contradicted the first one.
        [f"{again}grey levels, coarse, {n}x17" for again in ("", "through the points, ") for n in range(20, 31)],
        # Surfaces that have folded.
        [
            f"grey levels, {width}, {net}, held 10 times closer"
            for net in ("17x11", "33x19")
            for width in ("coarse", "fine")
        ],
    ],
)
def test_the_legend_of_the_curves_is_beside_them(image, organ, stages):
    history = [replace(organ.fit.history[-1], stage=stage, cost=10.0**-n) for n, stage in enumerate(stages)]
    long = replace(organ, fit=replace(organ.fit, history=tuple(history)))
    for figure in (pictures.organ_figure(image, long), pictures.page_figures(image, long)["convergence"]):
        plot = figure.axes[-1]
        pixels_of(figure)
        legend, frame = plot.get_legend().get_window_extent(), plot.get_window_extent()
        assert legend.x0 >= frame.x1
        assert legend.x1 <= figure.bbox.x1
        assert legend.y0 >= 0.0
        assert len(plot.get_legend().get_texts()) == len(stages) + (len(stages) > 12)


def test_the_legend_of_the_slices_is_below_them(image, organ):
    figure = pictures.organ_figure(image, organ)
    pixels_of(figure)
    box = figure.axes[3].get_legend().get_window_extent()
    assert all(box.y1 <= axes.get_window_extent().y0 for axes in figure.axes[:3])


def test_pictures_are_written(tmp_path, image, organ):
    save_figure(pictures.organ_figure(image, organ), tmp_path / "organ.png")
    content = (tmp_path / "organ.png").read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = (int.from_bytes(content[n : n + 4], "big") for n in (16, 20))
    assert width > 1200
    assert height > 900
    texts = [text.get_text() for text in pictures.deviation_figure(replace(organ.compared, name="price in $")).texts]
    assert texts[0] == r"price in \$"
    assert "compared with truth.json" in texts[1]
    assert organ.compared.comparison.to_surface.sentence() in texts[1]


@pytest.mark.parametrize("name", ["_$\\frac$", "膀胱"])
def test_any_name_can_be_drawn(tmp_path, image, organ, name):
    named = replace(organ, name=name)
    # With few pixels letters are laid out all the same.
    with matplotlib.rc_context({"savefig.dpi": 30}):
        save_figure(pictures.organ_figure(image, named), tmp_path / "organ.png")
        save_figure(pictures.overview_figure(image, [named, replace(organ, name="$")]), tmp_path / "all.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.png", "organ.png"]


def test_the_header_says_what_to_look_at(organ):
    assert pictures.alarm(organ) == ""
    assert pictures.alarm(replace(organ, verdict="poor")) == "verdict: poor"
    cut_off = replace(organ.fit, converged=False, region=replace(organ.fit.region, touches_border=("k-",)))
    told = pictures.alarm(replace(organ, fit=cut_off, warnings=("one", "two")))
    for words in ("not converged", "reaches the border", "2 warnings in the report"):
        assert words in told
    inside_out = replace(organ.fit, surface=organ.fit.surface.transformed(np.diag([-1.0, 1.0, 1.0, 1.0])))
    assert f"invalid surface ({inside_out.problems[0].kind})" in pictures.alarm(replace(organ, fit=inside_out))


def test_a_surface_that_was_fitted_again_is_drawn_without_a_region(image, organ):
    again = replace(organ, fit=finish(refit(image, organ.fit.surface)), seeds=())
    assert again.fit.region is None
    figure = pictures.organ_figure(image, again)
    names = [text.get_text() for text in figure.axes[3].get_legend().get_texts()]
    assert names == ["fitted surface", "reference"]
    assert pictures.alarm(again) == ""


@pytest.mark.parametrize("package", ["matplotlib", "jinja2"])
def test_without_a_package_the_way_out_is_told(monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(RuntimeError, match=rf"need {package}.*pip install {package}.*--no-pictures"):
        require_packages("matplotlib", "jinja2")


def test_pictures_of_the_page_are_small_and_keep_thin_lines_in_their_colour():
    from matplotlib.image import imread

    figure = blank_figure(3.0, 3.0)
    axes = axes_at(figure, 0.6, 0.6, 1.8, 1.8)
    axes.imshow(np.random.default_rng(0).normal(size=(300, 300)), cmap="gray")
    axes.axhline(150.0, color="#2f5bff", linewidth=0.9)
    axes.set_axis_off()
    content = jpeg_bytes(figure)
    assert len(content) < 60_000
    pixels = imread(io.BytesIO(content), format="jpg") / 255.0
    assert (pixels[0, 0] > 0.98).all()
    # Somewhere in the row of the line, blue is far above red, as in the colour itself.
    assert np.median((pixels[185:205, 150:240, 2] - pixels[185:205, 150:240, 0]).max(axis=0)) > 0.5
