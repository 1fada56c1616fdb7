"""The section in which a user corrects a surface: boundary points on the true wall, and a fit through them."""

from __future__ import annotations

import qt
import slicer
from slicer.i18n import tr as _
from slicer.util import VTKObservationMixin

from ..mrml.fitting import boundaryDeviations
from ..mrml.organ_nodes import boundaryPointsOf, volumeOf
from ..mrml.points import placedPoints, placingEvents, removeLastPoint
from .binding import Binding
from .widgets import fitHeight, setUpTable, showPlaceButtons


class CorrectSection(VTKObservationMixin):
    """Lists the boundary points with their distances from the surface.

    Parameters
    ----------
    ui : namespace of widgets
    onRefit : callable
        Called without arguments when "Refit" is pressed.
    onPoints : callable
        Called without arguments when points have been placed, moved or removed.
    """

    def __init__(self, ui, onRefit, onPoints):
        VTKObservationMixin.__init__(self)
        self._ui, self._onPoints = ui, onPoints
        self._organ, self._volume, self._binding = None, None, Binding()
        setUpTable(ui.boundaryTable, [_("Point (R, A, S; mm)"), _("Off (mm)")], wide=0)
        showPlaceButtons(ui.boundaryPlaceWidget)
        ui.boundaryPlaceWidget.placeMultipleMarkups = slicer.qSlicerMarkupsPlaceWidget.ForcePlaceMultipleMarkups
        ui.undoPointButton.connect("clicked()", self._removeLast)
        ui.refitButton.connect("clicked()", onRefit)

    def setOrgan(self, organ, volumeNode):
        """Show and follow the boundary points of an organ.

        Parameters
        ----------
        organ : OrganParameters or None
        volumeNode : vtkMRMLScalarVolumeNode or None
        """
        self.removeObservers()
        self._binding.release()
        self._organ = self._volume = points = None
        if organ is not None and volumeNode is not None:
            self._organ, self._volume = organ, volumeNode
            self._binding.bind(organ, {"boundaryWeight": self._ui.boundaryWeightSlider})
            points = boundaryPointsOf(organ, volumeOf(organ) or volumeNode)
            for event in placingEvents():
                self.addObserver(points, event, self._pointsChanged)
        self._ui.boundaryPlaceWidget.setCurrentNode(points)
        self.refresh(busy=False)

    def refresh(self, *, busy):
        """List the points, and enable what can be pressed.

        Parameters
        ----------
        busy : bool
            Whether a fit is under way.
        """
        ui, organ = self._ui, self._organ
        fitted = organ is not None and organ.surface is not None
        ui.correctSection.enabled = fitted
        ui.refitButton.enabled = fitted and not busy
        positions = placedPoints(organ.boundaryPoints) if organ is not None else []
        ui.undoPointButton.enabled = len(positions) > 0
        if busy:
            return
        ui.correctStatusLabel.text = ""
        deviations = self._deviations() if fitted else []
        ui.boundaryTable.setRowCount(len(positions))
        for row, position in enumerate(positions):
            deviation = f"{deviations[row]:+.2f}" if row < len(deviations) else ""
            for column, text in enumerate(("{:.1f}, {:.1f}, {:.1f}".format(*position), deviation)):
                ui.boundaryTable.setItem(row, column, qt.QTableWidgetItem(text))
        fitHeight(ui.boundaryTable)

    def _deviations(self):
        try:
            found = boundaryDeviations(self._organ, volumeOf(self._organ) or self._volume)
        except ValueError as error:
            self._ui.correctStatusLabel.text = str(error)
            return []
        if len(found):
            self._ui.correctStatusLabel.text = _("The surface is up to {distance} mm from the points.").format(
                distance=f"{max(abs(found)):.1f}"
            )
        return found

    def _pointsChanged(self, caller=None, event=None):
        self._onPoints()

    def _removeLast(self):
        if self._organ is not None and self._organ.boundaryPoints is not None:
            removeLastPoint(self._organ.boundaryPoints)
