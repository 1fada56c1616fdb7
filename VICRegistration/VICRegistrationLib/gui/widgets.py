"""Helpers of the panel's sections for tables, rows of a form, and buttons that place points."""

from __future__ import annotations

import contextlib
import os

LEAST_ROWS, MOST_ROWS = 2, 6
# Rows of the list of further stacks that are visible at once.
STACK_ROWS = 3


def setUpTable(table, titles, *, wide):
    """Set up the columns of a table, whose cells cannot be edited.

    Parameters
    ----------
    table : QTableWidget
    titles : list of str
    wide : int
        Column that gets the remaining width; the others are as wide as their contents.
    """
    import qt

    table.setColumnCount(len(titles))
    table.setHorizontalHeaderLabels(titles)
    table.verticalHeader().setVisible(False)
    table.setEditTriggers(qt.QAbstractItemView.NoEditTriggers)
    for column in range(len(titles)):
        mode = qt.QHeaderView.Stretch if column == wide else qt.QHeaderView.ResizeToContents
        table.horizontalHeader().setSectionResizeMode(column, mode)
    fitHeight(table)


def tableHeight(rows, *, row, header, frame, least=LEAST_ROWS, most=MOST_ROWS):
    """Height of a table; rows beyond the most are scrolled.

    Parameters
    ----------
    rows : int
        Number of rows.
    row, header, frame : int
        Height of one row, height of the header, and width of the frame, pixels.
    least, most : int
        Rows that there is room for.

    Returns
    -------
    int
        Pixels.
    """
    return header + min(max(rows, least), most) * row + 2 * frame


def fitHeight(table, *, header=True, least=LEAST_ROWS, most=MOST_ROWS):
    """Set the height of a table to that of its rows.

    Parameters
    ----------
    table : QTableWidget
    header : bool
        Whether its columns have titles.
    least, most : int
        Rows that there is room for.
    """
    titles = table.horizontalHeader().sizeHint.height() if header else 0
    sizes = {"row": table.verticalHeader().defaultSectionSize, "header": titles, "frame": table.frameWidth}
    table.setFixedHeight(tableHeight(table.rowCount, **sizes, least=least, most=most))


def organRows(stackRows):
    """Return the number of organs that are visible at once, so that the panel down to its status has 600 pixels.

    Parameters
    ----------
    stackRows : int
        Rows of the list of further stacks.

    Returns
    -------
    int
    """
    return MOST_ROWS - 1 - stackRows if stackRows else MOST_ROWS


def showRow(visible, *widgets):
    """Show or hide the label and the fields of a row.

    Parameters
    ----------
    visible : bool
    *widgets : QWidget
    """
    for widget in widgets:
        widget.visible = visible


@contextlib.contextmanager
def signalsBlocked(widget):
    """Block the signals of a widget while its contents are set, which is no choice of the user.

    Parameters
    ----------
    widget : QWidget
    """
    blocked = widget.blockSignals(True)
    try:
        yield
    finally:
        widget.blockSignals(blocked)


def showPlaceButtons(widget):
    """Show only the buttons that place and delete points, and make a list visible when points are placed in it.

    Parameters
    ----------
    widget : qSlicerMarkupsPlaceWidget
    """
    widget.buttonsVisible = False
    widget.placeButton().show()
    widget.deleteButton().show()
    widget.connect("activeMarkupsPlaceModeChanged(bool)", lambda placing: placing and _show(widget.currentNode()))


def _show(node):
    # Slicer also places points in a hidden list, where they would not be visible.
    if node.GetDisplayNode() is not None:
        node.GetDisplayNode().SetVisibility(True)


def stopPlacing(widget):
    """Leave the mode in which clicks place points of a widget's list; the mode of another list stays.

    Parameters
    ----------
    widget : qSlicerMarkupsPlaceWidget
    """
    if widget.placeModeEnabled:
        widget.setPlaceModeEnabled(False)


def folderIn(pathEdit):
    """Absolute path of the folder that a user has chosen or typed, so that messages say where files are.

    Parameters
    ----------
    pathEdit : ctkPathLineEdit

    Returns
    -------
    str
        With the home folder for "~"; empty if there is none.
    """
    typed = pathEdit.currentPath.strip()
    return os.path.abspath(os.path.expanduser(typed)) if typed else ""
