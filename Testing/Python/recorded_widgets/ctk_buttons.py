"""Stand-ins of ctk's buttons."""

from __future__ import annotations

from .value_types import QColor
from .widgets import Button


class ctkCollapsibleButton(Button):
    """A section that hides what is in it while it is collapsed; it is checked while it is not."""

    _defaults = {"enabled": True, "visible": True, "checkable": True, "checked": True}

    def _folded(self):
        return self._get("collapsed")

    def _get_collapsed(self):
        return not self._get("checked")

    def _set_collapsed(self, value):
        self._set("checked", not value)

    def _set_checked(self, value):
        if self._store("checked", value):
            self._emit("contentsCollapsed", not value)


class ctkColorPickerButton(Button):
    """A button that shows a colour; ``_choose`` is what a user does."""

    _defaults = {"enabled": True, "visible": True, "displayColorName": True, "color": QColor(0, 0, 0)}
    _notify = {"checked": "toggled", "color": "colorChanged"}

    def _set_color(self, value):
        if not isinstance(value, QColor):
            msg = f"Property 'color' of ctkColorPickerButton does not accept {value!r}"
            raise AttributeError(msg)
        self._store("color", QColor(value))

    def _choose(self, color):
        self._set("color", color)
