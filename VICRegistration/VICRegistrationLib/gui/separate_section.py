"""The section in which an organ is separated: seeds, grey levels, erosion, and the region as it changes."""

from __future__ import annotations

import logging
import math

import qt
import slicer
import vtk
from slicer.i18n import tr as _
from slicer.parameterNodeWrapper import FloatRange
from slicer.util import VTKObservationMixin

from ..mrml.organ_nodes import hasSegment, seedsOf, setRegionVisible
from ..mrml.parameters import RegionSource
from ..mrml.points import placedPoints, placingEvents
from ..mrml.separating import canBeSeparated, separateOrgan
from ..mrml.volumes import localPoints
from .binding import Binding, SegmentChoice
from .message_label import MessageLabel
from .widgets import showPlaceButtons, showRow, signalsBlocked

# Joins the changes of a slider that is dragged; too short to be noticed.
_DELAY_MS = 30


class SeparateSection(VTKObservationMixin):
    """Keeps the region up to date with everything it depends on.

    Parameters
    ----------
    ui : namespace of widgets
    onSeparated : callable
        Called without arguments after every attempt to separate.
    """

    def __init__(self, ui, onSeparated):
        VTKObservationMixin.__init__(self)
        self._ui, self._onSeparated = ui, onSeparated
        self._organ = self._volume = self._settings = self._range = None
        self._binding = Binding()
        self._timer = qt.QTimer()
        self._timer.setSingleShot(True)
        self._timer.setInterval(_DELAY_MS)
        self._timer.connect("timeout()", self.separate)
        self._message = MessageLabel(ui.regionStatusLabel)
        showPlaceButtons(ui.seedPlaceWidget)
        ui.seedPlaceWidget.placeMultipleMarkups = slicer.qSlicerMarkupsPlaceWidget.ForcePlaceSingleMarkup
        ui.thresholdRange.connect("valuesChanged(double,double)", self._thresholdMoved)
        ui.suggestButton.connect("clicked()", self._suggest)
        ui.previewCheck.connect("toggled(bool)", self._showRegion)
        self._segment = SegmentChoice(ui.segmentSelector, "inputSegmentation", "inputSegmentId")

    @property
    def isWaiting(self):
        """Whether the region is about to be separated again."""
        return bool(self._timer.isActive())

    def setOrgan(self, organ, volumeNode):
        """Show and follow an organ.

        Parameters
        ----------
        organ : OrganParameters or None
        volumeNode : vtkMRMLScalarVolumeNode or None
        """
        self._timer.stop()
        self.removeObservers()
        self._segment.show(None)
        self._binding.release()
        self._organ = self._volume = self._settings = self._range = None
        if organ is None or volumeNode is None:
            self._ui.seedPlaceWidget.setCurrentNode(None)
            self._message.show("")
            self.refresh()
            return
        self._organ, self._volume = organ, volumeNode
        self._settings = self._currentSettings()
        self._binding.bind(organ, self._mapping())
        seeds = seedsOf(organ, volumeNode)
        for event in placingEvents():
            self.addObserver(seeds, event, self._seedsChanged)
        self.addObserver(volumeNode, slicer.vtkMRMLVolumeNode.ImageDataModifiedEvent, self._voxelsChanged)
        self._ui.seedPlaceWidget.setCurrentNode(seeds)
        self._message.show("" if canBeSeparated(organ) else _("Click inside the organ to place a seed."))
        self.refresh()

    def placeSeed(self):
        """Let the next click into a slice place a seed."""
        self._ui.seedPlaceWidget.setPlaceModeEnabled(True)

    def refresh(self):
        """Show the organ's settings, and separate again if they have changed."""
        ui, organ = self._ui, self._organ
        ui.separateSection.enabled = organ is not None
        if organ is None:
            return
        ui.thresholdRange.enabled = ui.suggestButton.enabled = canBeSeparated(organ)
        ui.erosionSlider.enabled = not organ.erosionAutomatic
        ui.dilationSlider.enabled = not organ.dilationAutomatic
        self._showRows(organ.source is RegionSource.THRESHOLDS)
        self._showThreshold()
        self._segment.show(organ)
        self._showVisibility()
        settings = self._currentSettings()
        if settings != self._settings:
            self._settings = settings
            self.schedule()

    def _showRows(self, fromSeeds):
        """Show the rows that have an effect."""
        ui = self._ui
        showRow(not fromSeeds, ui.segmentLabel, ui.segmentSelector)
        showRow(fromSeeds, ui.seedLabel, ui.seedPlaceWidget, ui.thresholdLabel, ui.suggestButton, ui.thresholdRange)
        showRow(fromSeeds, ui.erosionLabel, ui.erosionSlider, ui.erosionAutomaticCheck)
        showRow(fromSeeds, ui.dilationLabel, ui.dilationSlider, ui.dilationAutomaticCheck)

    def schedule(self):
        """Separate soon, once for all changes within a short time, and show the region."""
        if self._organ is not None:
            self._ui.previewCheck.checked = True
            if not self._timer.isActive():
                self._timer.start()

    def separate(self):
        """Separate the organ now, and show its region with its volume, or an error."""
        organ, volumeNode = self._organ, self._volume
        if organ is None or organ.parameterNode.GetScene() is None or volumeNode.GetScene() is None:
            return
        try:
            region, warnings = separateOrgan(organ, volumeNode)
        except ValueError as error:
            self._message.show(str(error))
        except Exception:
            logging.exception("The separation failed")
            self._message.show(
                _("The separation failed because of an unexpected error. The log has it (Help > Report a Bug).")
            )
        else:
            volume = _("Region: {volume} ml").format(volume=f"{region.volume_ml:.1f}")
            self._message.show("\n".join([volume, *warnings]))
        self._onSeparated()

    def _mapping(self):
        ui = self._ui
        return {
            "source": ui.sourceCombo,
            "erosionMm": ui.erosionSlider,
            "erosionAutomatic": ui.erosionAutomaticCheck,
            "dilationMm": ui.dilationSlider,
            "dilationAutomatic": ui.dilationAutomaticCheck,
        }

    def _currentSettings(self):
        """Return the settings that the region depends on; None for those that the separation chooses itself."""
        organ = self._organ
        threshold = (organ.threshold.minimum, organ.threshold.maximum)
        return (
            organ.source,
            localPoints(self._volume, placedPoints(organ.seeds)).tobytes(),
            None if organ.thresholdAutomatic else threshold,
            None if organ.erosionAutomatic else organ.erosionMm,
            None if organ.dilationAutomatic else organ.dilationMm,
            organ.inputSegmentation.GetID() if organ.inputSegmentation is not None else "",
            organ.inputSegmentId,
        )

    def _seedsChanged(self, caller=None, event=None):
        # Also called when a point that is being placed enters or leaves a view; refresh then finds no change.
        self.refresh()

    def _voxelsChanged(self, caller=None, event=None):
        self.schedule()

    def _thresholdMoved(self, low, high):
        organ = self._organ
        if organ is None or (organ.threshold.minimum, organ.threshold.maximum) == (low, high):
            return
        with slicer.util.NodeModify(organ.parameterNode):
            organ.thresholdAutomatic = False
            organ.threshold = FloatRange(low, high)

    def _suggest(self):
        if self._organ is not None:
            self._organ.thresholdAutomatic = True

    def _showThreshold(self):
        """Show the threshold in a slider that covers the volume's grey levels; nothing is written to the parameter."""
        widget, threshold = self._ui.thresholdRange, self._organ.threshold
        low, high = _levels(self._volume)
        low, high = min(low, threshold.minimum), max(high, threshold.maximum)
        with signalsBlocked(widget):
            if self._range != (low, high):
                self._range = (low, high)
                # At least a thousand steps from end to end.
                widget.decimals = (
                    0 if _holdsWholeNumbers(self._volume) else max(0, 3 - math.floor(math.log10(high - low)))
                )
                # The range first: a step that is longer than the range is refused.
                widget.setRange(low, high)
                widget.singleStep = max(10.0**-widget.decimals, (high - low) / 1000.0)
            widget.setValues(threshold.minimum, threshold.maximum)

    def _showVisibility(self):
        check = self._ui.previewCheck
        display = self._regionDisplay()
        if display is None:
            return
        with signalsBlocked(check):
            check.checked = bool(display.GetSegmentVisibility(self._organ.regionSegmentId))

    def _showRegion(self, visible):
        if self._organ is not None:
            setRegionVisible(self._organ, visible)

    def _regionDisplay(self):
        """Display node of the region, or None if there is no region."""
        organ = self._organ
        return organ.regions.GetDisplayNode() if organ is not None and hasSegment(organ) else None


def _levels(volumeNode):
    """Lowest and highest finite grey level of a volume; VTK caches them until the voxels change."""
    data = volumeNode.GetImageData()
    scalars = data.GetPointData().GetScalars() if data is not None else None
    low, high = scalars.GetFiniteRange(0) if scalars is not None else (0.0, 1.0)
    if not low <= high:
        # There is no finite grey level.
        return 0.0, 1.0
    return (low, high) if high > low else (low, low + 1.0)


def _holdsWholeNumbers(volumeNode):
    data = volumeNode.GetImageData()
    return data is not None and data.GetScalarType() not in (vtk.VTK_FLOAT, vtk.VTK_DOUBLE)
