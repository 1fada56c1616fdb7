"""The section of the generic model: its choice, organs, landmarks on bone, fit, colours and files."""

from __future__ import annotations

import ctk
import qt
import slicer
from slicer.i18n import tr as _
from slicer.util import VTKObservationMixin

from ..mrml.generic_model import (
    GenericModelParameters,
    createLandmarks,
    landmarksText,
    modelNamed,
    nextLandmark,
    pairedOrgans,
    pairOrgan,
    skipLandmark,
)
from ..mrml.generic_model_export import exportModel, modelMeshArguments
from ..mrml.generic_model_fit import modelSteps
from ..mrml.generic_model_nodes import colorByPatch, findModel, isColoredByPatch, messageOf
from ..mrml.points import placingEvents
from ..multipatch.library import MODELS
from .binding import Binding
from .fit_section import focusOnce
from .mesher import Mesher, meshFormats
from .message_label import MessageLabel
from .runner import StepRunner
from .widgets import fitHeight, folderIn, setUpTable, showPlaceButtons, showRow, signalsBlocked, stopPlacing

_ORGAN, _IN_TABLE = range(2)
# The mesh, its elements and their quality; the lines after those are about single groups.
_LINES_OF_MESH = 3
# Data of the entry for a model in a file.
_FILE = ""


def _modelTexts():
    texts = {"pelvis": _("Pelvis"), "pelvis-fine": _("Pelvis, fine")}
    return [(name, texts.get(name, name)) for name in MODELS] + [(_FILE, _("From a file"))]


class ModelSection(VTKObservationMixin):
    """Fits a generic model to the organs of the table while the panel stays responsive.

    Parameters
    ----------
    ui : namespace of widgets
    onChanged : callable
        Called without arguments when a fit has begun or ended.
    """

    def __init__(self, ui, onChanged):
        VTKObservationMixin.__init__(self)
        self._ui, self._onChanged = ui, onChanged
        self._parameters = self._volume = self._runner = None
        self._organs, self._rows, self._landmarks = [], None, None
        self._binding, self._fittedVolume = Binding(), None
        self._show = MessageLabel(ui.modelStatusLabel).show
        self._written, self._mesher = "", Mesher(self._showMeshText, onChanged)
        self._setUpWidgets()
        ui.modelSection.connect("contentsCollapsed(bool)", self._expanded)
        ui.genericModelCombo.connect("currentIndexChanged(int)", self._modelChosen)
        ui.modelFileEdit.connect("currentPathChanged(QString)", self._fileChosen)
        ui.newLandmarksButton.connect("clicked()", self._createLandmarks)
        ui.skipLandmarkButton.connect("clicked()", self._skipLandmark)
        ui.fitModelButton.connect("clicked()", self._fit)
        ui.cancelModelButton.connect("clicked()", self.cancel)
        ui.patchColorCheck.connect("toggled(bool)", self._colorChosen)
        ui.modelMeshCombo.connect("currentIndexChanged(int)", self._meshChosen)
        ui.exportModelButton.connect("clicked()", self._export)

    @property
    def running(self):
        """Whether a model is being fitted."""
        return self._runner is not None

    def setModule(self, parameterNode):
        """Show and follow the choices stored in the module's parameter node.

        Parameters
        ----------
        parameterNode : vtkMRMLScriptedModuleNode or None
            None: nothing is followed.
        """
        self.stopPlacing()
        self.removeObservers()
        self._binding.release()
        self._parameters = self._landmarks = self._rows = None
        if parameterNode is not None:
            self._parameters = GenericModelParameters(parameterNode)
            self._binding.bind(self._parameters, {"modelLandmarks": self._ui.modelLandmarksSelector})
        else:
            self._ui.landmarkPlaceWidget.setCurrentNode(None)
            self.refresh([], None, busy=False)

    def forget(self, node):
        """Choose no landmarks in place of a list that is about to be removed.

        Parameters
        ----------
        node : vtkMRMLNode
        """
        if self._parameters is not None and self._parameters.modelLandmarks is node:
            self._parameters.modelLandmarks = None

    def stopPlacing(self):
        """Leave the mode in which clicks place landmarks; the mode of somebody else stays."""
        stopPlacing(self._ui.landmarkPlaceWidget)

    def cancel(self):
        """End before the next step, and keep an earlier result; stop the mesher, which leaves no file."""
        if self._runner is not None:
            self._runner.cancel()
        self._mesher.stop()

    def stop(self):
        """End now, because the scene or the panel is closed."""
        if self._runner is not None:
            self._runner.stop()
        self._mesher.stop()

    def refresh(self, organs, volumeNode, *, busy):
        """Show the choices and the fitted model.

        Parameters
        ----------
        organs : list of OrganParameters
        volumeNode : vtkMRMLScalarVolumeNode or None
        busy : bool
            Whether an organ is being fitted.
        """
        ui, changed = self._ui, volumeNode is not self._volume
        self._organs, self._volume = organs, volumeNode
        ready = self._parameters is not None and volumeNode is not None
        ui.modelSection.enabled = ready
        ui.fitModelButton.enabled = ready and not busy and not self.running
        ui.cancelModelButton.enabled = self.running or self._mesher.running
        ui.newLandmarksButton.enabled = ready
        fitted = findModel(volumeNode) is not None
        ui.patchColorCheck.enabled = fitted
        ui.exportModelButton.enabled = fitted and not self.running and not self._mesher.running
        if changed and not self.running:
            self._show(messageOf(volumeNode))
        self._followLandmarks()
        if not ready:
            return
        self._showModel()
        self._showOrgans()
        self._showColors()
        self._meshChosen()

    def _setUpWidgets(self):
        ui = self._ui
        for name, text in _modelTexts():
            ui.genericModelCombo.addItem(text, name)
        ui.modelFileEdit.filters = ctk.ctkPathLineEdit.Files | ctk.ctkPathLineEdit.Readable
        ui.modelFileEdit.nameFilters = (_("Models (*.json)"),)
        ui.modelFolderEdit.filters = ctk.ctkPathLineEdit.Dirs | ctk.ctkPathLineEdit.Writable
        ui.modelFolderEdit.settingKey = "VICRegistration/ModelFolder"
        for suffix, text in (("", _("No mesh")), *meshFormats()):
            ui.modelMeshCombo.addItem(text, suffix)
        setUpTable(ui.modelOrgansTable, [_("Organ of the model"), _("In the image")], wide=_IN_TABLE)
        showPlaceButtons(ui.landmarkPlaceWidget)
        # Slicer hides the delete button of a list with a fixed number of points unless this menu entry is visible.
        ui.landmarkPlaceWidget.unsetAllControlPointsOptionVisible = True
        ui.landmarkPlaceWidget.placeMultipleMarkups = slicer.qSlicerMarkupsPlaceWidget.ForcePlaceMultipleMarkups

    def _showModel(self):
        """Show which model is chosen."""
        combo, edit, name = self._ui.genericModelCombo, self._ui.modelFileEdit, self._parameters.modelName
        fromFile = name not in MODELS
        with signalsBlocked(combo):
            combo.setCurrentIndex(combo.findData(_FILE if fromFile else name))
        if fromFile and edit.currentPath != name:
            with signalsBlocked(edit):
                edit.currentPath = name
        showRow(fromFile, self._ui.modelFileLabel, edit)

    def _modelChosen(self, index):
        if self._parameters is not None:
            name = self._ui.genericModelCombo.itemData(index)
            self._parameters.modelName = name or self._ui.modelFileEdit.currentPath

    def _fileChosen(self, path):
        if self._parameters is not None:
            self._parameters.modelName = path

    def _model(self):
        """Chosen model, or None; an error is shown then."""
        try:
            return modelNamed(self._parameters.modelName)
        except ValueError as error:
            self._show(str(error))
            return None

    def _expanded(self, collapsed):
        if not collapsed and self._parameters is not None:
            self._showOrgans()

    def _showOrgans(self):
        """List the model's organs with those of the table; a model is built only while the section is open."""
        table = self._ui.modelOrgansTable
        if self._ui.modelSection.collapsed or self._volume is None:
            return
        shown = (self._parameters.modelName, [(organ.parameterNode.GetID(), organ.label) for organ in self._organs])
        model = self._model()
        names = list(model.organs) if model is not None else []
        if shown != self._rows:
            self._rows = shown
            table.setRowCount(0)
            table.setRowCount(len(names))
            for row, name in enumerate(names):
                table.setItem(row, _ORGAN, qt.QTableWidgetItem(name))
                table.setCellWidget(row, _IN_TABLE, self._choice(name))
            fitHeight(table)
        pairs = pairedOrgans(model, self._organs) if model is not None else {}
        for row, name in enumerate(names):
            combo, organ = table.cellWidget(row, _IN_TABLE), pairs.get(name)
            with signalsBlocked(combo):
                combo.setCurrentIndex(combo.findData(organ.parameterNode.GetID() if organ is not None else ""))

    def _choice(self, name):
        """Organs of the table to choose from for an organ of the model."""
        combo = qt.QComboBox()
        combo.setToolTip(_("The organ of your table, or predict it from the others."))
        combo.addItem(_("predict"), "")
        for organ in self._organs:
            combo.addItem(organ.label, organ.parameterNode.GetID())
        combo.connect("currentIndexChanged(int)", lambda index: self._paired(name, combo.itemData(index)))
        return combo

    def _paired(self, name, nodeId):
        model = self._model()
        if model is not None:
            organ = next((each for each in self._organs if each.parameterNode.GetID() == nodeId), None)
            pairOrgan(name, organ, self._organs, model)
            self._showOrgans()

    def _createLandmarks(self):
        model = self._model()
        if model is None:
            return
        try:
            self._parameters.modelLandmarks = createLandmarks(model, self._volume)
        except ValueError as error:
            self._show(str(error))
            return
        self._followLandmarks()
        self._ui.landmarkPlaceWidget.setPlaceModeEnabled(True)

    def _followLandmarks(self):
        node = self._parameters.modelLandmarks if self._parameters is not None else None
        if node is not self._landmarks:
            # Clicks would still place points of the list before.
            self.stopPlacing()
            self.removeObservers()
            self._landmarks = node
            self._ui.landmarkPlaceWidget.setCurrentNode(node)
            for event in placingEvents() if node is not None else ():
                self.addObserver(node, event, self._landmarksPlaced)
        self._ui.landmarkPlaceWidget.enabled = node is not None
        self._showPlaced()

    def _landmarksPlaced(self, caller=None, event=None):
        self._showPlaced()

    def _showPlaced(self):
        """Show how many landmarks are placed, and which one the next click places."""
        ui, node = self._ui, self._landmarks
        there = node is not None and node.GetScene() is not None
        ui.landmarksPlacedLabel.text = landmarksText(node) if there else ""
        showRow(there, ui.landmarksPlacedLabel)
        ui.skipLandmarkButton.enabled = there and nextLandmark(node) is not None

    def _skipLandmark(self):
        skipLandmark(self._landmarks)
        if nextLandmark(self._landmarks) is None:
            self.stopPlacing()

    def _fit(self):
        self.stopPlacing()
        self._fittedVolume = self._volume
        self._show(_("Fitting the model ..."))
        self._runner = StepRunner(modelSteps(self._parameters, self._organs, self._volume), self._show, self._ended)
        self._onChanged()

    def _ended(self, problem):
        self._runner, volumeNode = None, self._fittedVolume
        self._fittedVolume = None
        if not problem:
            focusOnce(volumeNode)
        text = problem or messageOf(volumeNode)
        self._onChanged()
        self._show(text)

    def _showColors(self):
        check = self._ui.patchColorCheck
        with signalsBlocked(check):
            check.checked = isColoredByPatch(self._volume)

    def _colorChosen(self, byPatch):
        colorByPatch(self._volume, byPatch)

    def _meshSuffix(self):
        return self._ui.modelMeshCombo.itemData(self._ui.modelMeshCombo.currentIndex)

    def _meshChosen(self, _index=None):
        showRow(bool(self._meshSuffix()), self._ui.modelMeshSizeLabel, self._ui.modelMeshSizeSlider)

    def _export(self):
        folder, suffix, volumeNode = folderIn(self._ui.modelFolderEdit), self._meshSuffix(), self._volume
        if not folder:
            self._show(_("Choose a folder to write to."))
            return
        self._ui.modelFolderEdit.addCurrentPathToHistory()
        try:
            with slicer.util.WaitCursor():
                paths, problem = exportModel(volumeNode, folder)
            written = _("Written: {files}").format(files=", ".join(map(str, paths)))
            self._written = "\n".join([written, problem] if problem else [written])
            self._show(self._written)
            if suffix:
                size = self._ui.modelMeshSizeSlider.value
                self._mesher.mesh(lambda work: modelMeshArguments(volumeNode, work, folder, suffix, sizeMm=size))
        except (ValueError, OSError) as error:
            self._show(str(error))

    def _showMeshText(self, text):
        """Show the text of the mesher below the files that were written; of its report only the summary."""
        self._show("\n".join([self._written, *text.split("\n")[:_LINES_OF_MESH]]))
