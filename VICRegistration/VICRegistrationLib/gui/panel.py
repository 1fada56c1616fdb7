"""The panel: brings its sections, the scene and the logic together."""

from __future__ import annotations

import qt
import slicer
import vtk
from slicer.util import VTKObservationMixin

from ..mrml.fitting import updateVolume
from ..mrml.generic_model_nodes import followVolumeWithModel
from ..mrml.organ_nodes import followVolume, volumeOf
from ..mrml.organs import Organs
from ..mrml.parameters import OrganState
from ..mrml.separating import canBeSeparated
from ..mrml.stack_contours import followStacks
from ..mrml.volumes import greyVolumes, showInSlices, shownVolumes
from .advanced_section import AdvancedSection
from .binding import AFTER_WRAPPERS, Binding
from .compare_section import CompareSection
from .correct_section import CorrectSection
from .export_section import ExportSection
from .fit_section import FitSection
from .model_section import ModelSection
from .organs_table import OrgansTable
from .separate_section import SeparateSection
from .stacks_section import StacksSection
from .widgets import stopPlacing

_FIT_AT_ONCE = "VICRegistration/FitAtOnce"


class Panel(VTKObservationMixin):
    """Shows the organs of the scene while it is open, and does what is clicked.

    Parameters
    ----------
    ui : namespace of widgets
        Of VICRegistration.ui.
    logic : VICRegistrationLogic
    """

    def __init__(self, ui, logic):
        VTKObservationMixin.__init__(self)
        self.ui, self.logic = ui, logic
        self.parameters = self.organs = None
        self._volume, self._organ, self._volumeBinding = None, None, Binding()
        # ID of the volume that was chosen here, until the user chooses one or adds an organ.
        self._proposed = None
        # Parameter nodes of new organs that are fitted as soon as they have a region.
        self._toFit = []
        self.table = OrgansTable(ui, self.addOrgan, self.removeOrgan, self.chooseOrgan)
        self.stacksSection = StacksSection(ui, self.refresh, self._volumeCame, self._volumeMoved)
        self.separateSection = SeparateSection(ui, self._progressed)
        self.fitSection = FitSection(ui, self.fitOrgan, self.fitAll, self._progressed)
        self.correctSection = CorrectSection(ui, self.refit, self.refresh)
        self.exportSection = ExportSection(ui)
        self.compareSection = CompareSection(ui)
        self.modelSection = ModelSection(ui, self._progressed)
        ui.cancelButton.connect("clicked()", self._takeReady)
        ui.volumeSelector.connect("nodeActivated(vtkMRMLNode*)", self.showVolume)
        self.advancedSection = AdvancedSection(ui)
        # Slicer's settings file holds text.
        ui.fitAtOnceCheck.checked = qt.QSettings().value(_FIT_AT_ONCE) == "true"
        ui.fitAtOnceCheck.connect("toggled(bool)", self._fitAtOnceChosen)

    @property
    def isOpen(self):
        """Whether the panel follows the scene."""
        return self.parameters is not None

    def open(self):
        """Show what the scene holds, and follow it."""
        self.close()
        self.parameters = self.logic.getParameterNode()
        self.organs = Organs(self.parameters)
        self.organs.adopt()
        self._volumeCame()
        self._volumeBinding.bind(self.parameters, {"volume": self.ui.volumeSelector})
        self.modelSection.setModule(self.parameters.parameterNode)
        self._follow(self.parameters.parameterNode, self._parametersChanged)
        self.stacksSection.open(self.organs)
        scene = slicer.mrmlScene
        # Called before the selectors, which would choose another node of their list.
        self.addObserver(scene, scene.NodeAboutToBeRemovedEvent, self._nodeGoes, priority=1.0)
        self._showOrgan()

    def close(self):
        """Follow nothing any more; a fit under way goes on."""
        if not self.isOpen:
            return
        self._stopPlacing()
        self.modelSection.setModule(None)
        self._volumeBinding.release()
        # All at once: after removing observers one by one, the mixin keeps the nodes, with their voxels, in memory.
        self.removeObservers()
        self._organ = self._volume = None
        for section in (self.separateSection, self.correctSection, self.compareSection):
            section.setOrgan(None, None)
        self.advancedSection.setOrgan(None)
        self.stacksSection.close()
        self.table.show(None)
        self.parameters = self.organs = None
        self.fitSection.refresh(ready=False)
        self.exportSection.show([], None)
        self.ui.addOrganButton.enabled = False

    def stop(self):
        """End fits and meshing, and follow nothing any more."""
        # A scene that is loaded has the user's choice.
        self._toFit, self._proposed = [], None
        self.fitSection.stop()
        self.exportSection.stop()
        self.modelSection.stop()
        self.stacksSection.stop()
        self.close()

    def addOrgan(self, name):
        """Add an organ; the next click into a slice is its seed."""
        organ, self._proposed = self.organs.add(name), None
        if self.ui.fitAtOnceCheck.checked:
            self._toFit.append(organ.parameterNode)
        self.separateSection.placeSeed()

    def removeOrgan(self):
        """Remove the current organ and what belongs to it."""
        self.organs.remove(self._organ)

    def showVolume(self, node):
        """Show a volume in the slice views when the user has chosen it; no other one is chosen later."""
        self._proposed = None
        if node is not None:
            showInSlices(node)

    def chooseOrgan(self, node):
        """Make an organ the current one."""
        self.parameters.current = node

    def fitOrgan(self):
        """Fit the current organ."""
        self._fit([self._organ])

    def fitAll(self):
        """Fit all organs that can be separated."""
        self._fit([organ for organ in self.organs if canBeSeparated(organ)] or [self._organ])

    def refit(self):
        """Fit the current organ again, through its boundary points."""
        self._stopPlacing()
        # In the volume that the surface was fitted in, whichever is chosen now.
        self.fitSection.refit(self._organ, volumeOf(self._organ) or self._volume)

    def refresh(self):
        """Show the current state of everything."""
        if self.organs is None:
            return
        self.stacksSection.refresh(self._volume, self._organ)
        self.table.leaveRoom(self.stacksSection.rows)
        self.table.show(self.organs)
        busy = self.fitSection.running or self.modelSection.running
        ready = self._organ is not None and self._volume is not None
        self.separateSection.refresh()
        self.fitSection.refresh(ready=ready and not self.modelSection.running)
        self.correctSection.refresh(busy=busy)
        self.exportSection.show(list(self.organs), self._organ)
        self.compareSection.refresh(busy=busy)
        self.modelSection.refresh(list(self.organs), self._volume, busy=self.fitSection.running)
        self.advancedSection.refresh()
        self.ui.addOrganButton.enabled = self._volume is not None

    def _fit(self, organs):
        self._stopPlacing()
        self.fitSection.fit(organs, self._volume, self.stacksSection.chosen())

    def _stopPlacing(self):
        """Leave the mode in which clicks place points of the current organ; modes of other modules stay."""
        for widget in (self.ui.seedPlaceWidget, self.ui.boundaryPlaceWidget):
            stopPlacing(widget)

    def _progressed(self):
        """Show that a region was found, or that a fit has begun or ended; then fit new organs that have waited for it.

        Those are fitted that have a region and are to be fitted at once, after a fit that is under way.
        """
        self.refresh()
        if self.organs is None or self.fitSection.running or self.modelSection.running:
            return
        ready = self._takeReady()
        if ready:
            # The next organ's seed may be about to be placed: that goes on.
            self.fitSection.fit(ready, self._volume, self.stacksSection.chosen())

    def _takeReady(self):
        """Take the organs that have a region from the new organs that wait for their fit; Cancel takes them too."""
        ready = [organ for organ in self.organs or () if organ.parameterNode in self._toFit and self._isReady(organ)]
        self._toFit = [node for node in self._toFit if node not in [organ.parameterNode for organ in ready]]
        return ready

    def _isReady(self, organ):
        """Whether a new organ has its region, or can get it by its fit because the user went on to another organ."""
        return organ.state is OrganState.SEPARATED or (organ is not self._organ and canBeSeparated(organ))

    def _fitAtOnceChosen(self, chosen):
        qt.QSettings().setValue(_FIT_AT_ONCE, "true" if chosen else "false")

    def _showOrgan(self):
        """Let every section follow the current organ."""
        organ, volume = self.organs.current(), self.parameters.volume
        if organ is not self._organ or volume is not self._volume:
            # Clicks would still place points of the organ before.
            self._stopPlacing()
        # Nodes that the organ lacks are made before its changes are followed.
        self._followOrgan(None, None)
        self.separateSection.setOrgan(organ, volume)
        self.correctSection.setOrgan(organ, volume)
        self.compareSection.setOrgan(organ, volume)
        self.advancedSection.setOrgan(organ)
        self.fitSection.setOrgan(organ, volume)
        self._followOrgan(organ, volume)
        self.refresh()

    def _followOrgan(self, organ, volume):
        if self._organ is not None:
            self.removeObserver(self._organ.parameterNode, vtk.vtkCommand.ModifiedEvent, self._organChanged)
        self._organ, self._volume = organ, volume
        if organ is not None:
            self._follow(organ.parameterNode, self._organChanged)

    def _follow(self, parameterNode, changed):
        self.addObserver(parameterNode, vtk.vtkCommand.ModifiedEvent, changed, priority=AFTER_WRAPPERS)

    def _parametersChanged(self, caller=None, event=None):
        if self.organs.current() is not self._organ or self.parameters.volume is not self._volume:
            self._showOrgan()
        else:
            self.refresh()

    def _organChanged(self, caller=None, event=None):
        organ = self._organ
        if self._volume is not None and (organ.seeds is None or organ.boundaryPoints is None):
            # The user has deleted them; clicks then place points in new lists.
            self._stopPlacing()
            self._showOrgan()
        else:
            self.refresh()

    @vtk.calldata_type(vtk.VTK_OBJECT)
    def _nodeGoes(self, caller, event, node):
        """Clear the choice of a node that is about to be removed; the selectors would choose another one."""
        if slicer.mrmlScene.IsClosing():
            return
        if self.parameters.volume is node:
            self.parameters.volume = None
        self.modelSection.forget(node)
        for name in ("inputSegmentation", "referenceSegmentation", "referenceModel"):
            if self._organ is not None and getattr(self._organ, name) is node:
                setattr(self._organ, name, None)

    def _volumeCame(self):
        """Choose the volume that the slice views show, or the first one, until the user chooses or adds an organ."""
        if self.parameters is None or len(self.organs):
            return
        volume, shown = self.parameters.volume, shownVolumes()
        isOutdated = volume is not None and volume.GetID() == self._proposed and shown and volume not in shown
        if volume is None or isOutdated:
            volume = next(iter(shown or greyVolumes()), None)
            self._proposed = volume.GetID() if volume is not None else None
            self.parameters.volume = volume

    def _volumeMoved(self, volume):
        """Move organs and models with their volume."""
        for organ in self.organs:
            followVolume(organ, volume)
            if (volumeOf(organ) or self._volume) is volume:
                updateVolume(organ)
            followStacks(organ)
        followVolumeWithModel(volume)
        self.refresh()
