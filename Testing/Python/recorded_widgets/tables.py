"""Stand-ins of QTableWidget, its items and its headers."""

from __future__ import annotations

from . import enums
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

    def icon(self):
        return self._data.get(1)

    def setIcon(self, icon):
        self.setData(1, icon)

    def flags(self):
        return self._flags

    def setFlags(self, flags):
        if int(flags) != self._flags:
            self._flags = int(flags)
            self._changed()

    def tableWidget(self):
        return self._table

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

    def _construct(self, argument):
        if not isinstance(argument, enums.Named):
            super()._construct(argument)

    def _get_sizeHint(self):
        return QSize(100, 24)


class QTableWidget(QWidget):
    """Rows and columns of items and widgets; ``_click``, ``_edit`` and ``_rename`` are what a user does."""

    def __init__(self, *arguments):
        super().__init__(*[a for a in arguments if not isinstance(a, int)])
        self._rows, self._columns = ([a for a in arguments if isinstance(a, int)] + [0, 0])[:2]
        self._cells, self._widgets, self._titles = {}, {}, {}
        self._selected, self._current, self._editor = set(), (-1, -1), None
        self._hidden = set()
        self._headers = {"h": QHeaderView(self), "v": QHeaderView(self)}

    def horizontalHeader(self):
        return self._headers["h"]

    def verticalHeader(self):
        return self._headers["v"]

    def setHorizontalHeaderLabels(self, labels):
        for column, label in enumerate(labels):
            self._titles[column] = QTableWidgetItem(label)

    def horizontalHeaderItem(self, column):
        return self._titles.get(column)

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

    def currentItem(self):
        return self.item(*self._current)

    def setCurrentCell(self, row, column, *command):
        self._go(row, column, select=True)

    def selectRow(self, row):
        if 0 <= row < self._rows:
            self._go(row, 0, select=True)

    def clearSelection(self):
        self._select(set())

    def selectedItems(self):
        return [item for (row, _), item in sorted(self._cells.items()) if row in self._selected]

    def insertRow(self, row):
        self._shift(row, 1)

    def removeRow(self, row):
        if 0 <= row < self._rows:
            self._shift(row, -1)

    def setColumnHidden(self, column, hidden):
        (self._hidden.add if hidden else self._hidden.discard)(column)

    def isColumnHidden(self, column):
        return column in self._hidden

    def resizeColumnsToContents(self):
        """Looks only."""

    def _click(self, row, column=0):
        """A click selects the row."""
        self._go(row, column, select=True)
        self._emit("cellClicked", row, column)

    def _edit(self, row, column, text):
        """Double click and type: only if the item may be edited."""
        item = self.item(row, column)
        if not (item.flags() & EDITABLE and item.flags() & ENABLED and self._get("enabled")):
            msg = f"A user cannot edit row {row}, column {column} of {self._get('objectName')}"
            raise AssertionError(msg)
        self._go(row, column, select=True)
        self._editor = [item, text]

    def _return(self):
        """Return ends what is being typed."""
        (item, text), self._editor = self._editor, None
        item.setText(text)

    def _rename(self, row, column, text):
        """Double click, type, Return."""
        self._edit(row, column, text)
        self._return()

    def _get_rowCount(self):
        return self._rows

    def _set_rowCount(self, value):
        while self._rows > value:
            self.removeRow(self._rows - 1)
        self._rows = value

    def _get_columnCount(self):
        return self._columns

    def _set_columnCount(self, value):
        self._columns = value
        for held in (self._cells, self._widgets):
            for place in [place for place in held if place[1] >= value]:
                self._drop(held, place)

    def _shift(self, row, by):
        """Insert or remove a row; those below move."""
        for held in (self._cells, self._widgets):
            if by < 0:
                for place in [place for place in held if place[0] == row]:
                    self._drop(held, place)
            moved = {(r + by if r >= row else r, c): thing for (r, c), thing in held.items()}
            held.clear()
            held.update(moved)
        self._rows += by
        if by < 0 and self._current[0] >= row:
            # Qt goes on to the row that is there now, or to the last one.
            left = min(self._current[0] - (self._current[0] > row), self._rows - 1)
            self._current = (left, self._current[1] if left >= 0 else -1)
            self._select({left} if self._selected and left >= 0 else set())

    def _drop(self, held, place):
        thing = held.pop(place, None)
        if thing is not None:
            thing._table = None
            thing._destroy()

    def _go(self, row, column, *, select):
        if self._editor is not None and (row, column) != self._current:
            # Qt takes what was typed so far when another cell becomes the current one.
            self._return()
        old, self._current = self._current, (row, column)
        if old != self._current:
            self._emit("currentCellChanged", row, column, *old)
            self._emit("currentItemChanged", self.item(row, column), self.item(*old))
        if select:
            self._select({row} if row >= 0 else set())

    def _select(self, rows):
        if rows != self._selected:
            self._selected = rows
            self._emit("itemSelectionChanged")

    def _itemChanged(self, item):
        if self._editor is not None and self._editor[0] is item:
            # Qt shows in the editor what the item holds now.
            self._editor[1] = item.text()
        self._emit("itemChanged", item)
        self._emit("cellChanged", item.row(), item.column())
