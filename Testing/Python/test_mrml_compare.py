"""Surfaces compared with segments and models of the scene, wherever they lie; and what cannot be compared."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
import vtk
from mrml_references import (
    DEVIATION,
    add_model,
    add_organ,
    add_segmentation,
    colors_of,
    label_image,
    larger,
    surface_model,
    triangles_of,
)
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.analysis.comparison import compare
from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, mesh_of_mask
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "few_points")

RIGID = motion(40, (2, -1, 1), (12, -9, 4))
SCALING = np.diag([1.1, 0.9, 1.2, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


# --- numbers ---------------------------------------------------------------------------------------------------------


def test_another_fit_is_compared_by_its_exact_surface(logic, organ):
    other = add_organ(logic, "second fit", logic.getParameterNode().volume, larger(-1.0))
    found = logic.compare(organ, other.surface)
    expected = compare(logic.surface(organ), logic.surface(other))
    assert found.to_surface == expected.to_surface
    assert found.hausdorff == expected.hausdorff
    # One millimetre outside everywhere: an ellipsoid with longer axes is nearly that.
    np.testing.assert_allclose(colors_of(organ), 1.0, atol=0.05)
    # Without the exact surface the triangles, 0.1 mm off, would make it not zero.
    logic.setSurface(other, ellipsoid())
    assert logic.compare(organ, other.surface).hausdorff < 1e-6


def test_a_segment_is_taken_by_its_voxels_on_its_own_grid(logic, organ):
    image = label_image(larger(2.0), turn=motion(30, (1, 2, -1)))
    node = add_segmentation(image)
    content = mrml_scenes.content(slicer.mrmlScene)
    found = logic.compare(organ, node)
    expected = compare(ellipsoid(), mesh_of_mask(image))
    assert found.to_surface.mean == pytest.approx(expected.to_surface.mean, abs=1e-6)
    assert found.hausdorff == pytest.approx(expected.hausdorff, abs=1e-6)
    assert found.reference_ml == pytest.approx(expected.reference_ml, rel=1e-9)
    # Half a voxel is what voxels know.
    assert colors_of(organ).mean() == pytest.approx(-2.0, abs=0.25)
    # The 3D view's surface is smoothed; it is neither made nor taken, and nothing is left behind but the results.
    assert not node.GetSegmentation().ContainsRepresentation("Closed surface")
    added = {entry.split()[0] for entry in mrml_scenes.content(slicer.mrmlScene) if entry not in content}
    assert added == {"vtkMRMLTableNode", "vtkMRMLColorLegendDisplayNode", "item"}


def test_a_segment_that_shares_its_label_map_is_told_from_the_others(logic, organ):
    from VICRegistrationLib.mrml.comparing import comparisonText

    image = label_image(ellipsoid())
    other = np.zeros_like(image.array)
    other[2:5, 2:5, 2:5] = 1
    node = add_segmentation(image, others={"t": other}.items())
    node.GetSegmentation().CollapseBinaryLabelmaps(False)
    assert node.GetSegmentation().GetNumberOfLayers() == 1
    found = logic.compare(organ, node, "segment s")
    assert "pieces" not in comparisonText(organ)
    assert found.volume_dice > 0.95
    assert found.reference_ml == pytest.approx(image.array.sum() * image.voxel_volume / 1000.0, rel=0.05)


def test_stray_pieces_of_a_reference_are_told(logic, organ):
    from VICRegistrationLib.mrml.comparing import comparisonText

    image = label_image(ellipsoid())
    image.array[2:5, 2:5, 2:5] = 1
    logic.compare(organ, add_segmentation(image))
    assert "2 pieces" in comparisonText(organ)
    assert "Islands" in comparisonText(organ)


def test_a_segment_that_came_as_a_surface_is_taken_as_that(logic, organ):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "contours")
    node.CreateDefaultDisplayNodes()
    node.SetSourceRepresentationToClosedSurface()
    node.AddSegmentFromClosedSurfaceRepresentation(triangles_of(ellipsoid()), "organ", [1, 0, 0])
    assert logic.compare(organ, node).hausdorff < 0.05
    assert not node.GetSegmentation().ContainsRepresentation("Binary labelmap")


def test_polygons_and_tetrahedra_are_taken_by_their_outer_triangles(logic, organ):
    grid = vtk.vtkAppendFilter()
    filling = vtk.vtkDelaunay3D()
    filling.SetInputData(triangles_of(ellipsoid(), chord_error=0.5))
    grid.AddInputConnection(filling.GetOutputPort())
    grid.Update()
    assert logic.compare(organ, add_model(grid.GetOutput(), "tetrahedra")).to_surface.mean < 0.5
    box = vtk.vtkCubeSource()
    box.SetCenter(*CENTER)
    box.SetXLength(28.0)
    box.SetYLength(36.0)
    box.SetZLength(44.0)
    box.Update()
    # A box of quadrilaterals whose corners are there three times, around the ellipsoid.
    found = logic.compare(organ, add_model(box.GetOutput(), "box"))
    assert found.reference_ml == pytest.approx(28 * 36 * 44 / 1000.0, rel=1e-6)
    # A B-spline surface is an ellipsoid to 0.02 mm.
    assert colors_of(organ).max() < 0.03


# --- transforms ------------------------------------------------------------------------------------------------------


def places(kind):
    """A transform node or None, and the functions that take points below it to the world and back."""
    if kind is None:
        return None, lambda points: points, lambda points: points
    if kind == "bent":
        spline = mrml_scenes.thin_plate_spline()
        back = spline.GetInverse()
        return (
            mrml_scenes.add_nonlinear_transform(spline),
            lambda points: mrml_scenes.through(spline, points),
            lambda points: mrml_scenes.through(back, points),
        )
    matrix = {"moved": RIGID, "stretched": RIGID @ SCALING, "mirrored": MIRROR}[kind]
    inverse = np.linalg.inv(matrix)
    return (
        mrml_scenes.add_linear_transform(matrix),
        lambda points: points @ matrix[:3, :3].T + matrix[:3, 3],
        lambda points: points @ inverse[:3, :3].T + inverse[:3, 3],
    )


@pytest.fixture(scope="module")
def in_one_place():
    """The ellipsoid compared with one that is larger by 1 mm, where nothing has to be moved."""
    return compare(ellipsoid(), larger(1.0))


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("moved", None),
        (None, "moved"),
        ("moved", "stretched"),
        (None, "mirrored"),
        ("bent", "moved"),
        ("moved", "bent"),
    ],
)
def test_a_mesh_is_brought_to_where_the_surface_lies(logic, in_one_place, ours, theirs):
    organ_under, to_world, _ = places(ours)
    mesh_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    # What is seen in the same place of the world.
    seen = triangles_of(larger(1.0), moved=lambda points: from_world(to_world(points)))
    found = logic.compare(organ, add_model(seen, under=mesh_under))
    assert found.to_surface.mean_signed == pytest.approx(in_one_place.to_surface.mean_signed, abs=0.02)
    np.testing.assert_allclose(colors_of(organ), -1.0, atol=0.1)
    assert found.volume_dice == pytest.approx(in_one_place.volume_dice, abs=0.003)


@pytest.fixture
def usual_points(few_points, monkeypatch):
    monkeypatch.setitem(compare.__kwdefaults__, "n_points", 10_000)


@pytest.mark.parametrize(("ours", "theirs"), [("moved", "stretched"), (None, "mirrored"), ("moved", "bent")])
def test_an_exact_surface_is_brought_to_where_the_other_lies(logic, usual_points, ours, theirs):
    organ_under, to_world, _ = places(ours)
    their_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    other = surface_model(ellipsoid(), under=their_under)
    found = logic.compare(organ, other)
    # The same, by points that are taken there one by one.
    _, to_world_theirs, _ = places(theirs)
    _, _, from_world_ours = places(ours)
    mesh = triangulate(ellipsoid(), chord_error=0.01)
    moved = ReferenceMesh(from_world_ours(to_world_theirs(mesh.points)), mesh.triangles)
    expected = compare(ellipsoid(), moved)
    # The points of both are drawn by lot: 10,000 of them know the mean to one hundredth of the spread.
    assert found.to_surface.mean == pytest.approx(expected.to_surface.mean, abs=0.03 * expected.to_surface.std)
    assert found.volume_dice == pytest.approx(expected.volume_dice, abs=0.003)


@pytest.mark.parametrize(("ours", "theirs"), [("moved", None), (None, "moved"), ("bent", "moved"), ("moved", "bent")])
def test_a_segment_is_brought_to_where_the_surface_lies(logic, ours, theirs):
    organ_under, to_world, _ = places(ours)
    segment_under, _, from_world = places(theirs)
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=organ_under))
    mesh = triangulate(ellipsoid(), chord_error=0.05)
    points = from_world(to_world(mesh.points))
    grid = label_image(closed_organ(axes=np.diag([26.0, 26.0, 26.0]), center=points.mean(axis=0)))
    fractions = volume_fractions(points, mesh.triangles, grid.array.shape, grid.ijk_to_ras)
    node = add_segmentation(Image((fractions >= 0.5).astype(np.uint8), grid.ijk_to_ras), under=segment_under)
    found = logic.compare(organ, node, "s")
    assert found.to_surface.mean < 0.4
    assert abs(found.to_surface.mean_signed) < 0.1
    assert found.volume_dice > 0.95


def test_below_one_bending_transform_nothing_is_bent(logic):
    under, _, _ = places("bent")
    organ = add_organ(logic, "bladder", mrml_scenes.add_volume(under=under))
    assert logic.compare(organ, surface_model(ellipsoid(), under=under)).hausdorff < 1e-6


# --- what cannot be compared -----------------------------------------------------------------------------------------


def open_triangles():
    data = triangles_of(ellipsoid(), chord_error=0.5)
    data.BuildLinks()
    data.DeleteCell(3)
    data.RemoveDeletedCells()
    return data


def removed(node):
    slicer.mrmlScene.RemoveNode(node)
    return node


BAD = {
    "nothing": (lambda organ: None, "No reference is chosen.*Choose one"),
    "removed": (lambda organ: removed(surface_model(ellipsoid())), "No reference is chosen"),
    "itself": (lambda organ: organ.surface, "is the surface of the organ itself"),
    "volume": (lambda organ: mrml_scenes.add_volume(name="grey"), "grey is no reference"),
    "no segment": (lambda organ: add_segmentation(label_image(ellipsoid()), others=[("t", None)]), "No segment of exp"),
    "no points": (
        lambda organ: slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "void"),
        "void has no triangles",
    ),
    "points": (lambda organ: add_model(vtk.vtkPolyData()), "reference has no triangles"),
    "open": (lambda organ: add_model(open_triangles()), "reference: The mesh is open"),
    "far": (lambda organ: surface_model(larger(0.0, shift=(100.0, 0.0, 0.0))), r"do not overlap: they are 7\d\.\d mm"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_compared_is_told_and_leaves_nothing(logic, organ, what):
    make, message = BAD[what]
    reference = make(organ)
    content, colors = mrml_scenes.content(slicer.mrmlScene), organ.surface.GetPolyData().GetPointData()
    with pytest.raises(ValueError, match=message):
        logic.compare(organ, reference)
    assert mrml_scenes.content(slicer.mrmlScene) == content
    assert not colors.HasArray(DEVIATION)
    assert organ.reference() == (None, "")


@pytest.mark.parametrize("cleared", [False, True])
def test_an_empty_segment_is_told(logic, organ, cleared):
    node = add_segmentation(label_image(ellipsoid()), others=[("t", None)])
    if cleared:
        slicer.vtkSlicerSegmentationsModuleLogic.ClearSegment(node, "s")
    with pytest.raises(ValueError, match="is empty.*paint it"):
        logic.compare(organ, node, "s" if cleared else "t")


def test_a_segment_far_away_is_told(logic, organ):
    node = add_segmentation(label_image(larger(0.0, shift=(0.0, 0.0, 90.0))))
    with pytest.raises(ValueError, match="bladder and expert: segment s do not overlap: they are 4.* transforms"):
        logic.compare(organ, node)


def test_an_organ_without_a_surface_is_told(logic):
    logic.getParameterNode().volume = mrml_scenes.add_volume()
    organ = logic.organs().add("bladder")
    with pytest.raises(ValueError, match="no surface yet.*Fit it first"):
        logic.compare(organ, surface_model(ellipsoid()))
    with pytest.raises(ValueError, match="no surface yet"):
        logic.color(organ, DEVIATION)


def test_a_segment_of_one_voxel_has_a_surface_too(logic, organ):
    image = label_image(ellipsoid())
    single = np.zeros_like(image.array)
    single[tuple(size // 2 for size in single.shape)] = 1
    node = add_segmentation(Image(single, image.ijk_to_ras))
    assert logic.compare(organ, node).reference_ml < 0.01
