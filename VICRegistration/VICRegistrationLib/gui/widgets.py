"""What the sections do with the widgets of the panel: tables, rows of a form, buttons that place points."""

from __future__ import annotations

import contextlib

LEAST_ROWS, MOST_ROWS = 2, 6
# Rows of the list of further stacks that are seen at once.
STACK_ROWS = 3


def setUpTable(table, titles, *, wide):
    """Give a table its columns; nothing can be typed into its cells.

    Parameters
    ----------
    table : QTableWidget
    titles : list of str
    wide : int
        Column that takes what width is left; the others are as wide as their contents.
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
    """Height of a table that shows its rows; more than the most are scrolled.

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
    """Make a table as high as its rows.

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
    """Rows of organs that are seen at once: what one works with stays within 600 pixels, further stacks included.

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
    """Let a widget emit no signals meanwhile, so that what it is made to show is not taken for a choice of the user.

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
    """Show the buttons that place and delete points, and none of the others; points that are being placed are shown.

    Parameters
    ----------
    widget : qSlicerMarkupsPlaceWidget
    """
    widget.buttonsVisible = False
    widget.placeButton().show()
    widget.deleteButton().show()
    widget.connect("activeMarkupsPlaceModeChanged(bool)", lambda placing: placing and _show(widget.currentNode()))


def _show(node):
    # Slicer places points in a hidden list too, and nothing of them is seen.
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
