"""The table of all comparisons of a scene: one row for every organ, patient and reference."""

from __future__ import annotations

import csv
import io

import slicer
import vtk
from slicer.i18n import tr as _

from .organ_nodes import removeNodes
from .regions import TYPE_ATTRIBUTE

PATIENT, ORGAN, REFERENCE = "Patient", "Organ", "Reference"
_KEYS = (PATIENT, ORGAN, REFERENCE)
_COMPARISON = "comparison"
# Of numbers that are copied: a tenth of a micrometre, a tenth of a microlitre.
_DIGITS = 4


def comparisonTable():
    """Table node of the scene's comparisons, if there is one.

    Returns
    -------
    vtkMRMLTableNode or None
        Where scenes were loaded on top of each other, the rows of all their tables, in the first of them.
    """
    nodes = slicer.util.getNodesByClass("vtkMRMLTableNode")
    tables = [node for node in nodes if node.GetAttribute(TYPE_ATTRIBUTE) == _COMPARISON]
    for other in tables[1:]:
        columns, count = _columns(other), other.GetNumberOfRows()
        rows = [{column.GetName(): column.GetValue(row) for column in columns} for row in range(count)]
        new = [values for values in rows if _rowOf(tables[0].GetTable(), values) is None]
        for values in new:
            _write(tables[0], values)
        # Without a new row it is a copy that somebody keeps.
        if new:
            removeNodes([other])
    return tables[0] if tables else None


def addComparison(comparison, *, patient, organ, reference):
    """Write a comparison into the scene's table, in place of an earlier one of the same organ, patient and reference.

    Parameters
    ----------
    comparison : VICRegistrationLib.analysis.comparison.Comparison
    patient, organ, reference : str
        Their names; quotation marks become apostrophes.

    Returns
    -------
    vtkMRMLTableNode
        Made where there was none. Columns and rows that others have added stay.
    """
    node = comparisonTable()
    if node is None:
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTableNode", _("VIC comparison"))
        node.SetAttribute(TYPE_ATTRIBUTE, _COMPARISON)
    names = {PATIENT: patient, ORGAN: organ, REFERENCE: reference}
    _write(node, {**{key: _storable(name) for key, name in names.items()}, **_numbers(comparison)})
    return node


def tableAsCsv():
    """Table of the scene's comparisons as text.

    Returns
    -------
    text : str
        Comma-separated values (RFC 4180), decimal points, the names of the columns first.
    count : int
        Number of rows below them.

    Raises
    ------
    ValueError
        If there is no comparison yet.
    """
    node = comparisonTable()
    count = node.GetNumberOfRows() if node is not None else 0
    if not count:
        raise ValueError(_("There is no comparison to copy yet. Press Compare first."))
    columns, text = _columns(node), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.GetName() for column in columns])
    for row in range(count):
        writer.writerow([_written(column, row) for column in columns])
    return text.getvalue(), count


def _numbers(comparison):
    """Numbers of a row by the name of their column."""
    there, back = comparison.to_surface, comparison.to_reference
    return {
        "Mean to surface (mm)": there.mean,
        "Standard deviation to surface (mm)": there.std,
        "RMS to surface (mm)": there.rms,
        "Median to surface (mm)": there.median,
        "95 % to surface (mm)": there.p95,
        "Mean to reference (mm)": back.mean,
        "95 % to reference (mm)": back.p95,
        "Signed mean (mm)": there.mean_signed,
        "Hausdorff (mm)": comparison.hausdorff,
        **{f"Surface Dice at {tolerance:g} mm": share for tolerance, share in comparison.surface_dice},
        "Volume Dice": comparison.volume_dice,
        "Volume (ml)": comparison.volume_ml,
        "Reference volume (ml)": comparison.reference_ml,
        "Volume difference (ml)": comparison.volume_difference_ml,
    }


def _storable(name):
    """Name without what Slicer's files of tables lose: tabs, new lines and quotation marks."""
    return " ".join(name.replace('"', "'").split())


def _columns(node):
    return [node.GetTable().GetColumn(index) for index in range(node.GetNumberOfColumns())]


def _write(node, values):
    """Write a row, in place of that of the same patient, organ and reference; columns that are missing are added."""
    table = node.GetTable()
    with slicer.util.NodeModify(node):
        for name, value in values.items():
            if table.GetColumnByName(name) is None:
                _addColumn(table, name, vtk.vtkStringArray if isinstance(value, str) else vtk.vtkDoubleArray)
        row = _rowOf(table, values)
        row = table.InsertNextBlankRow() if row is None else row
        for name, value in values.items():
            table.SetValueByName(row, name, vtk.vtkVariant(value))
        table.Modified()
        node.Modified()


def _addColumn(table, name, kind):
    column = kind()
    column.SetName(name)
    column.SetNumberOfTuples(table.GetNumberOfRows())
    if kind is vtk.vtkDoubleArray:
        column.Fill(0.0)
    table.AddColumn(column)


def _rowOf(table, values):
    """Find the row of the same patient, organ and reference; its number, or None."""
    for row in range(table.GetNumberOfRows()):
        if all(table.GetValueByName(row, name).ToString() == values.get(name, "") for name in _KEYS):
            return row
    return None


def _written(column, row):
    value = column.GetValue(row)
    return f"{value:.{_DIGITS}f}" if isinstance(value, float) else str(value)
