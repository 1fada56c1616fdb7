"""Stand-ins of the widgets that hold numbers: clamped to their range, told once; Qt's rounded to their decimals."""

from __future__ import annotations

from .widgets import QWidget

SHOWN = {"enabled": True, "visible": True}


class Numbered(QWidget, record=False):
    """What spin boxes and sliders share."""

    _notify = {"value": "valueChanged"}

    def _set_minimum(self, value):
        self._store("minimum", value)
        self._store("maximum", max(value, self._get("maximum")))
        self._set("value", self._get("value"))

    def _set_maximum(self, value):
        self._store("maximum", value)
        self._store("minimum", min(value, self._get("minimum")))
        self._set("value", self._get("value"))

    def _set_decimals(self, value):
        self._store("decimals", value)
        self._set("value", self._get("value"))

    def _set_value(self, value):
        value = min(max(value, self._get("minimum")), self._get("maximum"))
        self._store("value", value)


class QSpinBox(Numbered):
    """Whole numbers, 0 to 99 unless told otherwise."""

    _defaults = {**SHOWN, "maximum": 99, "singleStep": 1}


class QDoubleSpinBox(Numbered):
    """Real numbers, 0 to 99.99 unless told otherwise, with as many decimals as it shows."""

    _defaults = {**SHOWN, "maximum": 99.99, "singleStep": 1.0, "decimals": 2}

    def _set_value(self, value):
        super()._set_value(round(value, self._get("decimals")))


class ctkSliderWidget(Numbered):
    """Real numbers, with a slider and a spin box."""

    _defaults = {**SHOWN, "maximum": 99.0, "singleStep": 1.0, "decimals": 2, "tracking": True, "spinBoxVisible": True}


class ctkRangeWidget(QWidget):
    """Two numbers, the first not above the second; rounded where they are shown."""

    _defaults = {**SHOWN, "maximum": 99.0, "maximumValue": 99.0, "singleStep": 1.0, "decimals": 2, "tracking": True}

    def setRange(self, minimum, maximum):
        _checkNumbers(minimum, maximum)
        if self._values.get("minimum", 0.0) != minimum or self._values.get("maximum", 99.0) != maximum:
            self._values.update(minimum=float(minimum), maximum=float(maximum))
            self._emit("rangeChanged", minimum, maximum)
        self.setValues(self._get("minimumValue"), self._get("maximumValue"))

    def setValues(self, minimumValue, maximumValue):
        _checkNumbers(minimumValue, maximumValue)
        low, high = sorted((float(minimumValue), float(maximumValue)))
        ends = (self._get("minimum"), self._get("maximum"))
        low, high = (min(max(value, ends[0]), ends[1]) for value in (low, high))
        changed = {"minimumValue": low != self._get("minimumValue"), "maximumValue": high != self._get("maximumValue")}
        self._values.update(minimumValue=low, maximumValue=high)
        for name, value in (("minimumValue", low), ("maximumValue", high)):
            if changed[name]:
                self._emit(f"{name}Changed", value)
        if any(changed.values()):
            self._emit("valuesChanged", low, high)

    def _set_singleStep(self, value):
        # As ctk: what is longer than the range is refused.
        if value <= self._get("maximum") - self._get("minimum"):
            self._store("singleStep", value)

    def _set_minimum(self, value):
        self.setRange(value, max(value, self._get("maximum")))

    def _set_maximum(self, value):
        self.setRange(min(value, self._get("minimum")), value)

    def _set_minimumValue(self, value):
        # As ctk: the other end follows, which is why the order of properties in a .ui file counts.
        self.setValues(value, max(value, self._get("maximumValue")))

    def _set_maximumValue(self, value):
        self.setValues(min(value, self._get("minimumValue")), value)


def _checkNumbers(*values):
    if not all(isinstance(value, (int, float)) for value in values):
        msg = f"Could not find matching overload for given arguments: {values}"
        raise ValueError(msg)
