"""Stand-ins of QTableWidget, its items and its headers."""

from __future__ import annotations

from .base import Recorded
from .value_types import QSize
from .widgets import QWidget

SELECTABLE, EDITABLE, ENABLED = 1, 2, 32


class QTableWidgetItem(Recorded):
    """A cell: data by role, flags, and its place while it is in a table."""

    def __init__(self, *arguments):
        super().__init__()
        self._data, self._flags, self._table = {}, SELECTABLE | EDITABLE | ENABLED, None
        for argument in arguments:
            self._data[0 if isinstance(argument, str) else 1] = argument

    def text(self):
        return self._data.get(0, "")

    def setText(self, text):
        if not isinstance(text, str):
            msg = f"QTableWidgetItem.setText takes a str, not {text!r}"
            raise ValueError(msg)
        self.setData(0, text)

    def data(self, role):
        return self._data.get(0 if int(role) == 2 else int(role))

    def setData(self, role, value):
        role = 0 if int(role) == 2 else int(role)
        if self._data.get(role) != value:
            self._data[role] = value
            self._changed()

    def toolTip(self):
        return self._data.get(3, "")

    def setToolTip(self, text):
        self.setData(3, text)

    def flags(self):
        return self._flags

    def setFlags(self, flags):
        if int(flags) != self._flags:
            self._flags = int(flags)
            self._changed()

    def row(self):
        return self._place()[0]

    def column(self):
        return self._place()[1]

    def isSelected(self):
        return self._table is not None and self.row() in self._table._selected

    def _place(self):
        if self._table is None:
            return -1, -1
        return next(place for place, item in self._table._cells.items() if item is self)

    def _changed(self):
        if self._table is not None:
            self._table._itemChanged(self)


class QHeaderView(QWidget):
    """The names of rows or columns."""

    def _get_sizeHint(self):
        return QSize(24)


class QTableWidget(QWidget):
    """Rows and columns of items and widgets; ``_edit`` and ``_return`` are what a user does."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._rows = self._columns = 0
        self._cells, self._widgets = {}, {}
        self._selected, self._current, self._editor = set(), (-1, -1), None
        self._hidden = set()
        self._headers = {"h": QHeaderView(self), "v": QHeaderView(self)}

    def horizontalHeader(self):
        return self._headers["h"]

    def verticalHeader(self):
        return self._headers["v"]

    def item(self, row, column):
        return self._cells.get((row, column))

    def setItem(self, row, column, item):
        if not (0 <= row < self._rows and 0 <= column < self._columns):
            item._destroy()
            return
        self._drop(self._cells, (row, column))
        self._cells[row, column], item._table = item, self
        self._itemChanged(item)

    def cellWidget(self, row, column):
        return self._widgets.get((row, column))

    def setCellWidget(self, row, column, widget):
        self._drop(self._widgets, (row, column))
        self._widgets[row, column] = widget
        widget._adoptedBy(self)

    def currentRow(self):
        return self._current[0]

    def currentColumn(self):
        return self._current[1]

    def selectRow(self, row):
        if 0 <= row < self._rows:
            self._go(row, 0)

    def clearSelection(self):
        self._select(set())

    def setColumnHidden(self, column, hidden):
        (self._hidden.add if hidden else self._hidden.discard)(column)

    def isColumnHidden(self, column):
        return column in self._hidden

    def _edit(self, row, column, text):
        """Double click and type: only if the item may be edited."""
        item = self.item(row, column)
        if not (item.flags() & EDITABLE and item.flags() & ENABLED and self._get("enabled")):
            msg = f"A user cannot edit row {row}, column {column} of {self._get('objectName')}"
            raise AssertionError(msg)
        self._go(row, column)
        self._editor = [item, text]

    def _return(self):
        """Return ends what is being typed."""
        (item, text), self._editor = self._editor, None
        item.setText(text)

    def _get_rowCount(self):
        return self._rows

    def _set_rowCount(self, value):
        for held in (self._cells, self._widgets):
            for place in [place for place in held if place[0] >= value]:
                self._drop(held, place)
        self._rows = value
        if self._current[0] >= value:
            # Qt goes on to the last row that is left.
            self._current = (value - 1, self._current[1] if value else -1)
            self._select({value - 1} if self._selected and value else set())

    def _get_columnCount(self):
        return self._columns

    def _set_columnCount(self, value):
        self._columns = value

    def _drop(self, held, place):
        thing = held.pop(place, None)
        if thing is not None:
            thing._table = None
            thing._destroy()

    def _go(self, row, column):
        if self._editor is not None and (row, column) != self._current:
            # Qt takes what was typed so far when another cell becomes the current one.
            self._return()
        self._current = (row, column)
        self._select({row})

    def _select(self, rows):
        if rows != self._selected:
            self._selected = rows
            self._emit("itemSelectionChanged")

    def _itemChanged(self, item):
        if self._editor is not None and self._editor[0] is item:
            # Qt shows in the editor what the item holds now.
            self._editor[1] = item.text()
        self._emit("itemChanged", item)
