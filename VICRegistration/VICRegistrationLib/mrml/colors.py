"""Surfaces coloured by point scalars: all models that show the same scalars share one range and one legend."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

# Names of the scalars, which Slicer shows to the user.
DEVIATION, STANDARD_DEVIATION = "Deviation (mm)", "Standard deviation (mm)"
# The colour range ends at this percentile: a few outliers would make all other points look alike.
_PERCENTILE = 95.0
_LEAST_RANGE = 0.1


@dataclass(frozen=True)
class _Scale:
    """How scalars are shown.

    Parameters
    ----------
    colors : str
        ID of Slicer's colour node.
    signed : bool
        Whether zero is in the middle.
    labels : int
        Number of labels in the legend, whose values then have as few digits as the ends of the range.
    place : (x, y)
        Of the legend in the view, 0 to 1 from the lower left corner.
    """

    colors: str
    signed: bool
    labels: int
    place: tuple[float, float]


_SCALES = {
    DEVIATION: _Scale("vtkMRMLColorTableNodeFileDivergingBlueRed.txt", True, 5, (0.95, 0.5)),
    STANDARD_DEVIATION: _Scale("vtkMRMLColorTableNodeFileViridis.txt", False, 6, (0.05, 0.5)),
}


def addScalars(data, name, values):
    """Add a scalar array that points can be coloured by.

    Parameters
    ----------
    data : vtkPolyData
    name : {DEVIATION, STANDARD_DEVIATION}
        An array of this name is replaced.
    values : (n,) array_like
        One for every point.
    """
    array = numpy_to_vtk(np.ascontiguousarray(values, dtype=float), deep=True)
    array.SetName(name)
    data.GetPointData().AddArray(array)
    data.Modified()


def hasScalars(modelNode, name):
    """Whether a model has a scalar array that it can be coloured by.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode or None
    name : str or None

    Returns
    -------
    bool
    """
    return modelNode is not None and name in _SCALES and _has(modelNode.GetPolyData(), name)


def coloredBy(modelNode):
    """Name of the scalars that a model is coloured by.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode or None

    Returns
    -------
    str or None
        None where it shows its own colour.
    """
    display = modelNode.GetDisplayNode() if modelNode is not None else None
    if display is None or not display.GetScalarVisibility():
        return None
    name = display.GetActiveScalarName()
    return name if hasScalars(modelNode, name) else None


def colorBy(modelNode, name=None):
    """Colour a model by its scalars, with a legend.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode or None
    name : {DEVIATION, STANDARD_DEVIATION}, optional
        The model shows its own colour if not given.

    Raises
    ------
    ValueError
        If there is no model, or it has no such scalars.
    """
    if modelNode is None:
        raise ValueError(_("There is no surface yet. Fit the organ first."))
    if name is not None and not hasScalars(modelNode, name):
        raise ValueError(
            _("The model {model} has no point scalars named {name}, so it cannot be coloured by them.").format(
                model=modelNode.GetName(), name=name
            )
        )
    if modelNode.GetDisplayNode() is None:
        modelNode.CreateDefaultDisplayNodes()
    display = modelNode.GetDisplayNode()
    with slicer.util.NodeModify(display):
        if name is not None:
            display.SetActiveScalar(name, vtk.vtkAssignAttribute.POINT_DATA)
            display.SetAndObserveColorNodeID(_SCALES[name].colors)
            display.SetScalarRangeFlag(slicer.vtkMRMLDisplayNode.UseManualScalarRange)
        display.SetScalarVisibility(name is not None)
    updateLegends()


def exchangePolyData(modelNode, data):
    """Replace the triangles of a model; it gets its own colour back if they lack the scalars it was coloured by.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    data : vtkPolyData
    """
    name = coloredBy(modelNode)
    if name is not None and not _has(data, name):
        colorBy(modelNode, None)
    modelNode.SetAndObservePolyData(data)
    if coloredBy(modelNode) is not None:
        updateLegends()


def updateLegends():
    """Give all models that are coloured by the same scalars one range, and the visible ones among them one legend.

    Notes
    -----
    The range holds 95 % of the points of each model. It is rounded up to 1, 2 or 5 times a power of ten, and at least
    0.1 mm; values beyond it have the colours of its ends.
    """
    models = slicer.util.getNodesByClass("vtkMRMLModelNode")
    names = [coloredBy(node) for node in models]
    for name, scale in _SCALES.items():
        colored = [node for node, shown in zip(models, names) if shown == name]
        high = _roundedUp(max([_LEAST_RANGE, *(_extent(node, name) for node in colored)]))
        for node in colored:
            node.GetDisplayNode().SetScalarRange(-high if scale.signed else 0.0, high)
        seen = [node for node in colored if node.GetDisplayNode().GetVisibility()]
        for node in seen[:1]:
            _showLegend(node, name, high)
        for node in [*seen[1:], *(node for node in colored if node not in seen)]:
            _hideLegend(node)
    for node, name in zip(models, names):
        if name is None:
            _hideLegend(node)


def _showLegend(modelNode, name, high):
    colors, scale = _colorLogic(), _SCALES[name]
    legend = colors.AddDefaultColorLegendDisplayNode(modelNode) if colors is not None else None
    if legend is None:
        return
    with slicer.util.NodeModify(legend):
        legend.SetTitleText(name)
        legend.SetPosition(*scale.place)
        legend.SetNumberOfLabels(scale.labels)
        legend.SetLabelFormat("%.2f" if high < 1.0 else "%.1f")
        # In slice views it would cover the image.
        legend.SetVisibility2D(False)
        legend.SetVisibility(True)


def _hideLegend(modelNode):
    colors = _colorLogic()
    if colors is None or modelNode.GetDisplayNode() is None:
        return
    legend = colors.GetColorLegendDisplayNode(modelNode)
    if legend is not None and legend.GetTitleText() in _SCALES:
        legend.SetVisibility(False)


def _colorLogic():
    """Logic of Slicer's module Colors, or None if the module is disabled."""
    module = getattr(slicer.modules, "colors", None)
    return module.logic() if module is not None else None


def _has(data, name):
    return data is not None and bool(data.GetPointData().HasArray(name))


def _extent(modelNode, name):
    """Absolute value that the scalars at 95 % of the points do not exceed."""
    values = np.abs(vtk_to_numpy(modelNode.GetPolyData().GetPointData().GetArray(name)))
    return float(np.percentile(values, _PERCENTILE)) if len(values) else 0.0


def _roundedUp(value):
    """Smallest of 1, 2 and 5 times a power of ten that is not below a value, to three digits."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999 * value)
