"""Stand-in of ctk's line for a path."""

from __future__ import annotations

from .widgets import QWidget


class ctkPathLineEdit(QWidget):
    """Holds a path; its history is kept by the setting key in Slicer, and not here."""

    Dirs, Drives, Files, NoDotAndDotDot, AllEntries, Readable, Writable = 1, 2, 4, 24576, 7, 16, 32
    _notify = {"currentPath": "currentPathChanged"}

    def addCurrentPathToHistory(self):
        if not self._get("settingKey"):
            return
        self._dynamic.setdefault("history", []).append(self._get("currentPath"))
