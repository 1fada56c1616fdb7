"""Stand-in of ctk's line for a path."""

from __future__ import annotations

import re

from .widgets import QWidget


class ctkPathLineEdit(QWidget):
    """Holds a path, and says so if it fits the name filters; its history is kept by the setting key in Slicer only."""

    Dirs, Drives, Files, NoDotAndDotDot, AllEntries, Readable, Writable = 1, 2, 4, 24576, 7, 16, 32

    def _set_currentPath(self, value):
        if self._store("currentPath", value) and self._isAcceptable(value):
            self._emit("currentPathChanged", value)

    def _isAcceptable(self, path):
        endings = re.findall(r"\*(\.\w+)", " ".join(self._get("nameFilters") or ()))
        return path.endswith(tuple(endings)) if endings else bool(path)

    def addCurrentPathToHistory(self):
        if not self._get("settingKey"):
            return
        self._dynamic.setdefault("history", []).append(self._get("currentPath"))
