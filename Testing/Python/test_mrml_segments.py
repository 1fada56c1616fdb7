"""Segments as input instead of seeds: on any grid, under any transform, and those that cannot be used."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image

pytestmark = pytest.mark.usefixtures("cached_fits")

NEAR_MM = 0.25


def grid(spacing, *, matrix=None, size=70.0):
    """An empty image of isotropic voxels around the small phantom, turned about its centre."""
    turn = np.eye(3) if matrix is None else matrix[:3, :3]
    count = int(size / spacing)
    ijk_to_ras = np.eye(4)
    ijk_to_ras[:3, :3] = turn * spacing
    ijk_to_ras[:3, 3] = CENTER - ijk_to_ras[:3, :3] @ np.full(3, (count - 1) / 2.0)
    return Image(np.zeros((count,) * 3, dtype=np.uint8), ijk_to_ras)


def painted(image, surface=None):
    """Voxels of a grid of which half or more lies in the true surface, (nk, nj, ni)."""
    mesh = triangulate(surface or ellipsoid(), chord_error=0.1)
    fractions = volume_fractions(mesh.points, mesh.triangles, image.array.shape, image.ijk_to_ras)
    return (fractions >= 0.5).astype(np.uint8)


def add_segment(reference, mask, *, under=None):
    """A segmentation with one segment "s" on the grid of a volume node."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "hand made")
    node.CreateDefaultDisplayNodes()
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    node.SetReferenceImageGeometryParameterFromVolumeNode(reference)
    node.GetSegmentation().AddEmptySegment("s", "Organ by hand", [1, 0, 0])
    slicer.util.updateSegmentBinaryLabelmapFromArray(mask, node, "s", reference)
    return node


def overlap(found, true):
    """Dice coefficient of two masks."""
    return 2.0 * np.count_nonzero(found & true) / (found.sum() + true.sum())


def test_a_segment_on_the_grid_of_the_volume_is_taken_as_it_is(logic):
    volume, mask = mrml_scenes.add_volume(), painted(mrml_scenes.mri())
    node = add_segment(volume, mask)
    content = mrml_scenes.content(slicer.mrmlScene)
    organ = logic.addOrgan(volume, segment=(node, "s"))
    # Nothing but the organ is new: looking at voxels leaves no node.
    logic.organs().remove(organ)
    left = [entry for entry in mrml_scenes.content(slicer.mrmlScene) if entry not in content]
    assert left == ["vtkMRMLScriptedModuleNode vtkMRMLScriptedModuleNodeVICRegistration"]
    organ = logic.addOrgan(volume, segment=(node, "s"))
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, volume), mask > 0)
    assert organ.volumeMl == pytest.approx(mask.sum() * 1.2 * 1.2 * 3.0 / 1000.0)
    assert organ.state.value == "separated"


def test_a_fit_from_a_segment_finds_the_edge_in_the_image(logic):
    volume = mrml_scenes.add_volume()
    # Two millimetres too small, as painted by a careful hand.
    mesh = triangulate(ellipsoid(), chord_error=0.1)
    image = mrml_scenes.mri()
    small = volume_fractions(mesh.points - 2.0 * mesh.normals, mesh.triangles, image.array.shape, image.ijk_to_ras)
    node = add_segment(volume, (small >= 0.5).astype(np.uint8))
    organ = logic.fit(volume, segment=(node, "s"))
    assert deviation(logic.surface(organ), ellipsoid(), n_points=1000).mean < NEAR_MM
    # What was painted stays as it is.
    kept = slicer.util.arrayFromSegmentBinaryLabelmap(node, "s", volume)
    np.testing.assert_array_equal(kept > 0, small >= 0.5)


@pytest.mark.parametrize("spacing", [0.8, 2.0])
@pytest.mark.parametrize("degrees", [0.0, 35.0])
def test_a_segment_on_another_grid_is_brought_to_that_of_the_volume(logic, spacing, degrees):
    volume = mrml_scenes.add_volume()
    other = grid(spacing, matrix=motion(degrees, (1, 2, -1)))
    node = add_segment(mrml_scenes.add_volume(other, "other"), painted(other))
    organ = logic.fit(volume, segment=(node, "s"))
    # A voxel at the border is on one side or the other; the shell of half a voxel of the coarser grid is worth this.
    assert overlap(mrml_scenes.segment_voxels(organ, volume), painted(mrml_scenes.mri()) > 0) > 0.93
    assert deviation(logic.surface(organ), ellipsoid(), n_points=500).mean < NEAR_MM


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
@pytest.mark.parametrize("which", ["segment", "volume", "both"])
def test_transforms_of_the_segment_and_of_the_volume_are_respected(logic, kind, which):
    matrix = motion(40, (2, -1, 1), (12, -9, 4))
    spline = mrml_scenes.thin_plate_spline()
    nonlinear = kind == "nonlinear"
    node = mrml_scenes.add_nonlinear_transform(spline) if nonlinear else mrml_scenes.add_linear_transform(matrix)
    volume = mrml_scenes.add_volume(under=node if which != "segment" else None)
    # On a grid of its own, painted where the organ is seen in the world, taken back through the segment's transform.
    other = grid(1.0, size=110.0)
    mesh = triangulate(ellipsoid(), chord_error=0.1)
    points = {
        ("segment", "linear"): (mesh.points - matrix[:3, 3]) @ matrix[:3, :3],
        ("volume", "linear"): mesh.points @ matrix[:3, :3].T + matrix[:3, 3],
        ("segment", "nonlinear"): mrml_scenes.through(spline.GetInverse(), mesh.points),
        ("volume", "nonlinear"): mrml_scenes.through(spline, mesh.points),
    }.get((which, kind), mesh.points)
    mask = volume_fractions(points, mesh.triangles, other.array.shape, other.ijk_to_ras) >= 0.5
    reference = mrml_scenes.add_volume(other, "other", under=node if which != "volume" else None)
    drawn = add_segment(reference, mask.astype(np.uint8), under=node if which != "volume" else None)
    organ = logic.fit(volume, segment=(drawn, "s"))
    assert deviation(logic.surface(organ), ellipsoid(), n_points=500).mean < NEAR_MM


def test_of_several_pieces_the_largest_is_taken(logic):
    volume, mask = mrml_scenes.add_volume(), painted(mrml_scenes.mri())
    pieces = mask.copy()
    pieces[1:3, 2:5, 2:5] = 1
    organ = logic.addOrgan(volume, segment=(add_segment(volume, pieces), "s"))
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, volume), mask > 0)


def test_a_closed_surface_can_be_a_segment_too(logic):
    from VICRegistrationLib.export.surface_data import polydata_of_mesh

    volume = mrml_scenes.add_volume()
    model = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "drawn")
    model.SetAndObservePolyData(polydata_of_mesh(triangulate(ellipsoid(), chord_error=0.1)))
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "from a model")
    node.SetReferenceImageGeometryParameterFromVolumeNode(volume)
    assert slicer.modules.segmentations.logic().ImportModelToSegmentationNode(model, node)
    organ = logic.fit(volume, segment=(node, node.GetSegmentation().GetNthSegmentID(0)))
    assert deviation(logic.surface(organ), ellipsoid(), n_points=500).mean < NEAR_MM


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("empty", "Organ by hand holds no voxel of the volume mri.*paint it"),
        ("outside", "Organ by hand holds no voxel of the volume mri"),
        ("missing", "No segment is chosen.*Choose a segmentation and a segment"),
        ("no segmentation", "No segment is chosen"),
    ],
)
def test_a_refused_segment_leaves_nothing_behind(logic, what, message):
    volume = mrml_scenes.add_volume()
    mask = painted(mrml_scenes.mri())
    node = add_segment(volume, mask * 0 if what == "empty" else mask)
    if what == "outside":
        move = mrml_scenes.add_linear_transform(motion(0, (1, 0, 0), (500, 0, 0)))
        node.SetAndObserveTransformNodeID(move.GetID())
    segment = {"missing": (node, "x"), "no segmentation": (None, "")}.get(what, (node, "s"))
    logic.getParameterNode()
    before = mrml_scenes.content(slicer.mrmlScene)
    with pytest.raises(ValueError, match=message):
        logic.addOrgan(volume, segment=segment)
    assert mrml_scenes.content(slicer.mrmlScene) == before


def test_a_thin_segment_cannot_be_fitted_and_says_why(logic):
    volume, mask = mrml_scenes.add_volume(), painted(mrml_scenes.mri()) * 0
    mask[8:14, 20:40, 25] = 1
    with pytest.raises(ValueError, match="mm thick"):
        logic.fit(volume, segment=(add_segment(volume, mask), "s"))


def test_a_region_that_is_its_own_segment_outlives_a_volume_elsewhere(logic):
    """The user may have edited it."""
    from VICRegistrationLib.mrml.separating import separateOrgan

    volume, mask = mrml_scenes.add_volume(), painted(mrml_scenes.mri())
    organ = logic.addOrgan(volume, segment=(add_segment(volume, mask), "s"))
    organ.inputSegmentation, organ.inputSegmentId = organ.regions, organ.regionSegmentId
    far = mrml_scenes.add_volume(name="knee", under=mrml_scenes.add_linear_transform(motion(0, (1, 0, 0), (500, 0, 0))))
    with pytest.raises(ValueError, match="holds no voxel of the volume knee"):
        separateOrgan(organ, far)
    found = slicer.util.arrayFromSegmentBinaryLabelmap(organ.regions, organ.regionSegmentId, volume)
    np.testing.assert_array_equal(found, mask)
