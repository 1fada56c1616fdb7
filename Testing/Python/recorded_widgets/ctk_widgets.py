"""Stand-ins of ctk's buttons, and of its line for a path."""

from __future__ import annotations

import re

from .value_types import QColor
from .widgets import Button, QWidget


class ctkCollapsibleButton(Button):
    """A section that hides what is in it while it is collapsed; it is checked while it is not."""

    _defaults = {"enabled": True, "visible": True, "checkable": True, "checked": True}

    def _get_collapsed(self):
        return not self._get("checked")

    def _set_collapsed(self, value):
        self._set("checked", not value)

    def _set_checked(self, value):
        if self._store("checked", value):
            self._emit("contentsCollapsed", not value)


class ctkColorPickerButton(Button):
    """A button that shows a colour."""

    _defaults = {"enabled": True, "visible": True, "displayColorName": True, "color": QColor()}
    _notify = {"checked": "toggled", "color": "colorChanged"}

    def _set_color(self, value):
        if not isinstance(value, QColor):
            msg = f"Property 'color' of ctkColorPickerButton does not accept {value!r}"
            raise AttributeError(msg)
        self._store("color", QColor(value))


class ctkPathLineEdit(QWidget):
    """Holds a path, and says so if it fits the name filters."""

    Dirs, Drives, Files, NoDotAndDotDot, AllEntries, Readable, Writable = 1, 2, 4, 24576, 7, 16, 32

    def _set_currentPath(self, value):
        if self._store("currentPath", value) and self._isAcceptable(value):
            self._emit("currentPathChanged", value)

    def _isAcceptable(self, path):
        endings = re.findall(r"\*(\.\w+)", " ".join(self._get("nameFilters") or ()))
        return path.endswith(tuple(endings)) if endings else bool(path)

    def addCurrentPathToHistory(self):
        """Kept by Slicer's settings only."""
