"""Pictures show slices the way radiologists see them, with the exact contour in its place."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid, ellipsoid_image

from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.organ_colours import ORGAN_COLOURS, organ_colours
from VICRegistrationLib.registration.organ import finish, fit_organ, refit
from VICRegistrationLib.report import panels, pictures
from VICRegistrationLib.report.shading import Camera, shaded_triangles
from VICRegistrationLib.report.slicing import (
    AXIAL,
    CORONAL,
    ORIENTATIONS,
    SAGITTAL,
    View,
    cut,
    slice_of,
    surrounding_crop,
)

pytestmark = pytest.mark.usefixtures("one_net")

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def image():
    return ellipsoid_image()


@pytest.fixture(scope="module")
def fit(image):
    return finish(fit_organ(image, CENTER[None]))


@pytest.fixture
def without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)


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
    view = View(AXIAL, CENTER, 200.0)
    grey = slice_of(Sampler(surrounding_crop(image, CENTER, 200.0)), view, count=50)
    assert grey.mask[0, 0]
    assert not grey.mask[25, 25]


def test_a_cube_far_from_the_volume_still_gives_a_crop(image):
    assert surrounding_crop(image, CENTER + 1000.0, 10.0).array.shape == (2, 2, 2)


def test_the_viewer_sees_the_near_side():
    mesh = triangulate(ellipsoid(), resolution=(24, 16))
    camera = Camera.from_direction((0.0, 1.0, 0.0))
    corners, colours = shaded_triangles([mesh], [(0.2, 0.4, 0.6)], camera)
    assert 0.4 * len(mesh.triangles) < len(corners) < 0.65 * len(mesh.triangles)
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0
    # From the front, the patient's left is on the right of the picture, and superior is up.
    np.testing.assert_allclose(camera.project(np.array([-1.0, 5.0, 2.0])), [1.0, 2.0], atol=1e-12)


def test_known_organs_have_their_colours_and_others_differ():
    colours = organ_colours(["Bladder", "prostate", "colon"])
    assert colours["Bladder"] == ORGAN_COLOURS["bladder"]
    assert len(set(colours.values())) == 3


def test_pictures_are_written(tmp_path, image, fit):
    pictures.organ_picture(tmp_path / "organ.png", image, fit, "bladder", reference=ellipsoid())
    pictures.overview_picture(tmp_path / "all.png", image, {"bladder": fit})
    for name in ("organ.png", "all.png"):
        content = (tmp_path / name).read_bytes()
        assert content.startswith(PNG)
        width, height = (int.from_bytes(content[n : n + 4], "big") for n in (16, 20))
        assert width > 1200
        assert height > 900
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.png", "organ.png"]


@pytest.mark.parametrize("name", ["_$\\frac$", "膀胱"])
def test_any_name_can_be_drawn(tmp_path, image, fit, name, monkeypatch):
    # Few pixels: letters are laid out all the same.
    monkeypatch.setattr("VICRegistrationLib.report.canvas._DPI", 30)
    pictures.organ_picture(tmp_path / "organ.png", image, fit, name)
    pictures.overview_picture(tmp_path / "all.png", image, {name: fit, "$": fit})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.png", "organ.png"]


def test_the_header_tells_what_to_look_at(fit):
    assert pictures.alarm(fit) == ""
    cut_off = replace(fit, converged=False, region=replace(fit.region, touches_border=("k-",)))
    told = pictures.alarm(cut_off, n_warnings=2)
    for words in ("not converged", "reaches the border", "2 warnings in the report"):
        assert words in told
    inside_out = replace(fit, surface=fit.surface.transformed(np.diag([-1.0, 1.0, 1.0, 1.0])))
    assert inside_out.problems
    assert f"invalid surface ({inside_out.problems[0].kind})" in pictures.alarm(inside_out)


def test_the_planes_of_an_overview_cut_as_many_organs_as_they_can():
    low, high = np.array([[0.0, 0, 0], [40.0, 1, 1]]), np.array([[10.0, 10, 10], [44.0, 9, 9]])
    axial, coronal, sagittal = panels._views(low, high)
    np.testing.assert_array_equal(axial.center, [22.0, 5.0, 5.0])
    np.testing.assert_array_equal(coronal.center, [22.0, 5.0, 5.0])
    # The middle, R 22, is beside both organs; the middle of the first is 17 mm from it, that of the second 20 mm.
    np.testing.assert_array_equal(sagittal.center, [5.0, 5.0, 5.0])


def test_an_overview_needs_an_organ(tmp_path, image):
    with pytest.raises(ValueError, match="No organ was given"):
        pictures.overview_picture(tmp_path / "all.png", image, {})


@pytest.mark.usefixtures("without_matplotlib")
def test_without_matplotlib_the_way_out_is_told(tmp_path, image, fit):
    with pytest.raises(RuntimeError, match=r"pip install 'vicregistration\[pictures\]'.*--no-pictures"):
        pictures.organ_picture(tmp_path / "organ.png", image, fit, "bladder")
    assert list(tmp_path.iterdir()) == []


def test_a_surface_that_was_fitted_again_is_drawn_without_a_region(tmp_path, image, fit):
    again = finish(refit(image, fit.surface))
    assert again.region is None
    pictures.organ_picture(tmp_path / "again.png", image, again, "bladder", reference=ellipsoid())
    assert (tmp_path / "again.png").read_bytes().startswith(PNG)
    assert pictures.alarm(again) == ""
