"""What tests compare surfaces with: ellipsoids beside that of the small phantom, as segments, meshes and surfaces."""

from __future__ import annotations

import csv
import io

import mrml_scenes
import numpy as np
from mrml_scenes import slicer
from small_phantom import CENTER, ellipsoid
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image

DEVIATION, STANDARD_DEVIATION = "Deviation (mm)", "Standard deviation (mm)"


def add_organ(logic, name, volume, surface=None):
    logic.getParameterNode().volume = volume
    organ = logic.organs().add(name)
    logic.setSurface(organ, surface or ellipsoid())
    return organ


def larger(millimetres, *, shift=(0.0, 0.0, 0.0)):
    """The ellipsoid with longer semi-axes."""
    return closed_organ(axes=np.diag(np.array([14.0, 18.0, 22.0]) + millimetres), center=CENTER + shift)


def add_model(data, name="reference", *, under=None):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", name)
    node.SetAndObserveMesh(data) if data.IsA("vtkUnstructuredGrid") else node.SetAndObservePolyData(data)
    node.CreateDefaultDisplayNodes()
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    return node


def triangles_of(surface, *, chord_error=0.02, moved=lambda points: points):
    from VICRegistrationLib.geometry.polydata import polydata

    mesh = triangulate(surface, chord_error=chord_error)
    return polydata(moved(mesh.points), mesh.triangles)


def surface_model(surface, name="reference", *, under=None):
    """A model that carries an exact surface."""
    from VICRegistrationLib.mrml.surfaces import createModel, showSurface

    node = createModel(name, (1.0, 0.0, 0.0))
    showSurface(node, surface, name=name)
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    return node


def label_image(surface, *, spacing=(1.0, 1.0, 2.0), turn=None):
    """A painted image on a grid of its own, cut close around the surface so that it starts away from its origin."""
    mesh = triangulate(surface, chord_error=0.05)
    low, high = mesh.points.min(axis=0) - 6.0, mesh.points.max(axis=0) + 6.0
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn[:3, :3]) @ np.diag(spacing)
    radius = np.linalg.norm(high - low) / 2.0
    shape = tuple(int(2.0 * radius / step) for step in spacing[::-1])
    matrix[:3, 3] = (low + high) / 2.0 - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    fractions = volume_fractions(mesh.points, mesh.triangles, shape, matrix)
    return Image((fractions >= 0.5).astype(np.uint8), matrix)


def add_segmentation(image, *, under=None, others=()):
    """A segmentation with the segment "s" of an image, and with others that share its label map."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "expert")
    node.CreateDefaultDisplayNodes()
    grid = mrml_scenes.add_volume(image, "grid", under=under)
    if under is not None:
        node.SetAndObserveTransformNodeID(under.GetID())
    node.SetReferenceImageGeometryParameterFromVolumeNode(grid)
    for name, mask in {"s": image.array, **dict(others)}.items():
        node.GetSegmentation().AddEmptySegment(name, f"segment {name}", [1, 0, 0])
        if mask is not None:
            slicer.util.updateSegmentBinaryLabelmapFromArray(mask, node, name, grid)
    slicer.mrmlScene.RemoveNode(grid)
    return node


def colors_of(organ):
    return vtk_to_numpy(organ.surface.GetPolyData().GetPointData().GetArray(DEVIATION))


def table():
    from VICRegistrationLib.mrml.comparison_table import comparisonTable

    return comparisonTable()


def rows():
    """Rows of the table as texts by the names of their columns, through the clipboard's format."""
    from VICRegistrationLib.mrml.comparison_table import tableAsCsv

    return list(csv.DictReader(io.StringIO(tableAsCsv()[0])))


def legend_of(organ):
    return slicer.modules.colors.logic().GetColorLegendDisplayNode(organ.surface)
