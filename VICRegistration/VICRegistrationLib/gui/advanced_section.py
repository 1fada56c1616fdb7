"""The collapsed section of advanced settings: net, profile, solver, stop rules."""

from __future__ import annotations

from ..mrml.parameters import Levels
from ..mrml.sentences import translated
from ..registration import options as table
from ..registration.options import FitOptions
from .binding import Binding
from .option_texts import WIDGETS, optionTexts
from .widgets import showRow


class AdvancedSection:
    """Settings of the fit; "As published" and "Defaults" set all of them at once.

    Parameters
    ----------
    ui : namespace of widgets
    """

    def __init__(self, ui):
        self._ui = ui
        self._organ, self._binding = None, Binding()
        labels, toolTips = optionTexts(lambda text: translated(text, table))
        for name, text in labels.items():
            getattr(ui, name).text = text
        for name, text in toolTips.items():
            getattr(ui, name).toolTip = text
        ui.asPublishedButton.connect("clicked()", self._setAsPublished)
        ui.defaultsButton.connect("clicked()", self._setDefaults)

    def setOrgan(self, organ):
        """Show the settings of an organ.

        Parameters
        ----------
        organ : OrganParameters or None
        """
        self._binding.release()
        self._organ = organ
        if organ is not None:
            self._binding.bind(organ, {parameter: getattr(self._ui, widget) for _name, parameter, widget in WIDGETS})
        self.refresh()

    def refresh(self):
        """Enable and show the widgets that have an effect."""
        ui, organ = self._ui, self._organ
        ui.advancedSection.enabled = organ is not None
        if organ is None:
            return
        for spin in (ui.netRowsSpin, ui.netColumnsSpin):
            spin.enabled = not organ.netAutomatic
        ui.tauSlider.enabled = not organ.tauAutomatic
        ui.smoothnessSlider.enabled = not organ.smoothnessAutomatic
        showRow(organ.levels is Levels.GIVEN, ui.givenLevelsLabel, ui.insideSpin, ui.outsideSpin)

    def _setAsPublished(self):
        if self._organ is not None:
            self._organ.setFitOptions(FitOptions.as_published())

    def _setDefaults(self):
        if self._organ is not None:
            self._organ.setFitOptions(FitOptions())
