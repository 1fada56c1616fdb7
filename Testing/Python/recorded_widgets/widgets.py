"""Stand-ins of Qt's simple widgets and layouts."""

from __future__ import annotations

from .base import Recorded


class QWidget(Recorded):
    """Enabled unless it, or what it is in, was disabled."""

    _defaults = {"enabled": True, "visible": True}
    _box = None

    def layout(self):
        return self._box

    def setLayout(self, layout):
        self._box = layout
        layout._adoptedBy(self)
        layout._settle(self)

    def show(self):
        self._set("visible", True)

    def hide(self):
        self._set("visible", False)

    close = hide

    def isHidden(self):
        return not self._values.get("visible", isinstance(self._owner, QWidget))

    def _get_visible(self):
        msg = "without its main window Slicer shows no panel: everything is invisible; use isHidden()"
        raise NotImplementedError(msg)

    def _set_visible(self, value):
        self._values["visible"] = value

    def _get_enabled(self):
        owner = self._owner
        return self._values.get("enabled", True) and (not isinstance(owner, QWidget) or owner._get("enabled"))

    def _set_enabled(self, value):
        self._values["enabled"] = value

    _notify = {"objectName": "objectNameChanged", "windowTitle": "windowTitleChanged"}


class Layout(Recorded, record=False):
    """Holds widgets and layouts in order, and puts widgets into the widget it belongs to."""

    def __init__(self):
        super().__init__()
        self._entries = []

    def addWidget(self, widget, *place):
        self._add(widget)

    def count(self):
        return len(self._entries)

    def itemAt(self, index):
        return self._entries[index]

    def removeItem(self, item):
        self._entries.remove(item)

    def _add(self, entry):
        self._entries.append(entry)
        widget = self._widget()
        if isinstance(entry, Layout):
            entry._adoptedBy(self)
        if widget is not None:
            self._settle(widget)

    def _widget(self):
        owner = self._owner
        return owner._widget() if isinstance(owner, Layout) else owner

    def _settle(self, widget):
        for entry in self._entries:
            if isinstance(entry, Layout):
                entry._settle(widget)
            elif isinstance(entry, QWidget) and entry._owner is not widget:
                entry._adoptedBy(widget)


class QVBoxLayout(Layout):
    """One below the other."""


class QHBoxLayout(Layout):
    """One beside the other."""


class QFormLayout(Layout):
    """Labels and fields."""


class QLabel(QWidget):
    """Text."""


class QLineEdit(QWidget):
    """Text that can be typed."""

    _notify = {"text": "textChanged"}


class Button(QWidget, record=False):
    """What all buttons share: text, and being on or off."""

    _notify = {"checked": "toggled"}

    def click(self):
        """What a user's click does: nothing on a button that is disabled."""
        if self._get("enabled"):
            self._emit("pressed")
            if self._get("checkable"):
                self._set("checked", not self._get("checked"))
            self._emit("released")
            self._emit("clicked", self._get("checked"))

    def _set_checked(self, value):
        if self._get("checkable"):
            self._store("checked", value)


class QPushButton(Button):
    """A button."""


class QToolButton(Button):
    """A small button."""


class QCheckBox(Button):
    """A check box."""

    _defaults = {"enabled": True, "visible": True, "checkable": True}

    def checkState(self):
        return 2 * self._get("checked")

    def _set_checked(self, value):
        if self._store("checked", value):
            self._emit("stateChanged", self.checkState())


class QComboBox(QWidget):
    """Items of which one is current."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._items, self._index = [], -1

    def addItem(self, *item):
        """Add an item: a text, or an icon and a text, and perhaps data."""
        text, *data = item if isinstance(item[0], str) else item[1:]
        self._items.append([text, data[0] if data else None])
        if self._index < 0:
            self._goTo(0)

    def clear(self):
        self._items.clear()
        self._goTo(-1)

    def itemText(self, index):
        return self._items[index][0] if 0 <= index < len(self._items) else ""

    def itemData(self, index, role=256):
        return self._items[index][1] if 0 <= index < len(self._items) else None

    def findText(self, text):
        return next((index for index, item in enumerate(self._items) if item[0] == text), -1)

    def findData(self, data):
        return next((index for index, item in enumerate(self._items) if item[1] == data), -1)

    def _goTo(self, index):
        index = index if -1 <= index < len(self._items) else -1
        if index != self._index:
            self._index = index
            self._emit("currentIndexChanged", index, QString=self.itemText(index))
            self._emit("currentTextChanged", self.itemText(index))

    def _get_count(self):
        return len(self._items)

    def _get_currentIndex(self):
        return self._index

    def _set_currentIndex(self, value):
        self._goTo(value)

    def _get_currentText(self):
        return self.itemText(self._index)

    def _set_currentText(self, value):
        if self.findText(value) >= 0:
            self._goTo(self.findText(value))


class QProgressBar(QWidget):
    """How far something has come; a value out of its range is ignored."""

    _defaults = {"enabled": True, "visible": True, "maximum": 100, "value": -1, "textVisible": True}
    _notify = {"value": "valueChanged"}

    def _set_value(self, value):
        low, high = self._get("minimum"), self._get("maximum")
        if low <= value <= high or (low, high) == (0, 0):
            self._store("value", value)
