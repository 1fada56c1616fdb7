"""How tall tables are, and which rows of a form are there."""

from __future__ import annotations

LEAST_ROWS, MOST_ROWS = 2, 6


def tableHeight(rows, *, row, header, frame):
    """Height of a table that shows its rows, 2 to 6 of them; more are scrolled.

    Parameters
    ----------
    rows : int
        Number of rows.
    row, header, frame : int
        Height of one row, height of the header, and width of the frame, pixels.

    Returns
    -------
    int
        Pixels.
    """
    return header + min(max(rows, LEAST_ROWS), MOST_ROWS) * row + 2 * frame


def fitHeight(table):
    """Make a table as high as its rows.

    Parameters
    ----------
    table : QTableWidget
    """
    row, header = table.verticalHeader().defaultSectionSize, table.horizontalHeader().sizeHint.height()
    table.setFixedHeight(tableHeight(table.rowCount, row=row, header=header, frame=table.frameWidth))


def showRow(visible, *widgets):
    """Show or hide the label and the fields of a row.

    Parameters
    ----------
    visible : bool
    *widgets : QWidget
    """
    for widget in widgets:
        widget.visible = visible
