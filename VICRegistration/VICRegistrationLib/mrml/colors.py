"""Surfaces coloured by numbers at their points, with a legend beside them."""

from __future__ import annotations

import math

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

# Names of the points' numbers in the model, which Slicer shows as they are.
DEVIATION, STANDARD_DEVIATION = "Deviation (mm)", "Standard deviation (mm)"
# Numbers with a sign are shown from blue to red, with the same range on both sides of zero.
_DIVERGING = (DEVIATION,)
_DIVERGING_COLORS = "vtkMRMLColorTableNodeFileDivergingBlueRed.txt"
_SEQUENTIAL_COLORS = "vtkMRMLColorTableNodeFileViridis.txt"
# The colours end here, so that one corner that is far off does not make all the rest look alike.
_PERCENTILE = 95.0
_LEAST_RANGE = 0.1
# From the right edge of a view; a legend takes 0.15 of its width.
_LEGEND_PLACES = (0.95, 0.75, 0.55, 0.35, 0.15)
_LEGEND_HEIGHT = 0.5


def addNumbers(data, name, values):
    """Give points numbers that they can be coloured by.

    Parameters
    ----------
    data : vtkPolyData
    name : str
        Such as `DEVIATION`; numbers of this name are replaced.
    values : (n,) array_like
        One for every point.
    """
    array = numpy_to_vtk(np.ascontiguousarray(values, dtype=float), deep=True)
    array.SetName(name)
    data.GetPointData().AddArray(array)
    data.Modified()


def hasNumbers(modelNode, name):
    """Whether the points of a model have numbers of a name.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode or None
    name : str or None

    Returns
    -------
    bool
    """
    return modelNode is not None and name is not None and _has(modelNode.GetPolyData(), name)


def coloredBy(modelNode):
    """Name of the numbers that a model is coloured by.

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
    return name if hasNumbers(modelNode, name) else None


def colorBy(modelNode, name=None):
    """Colour a model by numbers of its points, with a legend.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode or None
    name : str, optional
        Of the numbers; the model shows its own colour if not given.

    Raises
    ------
    ValueError
        If there is no model, or its points have no such numbers.

    Notes
    -----
    The range is that of 95 % of the points, rounded up to 1, 2 or 5 times a power of ten, at least 0.1; what is beyond
    it has the colours of its ends.
    """
    if modelNode is None:
        raise ValueError(_("There is no surface yet; one is needed to be coloured. Fit the organ first."))
    if name is not None and not hasNumbers(modelNode, name):
        raise ValueError(
            _("The model {model} has no numbers named {name} at its points; they are needed to colour it.").format(
                model=modelNode.GetName(), name=name
            )
        )
    if modelNode.GetDisplayNode() is None:
        modelNode.CreateDefaultDisplayNodes()
    display = modelNode.GetDisplayNode()
    with slicer.util.NodeModify(display):
        if name is not None:
            display.SetActiveScalar(name, vtk.vtkAssignAttribute.POINT_DATA)
            display.SetAndObserveColorNodeID(_DIVERGING_COLORS if name in _DIVERGING else _SEQUENTIAL_COLORS)
            display.SetScalarRangeFlag(slicer.vtkMRMLDisplayNode.UseManualScalarRange)
            display.SetScalarRange(*_range(modelNode.GetPolyData(), name))
        display.SetScalarVisibility(name is not None)
    showLegend(modelNode)


def exchangePolyData(modelNode, data):
    """Let a model show other triangles; it gets its own colour back where they lack what it was coloured by.

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
        colorBy(modelNode, name)


def showLegend(modelNode):
    """Show the legend of a model that is seen in colours, beside those of others, and hide it otherwise.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    """
    name = coloredBy(modelNode)
    visible = name is not None and bool(modelNode.GetDisplayNode().GetVisibility())
    legend = _legendOf(modelNode, make=visible)
    if legend is None:
        return
    if not visible:
        legend.SetVisibility(False)
        return
    high = modelNode.GetDisplayNode().GetScalarRange()[1]
    taken = [other.GetPosition()[0] for other in _legends() if other is not legend and other.GetVisibility()]
    free = [place for place in _LEGEND_PLACES if all(abs(place - other) > 0.01 for other in taken)]
    with slicer.util.NodeModify(legend):
        if not legend.GetVisibility() or legend.GetPosition()[0] not in free:
            legend.SetPosition((free or _LEGEND_PLACES)[0], _LEGEND_HEIGHT)
        legend.SetTitleText(f"{modelNode.GetName()}\n{name}")
        # So many labels that their steps have as few digits as the ends of the range.
        legend.SetNumberOfLabels(5 if name in _DIVERGING else 6)
        legend.SetLabelFormat("%.2f" if high < 1.0 else "%.1f")
        legend.SetVisibility(True)


def _has(data, name):
    return data is not None and bool(data.GetPointData().HasArray(name))


def _range(data, name):
    """Range of the colours for the numbers of a name."""
    values = np.abs(vtk_to_numpy(data.GetPointData().GetArray(name)))
    high = _roundedUp(max(float(np.percentile(values, _PERCENTILE)) if len(values) else 0.0, _LEAST_RANGE))
    return (-high if name in _DIVERGING else 0.0), high


def _roundedUp(value):
    """1, 2 or 5 times a power of ten that is not below a value, as far as its first digits tell."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999 * value)


def _legendOf(modelNode, *, make):
    """Legend of a model, made where there is none if that is asked for; None where Slicer has no module Colors."""
    colors = getattr(slicer.modules, "colors", None)
    if colors is None or modelNode.GetDisplayNode() is None:
        return None
    legend = colors.logic().GetColorLegendDisplayNode(modelNode)
    return colors.logic().AddDefaultColorLegendDisplayNode(modelNode) if legend is None and make else legend


def _legends():
    return slicer.util.getNodesByClass("vtkMRMLColorLegendDisplayNode")
