"""What Slicer's views show of an organ, drawn off screen by Slicer's own code for the README's pictures."""

from __future__ import annotations

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid, ellipsoid_image

from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.triangulation import triangulate

# The organ of 44 mm leaves room for the bar and the letters at the edges.
SIZE, HEIGHT_MM = (200, 160), 90.0
PIXEL_MM = HEIGHT_MM / SIZE[1]
COLOR, MARK = np.array([0.1, 0.4, 0.95]), np.array([1.0, 0.0, 1.0])
# What lies to the right of the picture and above it (RAS), as Slicer shows a patient: seen from the feet, from the left
# and from the front.
DIRECTIONS = {
    "Red": ([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    "Yellow": ([0.0, -1.0, 0.0], [0.0, 0.0, 1.0]),
    "Green": ([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
}


@pytest.fixture(scope="module")
def off_screen(stand_ins):
    """Skips where nothing can be drawn."""
    from slicer_views import draws_off_screen

    if not draws_off_screen():
        pytest.skip("there is no OpenGL that draws off screen")


@pytest.fixture
def volume(scene, off_screen):
    import slicer

    image = ellipsoid_image()
    node = slicer.util.addVolumeFromArray(image.array, ijkToRAS=image.ijk_to_ras, name="MRI")
    node.CreateDefaultDisplayNodes()
    return node


@pytest.fixture
def model(volume):
    from VICRegistrationLib.mrml.surfaces import createModel, showSurface

    node = createModel("organ", tuple(COLOR))
    showSurface(node, ellipsoid(), name="organ")
    return node


@pytest.fixture
def mark(volume):
    """A function that marks one place, given relative to the organ's centre in RAS mm."""
    import slicer

    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", "mark")
    node.CreateDefaultDisplayNodes()
    node.GetDisplayNode().SetPointLabelsVisibility(False)
    node.GetDisplayNode().SetSelectedColor(*MARK)
    return lambda offset: node.AddControlPointWorld(*(CENTER + offset))


@pytest.fixture
def draw_slice(volume, stand_ins):
    """A function that draws a slice view around the organ's centre."""
    from slicer_views import SliceView

    opened = []

    def draw(name):
        view = SliceView(volume.GetScene(), stand_ins.application, name, SIZE)
        opened.append(view)
        view.show(volume, CENTER, HEIGHT_MM)
        return view.picture() / 255.0

    yield draw
    for view in opened:
        view.close()


@pytest.fixture
def draw_3d(volume, stand_ins):
    """A function that draws the 3D view, seen from the front."""
    from slicer_views import ThreeDView

    view = ThreeDView(volume.GetScene(), stand_ins.application, SIZE)
    view.look(CENTER, (0.0, 1.0, 0.0), HEIGHT_MM)
    yield lambda: view.picture() / 255.0
    view.close()


def places(name, rows, columns):
    """RAS mm of pixels of a slice view around the organ's centre."""
    right, up = (np.array(direction) for direction in DIRECTIONS[name])
    x = (np.asarray(columns) + 0.5 - SIZE[0] / 2) * PIXEL_MM
    y = (SIZE[1] / 2 - 0.5 - np.asarray(rows)) * PIXEL_MM
    return CENTER + np.multiply.outer(x, right) + np.multiply.outer(y, up)


def depths(points):
    """Signed distances from the organ's surface in mm, positive outside."""
    return closest_points(ellipsoid(), points.reshape(-1, 3)).distances.reshape(points.shape[:-1])


def pixels_like(picture, color, tolerance=0.2):
    return np.argwhere(np.abs(picture - color).max(axis=2) < tolerance)


@pytest.mark.parametrize("name", DIRECTIONS)
def test_the_contour_is_drawn_where_the_slice_cuts_the_surface(name, model, draw_slice):
    found = places(name, *pixels_like(draw_slice(name), COLOR).T)
    # The line is two pixels wide and pixels have a size; triangles are within 0.1 mm.
    tolerance = 1.5 * PIXEL_MM + 0.1
    assert np.abs(depths(found)).max() < tolerance
    vertices = triangulate(ellipsoid(), resolution=(128, 80)).points
    normal = np.cross(*DIRECTIONS[name])
    on_slice = vertices[np.abs((vertices - CENTER) @ normal) < 0.3]
    assert len(on_slice) > 20
    assert np.linalg.norm(on_slice[:, None] - found, axis=2).min(axis=1).max() < tolerance + 0.3


def test_a_slice_view_shows_the_contour_at_the_position_of_the_stack_in_it(slicer_module, volume, stand_ins):
    import mrml_scenes
    from mrml_references import add_organ
    from slicer_views import SliceView

    from VICRegistrationLib.mrml.organ_nodes import paint
    from VICRegistrationLib.mrml.stack_contours import chooseViews, showStackContours
    from VICRegistrationLib.mrml.stacks import StackRecord, keepStacks

    organ, stack = add_organ(mrml_scenes.logic(), "organ", volume), mrml_scenes.add_volume(name="AX")
    stack.CreateDefaultDisplayNodes()
    organ.color = tuple(COLOR)
    paint(organ)
    moved, grid = np.eye(4), ellipsoid_image().ijk_to_ras
    moved[:3, 3] = [8.0, -3.0, 0.0]
    record = StackRecord(True, motion=tuple((np.linalg.inv(grid) @ moved @ grid).ravel()))
    keepStacks(organ, volume, [], [], {stack: record})
    view = SliceView(volume.GetScene(), stand_ins.application, "Red", SIZE)
    volume.GetScene().AddNewNodeByClass("vtkMRMLViewNode")
    showStackContours(organ, volume)
    try:
        for shown, shift in ((volume, np.zeros(3)), (stack, moved[:3, 3]), (volume, np.zeros(3))):
            view.show(shown, CENTER, HEIGHT_MM)
            chooseViews()
            found = places("Red", *pixels_like(view.picture() / 255.0, COLOR).T)
            assert len(found) > 100
            assert np.abs(depths(found - shift)).max() < 1.5 * PIXEL_MM + 0.1
    finally:
        view.close()


@pytest.mark.parametrize("name", DIRECTIONS)
def test_the_patient_is_turned_as_in_slicer(name, mark, draw_slice):
    right, up = (np.array(direction) for direction in DIRECTIONS[name])
    mark(-12.0 * right + 6.0 * up)
    row, column = pixels_like(draw_slice(name), MARK).mean(axis=0)
    assert column == pytest.approx(SIZE[0] / 2 - 12.0 / PIXEL_MM, abs=1.5)
    assert row == pytest.approx(SIZE[1] / 2 - 6.0 / PIXEL_MM, abs=1.5)


def test_a_surface_is_coloured_by_numbers_at_its_points_with_a_legend(model, draw_3d):
    import slicer

    from VICRegistrationLib.mrml.colors import DEVIATION, addScalars, colorBy

    plain = draw_3d()
    heights = slicer.util.arrayFromModelPoints(model)[:, 2] - CENTER[2]
    addScalars(model.GetPolyData(), DEVIATION, heights)
    colorBy(model, DEVIATION)
    picture = draw_3d()
    red, blue = picture[..., 0], picture[..., 2]
    middle = slice(SIZE[0] // 2 - 5, SIZE[0] // 2 + 5)
    offset = round(15.0 / PIXEL_MM)
    upper, lower = SIZE[1] // 2 - offset, SIZE[1] // 2 + offset
    # What is above zero is red, what is below it blue.
    assert np.all(red[upper, middle] > blue[upper, middle] + 0.1)
    assert np.all(blue[lower, middle] > red[lower, middle] + 0.1)
    # The bar of the legend at the right edge has both as well.
    right = np.s_[:, 3 * SIZE[0] // 4 :]
    changed = np.abs(picture[right] - plain[right]).max(axis=2) > 0.3
    assert np.count_nonzero(changed & (red[right] > blue[right] + 0.3)) > 20
    colorBy(model, None)
    np.testing.assert_array_equal(draw_3d(), plain)


def test_the_patients_right_is_on_the_left_seen_from_the_front(mark, draw_3d):
    mark(np.array([20.0, 0.0, 10.0]))
    picture = draw_3d()
    row, column = pixels_like(picture, MARK, tolerance=0.4).mean(axis=0)
    assert column == pytest.approx(SIZE[0] / 2 - 20.0 / PIXEL_MM, abs=2.0)
    assert row == pytest.approx(SIZE[1] / 2 - 10.0 / PIXEL_MM, abs=2.0)


def test_pictures_are_put_together_and_written(tmp_path, off_screen):
    from matplotlib.image import imread
    from slicer_views import side_by_side, write_png

    red, blue = (np.full((3, 4, 3), color, np.uint8) for color in ([255, 0, 0], [0, 0, 255]))
    red[0] = 255
    write_png(side_by_side([[red, blue], [blue, red]]), tmp_path / "four.png")
    read = imread(tmp_path / "four.png")
    assert read.shape == (8, 10, 3)
    np.testing.assert_array_equal(read[0, 0], [1, 1, 1])
    np.testing.assert_array_equal(read[1, 0], [1, 0, 0])
    np.testing.assert_array_equal(read[7, 0], [0, 0, 1])
