"""The section in which a surface is compared with a reference and coloured, and the table is copied."""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from ..mrml.colors import DEVIATION, STANDARD_DEVIATION, colorBy, coloredBy, hasScalars
from ..mrml.comparing import compareOrgan, comparisonText, patientOf, setPatient
from ..mrml.comparison_table import tableAsCsv
from ..mrml.organ_nodes import volumeOf
from ..mrml.parameters import ReferenceKind
from .binding import Binding, SegmentChoice
from .message_label import MessageLabel
from .widgets import showRow, signalsBlocked


def _colorings():
    return (
        ("", _("The organ's colour"), ""),
        (DEVIATION, _("Deviation from the reference"), _("Press Compare first.")),
        (
            STANDARD_DEVIATION,
            _("Confidence: standard deviation"),
            _("Fit the organ again; the fit computes it."),
        ),
    )


class CompareSection:
    """Compares the current organ with the chosen reference.

    Parameters
    ----------
    ui : namespace of widgets
    """

    def __init__(self, ui):
        self._ui = ui
        self._organ = self._volume = None
        self._binding, self._show = Binding(), MessageLabel(ui.compareStatusLabel).show
        self._segment = SegmentChoice(ui.referenceSegmentSelector, "referenceSegmentation", "referenceSegmentId")
        for name, text, _remedy in _colorings():
            ui.colorByCombo.addItem(text, name)
        ui.patientEdit.connect("textChanged(QString)", self._patientTyped)
        ui.compareButton.connect("clicked()", self._compare)
        ui.colorByCombo.connect("currentIndexChanged(int)", self._coloringChosen)
        ui.copyTableButton.connect("clicked()", self._copy)

    def setOrgan(self, organ, volumeNode):
        """Show and follow an organ.

        Parameters
        ----------
        organ : OrganParameters or None
        volumeNode : vtkMRMLScalarVolumeNode or None
        """
        ui = self._ui
        self._segment.show(None)
        self._binding.release()
        self._organ, self._volume = organ, volumeNode
        if organ is not None:
            self._binding.bind(
                organ, {"referenceKind": ui.referenceKindCombo, "referenceModel": ui.referenceModelSelector}
            )
        self.refresh(busy=False)

    def refresh(self, *, busy):
        """Show the reference, the colouring and the result of the last comparison.

        Parameters
        ----------
        busy : bool
            Whether a fit is under way.
        """
        ui, organ = self._ui, self._organ
        fitted = organ is not None and organ.surface is not None
        fromSegment = organ is not None and organ.referenceKind is ReferenceKind.SEGMENT
        ui.referenceKindCombo.enabled = organ is not None
        showRow(fromSegment, ui.referenceSegmentLabel, ui.referenceSegmentSelector)
        showRow(not fromSegment, ui.referenceModelLabel, ui.referenceModelSelector)
        ui.referenceModelSelector.enabled = organ is not None
        ui.patientEdit.enabled = self._patientVolume() is not None
        ui.compareButton.enabled = ui.colorByCombo.enabled = fitted and not busy
        self._segment.show(organ)
        self._showPatient()
        self._showColoring()
        if organ is not None and not fitted:
            self._show(_("The organ has no surface yet. Fit it, then compare."))
        else:
            self._show(comparisonText(organ) if fitted else "")

    def _patientVolume(self):
        return (volumeOf(self._organ) or self._volume) if self._organ is not None else None

    def _showPatient(self):
        edit, volumeNode = self._ui.patientEdit, self._patientVolume()
        edit.placeholderText = volumeNode.GetName() if volumeNode is not None else ""
        name = patientOf(volumeNode)
        name = name if name != edit.placeholderText else ""
        if edit.text.strip() == name:
            # The user is typing; a space at the end stays.
            return
        with signalsBlocked(edit):
            edit.text = name

    def _patientTyped(self, _text=None):
        if self._patientVolume() is not None:
            setPatient(self._patientVolume(), self._ui.patientEdit.text)

    def _showColoring(self):
        combo = self._ui.colorByCombo
        shown = coloredBy(self._organ.surface) if self._organ is not None else None
        with signalsBlocked(combo):
            combo.setCurrentIndex(max(combo.findData(shown or ""), 0))

    def _coloringChosen(self, index):
        if self._organ is None or self._organ.surface is None:
            return
        name, text, remedy = _colorings()[index]
        if name and not hasScalars(self._organ.surface, name):
            self._showColoring()
            self._show(_("{choice}: not available for this surface. {remedy}").format(choice=text, remedy=remedy))
            return
        colorBy(self._organ.surface, name or None)

    def _compare(self):
        organ, volumeNode = self._organ, self._patientVolume()
        try:
            with slicer.util.WaitCursor():
                compareOrgan(organ, volumeNode, *organ.reference())
        except ValueError as error:
            self._show(str(error))
            return
        self.refresh(busy=False)

    def _copy(self):
        try:
            text, count = tableAsCsv()
        except ValueError as error:
            self._show(str(error))
            return
        slicer.app.clipboard().setText(text)
        self._show(_("Copied {count} row(s) and the header of the table.").format(count=count))
