"""The course of a fit as a table and a plot."""

from __future__ import annotations

import slicer
import vtk
from slicer.i18n import tr as _

STAGE, ITERATION, COST, DISPLACEMENT = "Stage", "Iteration", "Cost", "Displacement (mm)"


def showConvergence(tableNode, history):
    """Write the steps of a fit into a table: stage, iteration over all stages, cost, largest displacement.

    Parameters
    ----------
    tableNode : vtkMRMLTableNode
    history : sequence of VICRegistrationLib.registration.stages.Step
    """
    table = vtk.vtkTable()
    for name, make, values in (
        (STAGE, vtk.vtkStringArray, [step.stage for step in history]),
        (ITERATION, vtk.vtkIntArray, range(1, len(history) + 1)),
        (COST, vtk.vtkDoubleArray, [step.cost for step in history]),
        (DISPLACEMENT, vtk.vtkDoubleArray, [step.displacement for step in history]),
    ):
        column = make()
        column.SetName(name)
        for value in values:
            column.InsertNextValue(value)
        table.AddColumn(column)
    tableNode.SetAndObserveTable(table)


def createPlot(name, color):
    """Make a chart of the cost over the iterations; the layout stays.

    Parameters
    ----------
    name : str
    color : (r, g, b)

    Returns
    -------
    vtkMRMLPlotChartNode
        Its one series still needs a table, as :func:`showConvergence` fills it.
    """
    series = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLPlotSeriesNode", name)
    series.SetXColumnName(ITERATION)
    series.SetYColumnName(COST)
    series.SetPlotType(series.PlotTypeScatter)
    series.SetMarkerStyle(series.MarkerStyleCircle)
    series.SetColor(*color)
    chart = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLPlotChartNode", name)
    chart.AddAndObservePlotSeriesNodeID(series.GetID())
    chart.SetTitle(name)
    chart.SetXAxisTitle(_("Iteration"))
    chart.SetYAxisTitle(_("Cost"))
    chart.SetLegendVisibility(False)
    return chart


def seriesOf(organ):
    """Plot series of an organ: that of its chart, or one of its table's costs whose chart was deleted.

    Series of other columns of the table are the user's own.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    list of vtkMRMLPlotSeriesNode
    """
    table, chart = organ.convergence, organ.plot
    return [
        node
        for node in slicer.util.getNodesByClass("vtkMRMLPlotSeriesNode")
        if (table is not None and node.GetTableNode() is table and node.GetYColumnName() == COST)
        or (chart is not None and chart.HasPlotSeriesNodeID(node.GetID()))
    ]
