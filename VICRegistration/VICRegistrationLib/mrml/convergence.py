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


def createPlot(tableNode, name, color):
    """Make a chart of the cost over the iterations, without touching the layout.

    Parameters
    ----------
    tableNode : vtkMRMLTableNode
        As :func:`showConvergence` fills it; the plot follows it. A series that plots it already is taken.
    name : str
    color : (r, g, b)

    Returns
    -------
    vtkMRMLPlotChartNode
        Its series is given by :func:`seriesOf`.
    """
    left = seriesOfTable(tableNode)
    series = left[0] if left else slicer.mrmlScene.AddNewNodeByClass("vtkMRMLPlotSeriesNode", name)
    series.SetAndObserveTableNodeID(tableNode.GetID())
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


def seriesOf(chartNode):
    """Plot series of a chart.

    Parameters
    ----------
    chartNode : vtkMRMLPlotChartNode

    Returns
    -------
    list of vtkMRMLPlotSeriesNode
    """
    nodes = [chartNode.GetNthPlotSeriesNode(index) for index in range(chartNode.GetNumberOfPlotSeriesNodes())]
    return [node for node in nodes if node is not None]


def seriesOfTable(tableNode):
    """Plot series of a table, whether a chart shows them or not.

    Parameters
    ----------
    tableNode : vtkMRMLTableNode

    Returns
    -------
    list of vtkMRMLPlotSeriesNode
    """
    return [node for node in slicer.util.getNodesByClass("vtkMRMLPlotSeriesNode") if node.GetTableNode() is tableNode]
