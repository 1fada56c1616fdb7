"""What tests of the module on real MRML put into a scene, and look at there; they are skipped without slicer-core."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import vtk
from reorientation import motion
from small_phantom import CENTER, ellipsoid, ellipsoid_image
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")


@functools.lru_cache(maxsize=1)
def mri():
    """The small phantom, painted once."""
    return ellipsoid_image()


def logic():
    """A new logic of the module; the fixture slicer_module must be in use."""
    from VICRegistration import VICRegistrationLogic

    return VICRegistrationLogic()


def add_volume(image=None, name="mri", *, under=None):
    """Add an image, by default the small phantom, to the scene as a volume, under a transform node if one is given."""
    image = image or mri()
    node = slicer.util.addVolumeFromArray(np.array(image.array), ijkToRAS=image.ijk_to_ras, name=name)
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    return node


def oblique(image=None, matrix=None):
    """The same voxels elsewhere in the world, turned about no axis of theirs."""
    image = image or mri()
    return Image(image.array, (motion(40, (1, 2, -1), (10, -5, 3)) if matrix is None else matrix) @ image.ijk_to_ras)


def add_linear_transform(matrix):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "linear")
    node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(np.asarray(matrix, dtype=float)))
    return node


def thin_plate_spline():
    """A smooth bend of the surroundings of the small phantom: one side is moved by 8 mm, all the rest by less."""
    corners = np.stack(np.meshgrid(*[(-60.0, 60.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + CENTER
    moved = {(20, 0, 0): (8, 4, 0), (-20, 0, 0): (0, -3, 2), (0, 0, 25): (2, 0, 5)}
    source, target = vtk.vtkPoints(), vtk.vtkPoints()
    for point in corners:
        source.InsertNextPoint(point)
        target.InsertNextPoint(point)
    for place, shift in moved.items():
        source.InsertNextPoint(CENTER + place)
        target.InsertNextPoint(CENTER + place + shift)
    spline = vtk.vtkThinPlateSplineTransform()
    # In three dimensions the thin plate's kernel is the distance.
    spline.SetBasisToR()
    spline.SetSourceLandmarks(source)
    spline.SetTargetLandmarks(target)
    spline.Update()
    return spline


def displacement_grid():
    """A wave of displacements of up to 5 mm on a grid of 10 mm around the small phantom."""
    size, spacing = 15, 10.0
    origin = CENTER - spacing * (size - 1) / 2
    axis = np.arange(size) * spacing
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    waves = [5.0 * np.sin(y / 25.0), 3.0 * np.cos(z / 30.0), 4.0 * np.sin(x / 40.0)]
    image = vtk.vtkImageData()
    image.SetDimensions(size, size, size)
    image.SetSpacing(spacing, spacing, spacing)
    image.SetOrigin(*origin)
    image.AllocateScalars(vtk.VTK_DOUBLE, 3)
    vtk_to_numpy(image.GetPointData().GetScalars())[:] = np.stack([wave.ravel() for wave in waves], axis=1)
    grid = slicer.vtkOrientedGridTransform()
    grid.SetDisplacementGridData(image)
    grid.SetInterpolationModeToCubic()
    return grid


def add_nonlinear_transform(transform, *, from_parent=False):
    """A transform node that takes what is under it to its parent by a VTK transform, or the other way round."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTransformNode", "nonlinear")
    if from_parent:
        node.SetAndObserveTransformFromParent(transform)
    else:
        node.SetAndObserveTransformToParent(transform)
    return node


def through(transform, points):
    """Points taken through a VTK transform one by one, (n, 3)."""
    return np.array([transform.TransformPoint(point) for point in np.atleast_2d(points)])


def hardened_points(model):
    """Points of a copy of a model into which its transforms are hardened: where Slicer shows them, (n, 3)."""
    copy = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "hardened")
    data = vtk.vtkPolyData()
    data.DeepCopy(model.GetPolyData())
    copy.SetAndObservePolyData(data)
    copy.SetAndObserveTransformNodeID(model.GetTransformNodeID())
    assert copy.HardenTransform()
    points = slicer.util.arrayFromModelPoints(copy).astype(float)
    slicer.mrmlScene.RemoveNode(copy)
    return points


def true_triangles(transform, *, surface=None):
    """Triangles of the true surface, every point taken through a function of (n, 3) points, as polydata."""
    from VICRegistrationLib.geometry.polydata import polydata

    mesh = triangulate(surface or ellipsoid(), chord_error=0.02)
    return polydata(transform(mesh.points), mesh.triangles)


def distances_to(triangles, points):
    """Distances of points from triangles, (n,) mm."""
    distance = vtk.vtkImplicitPolyDataDistance()
    distance.SetInput(triangles)
    return np.abs([distance.EvaluateFunction(point) for point in points])


def enclosed_ml(triangles):
    properties = vtk.vtkMassProperties()
    properties.SetInputData(triangles)
    return properties.GetVolume() / 1000.0


def segment_voxels(organ, volume):
    """Voxels of an organ's segment on its volume's grid, (nk, nj, ni)."""
    voxels = slicer.util.arrayFromSegmentBinaryLabelmap(organ.regions, organ.regionSegmentId, volume) > 0
    # That leaves one behind.
    for display in slicer.util.getNodesByClass("vtkMRMLLabelMapVolumeDisplayNode"):
        slicer.mrmlScene.RemoveNode(display)
    return voxels


def content(scene):
    """Everything in a scene: its nodes by class and ID, and the items of the subject hierarchy by name."""
    nodes = [scene.GetNthNode(index) for index in range(scene.GetNumberOfNodes())]
    hierarchy = scene.GetSubjectHierarchyNode()
    items = vtk.vtkIdList()
    hierarchy.GetItemChildren(hierarchy.GetSceneItemID(), items, True)
    names = [f"item {hierarchy.GetItemName(items.GetId(index))}" for index in range(items.GetNumberOfIds())]
    return sorted([f"{node.GetClassName()} {node.GetID()}" for node in nodes] + names)


def owned_counts(scene):
    """How many nodes of each class there are that an organ may own; display nodes go with those."""
    kinds = ("Model", "MarkupsFiducial", "Table", "PlotChart", "PlotSeries", "Segmentation", "ScriptedModule")
    return {kind: scene.GetNumberOfNodesByClass(f"vtkMRML{kind}Node") for kind in kinds}


def n_observers(node):
    """Number of observers of a node."""
    # Tags are given in rising order.
    last = node.AddObserver("ModifiedEvent", lambda *_: None)
    count = sum(node.GetCommand(tag) is not None for tag in range(1, last))
    node.RemoveObserver(last)
    return count
