"""The section that exports organs: exact solids, triangles, meshes for finite elements."""

from __future__ import annotations

import ctk
from slicer.i18n import tr as _

from ..meshing.formats import MESH_FORMATS
from ..mrml.exporting import exportSurfaces, meshArguments
from .mesher import Mesher, meshFormats
from .message_label import MessageLabel
from .widgets import folderIn, showRow

# Index of "All fitted organs together" in the combo box; the other entry is the selected organ.
_ALL = 1


def _formats():
    return (
        (".step", _("STEP: exact solids (.step)")),
        (".stl", _("Triangles (.stl)")),
        (".ply", _("Triangles (.ply)")),
        (".vtp", _("Triangles with the control net (.vtp)")),
        *meshFormats(),
    )


class ExportSection:
    """Writes the surfaces of the selected organ or of all organs.

    Parameters
    ----------
    ui : namespace of widgets
    """

    def __init__(self, ui):
        self._ui, self._organs, self._current = ui, [], None
        self._show = MessageLabel(ui.exportStatusLabel).show
        self._mesher = Mesher(self._show, self._formatChosen)
        for suffix, text in _formats():
            ui.exportFormatCombo.addItem(text, suffix)
        ui.exportOrgansCombo.addItem(_("Selected organ"))
        ui.exportOrgansCombo.addItem(_("All fitted organs together"))
        ui.exportFolderEdit.filters = ctk.ctkPathLineEdit.Dirs | ctk.ctkPathLineEdit.Writable
        ui.exportFolderEdit.settingKey = "VICRegistration/ExportFolder"
        ui.meshOrderCombo.addItem(_("Linear"), 1)
        ui.meshOrderCombo.addItem(_("Second order"), 2)
        ui.exportFormatCombo.connect("currentIndexChanged(int)", self._formatChosen)
        ui.exportOrgansCombo.connect("currentIndexChanged(int)", self._formatChosen)
        ui.exportButton.connect("clicked()", self._export)
        ui.cancelExportButton.connect("clicked()", self.stop)
        self.show([], None)

    @property
    def running(self):
        """Whether a mesh is being made."""
        return self._mesher.running

    def show(self, organs, current):
        """Enable the export of what can be written.

        Parameters
        ----------
        organs : list of OrganParameters
        current : OrganParameters or None
        """
        self._organs, self._current = organs, current
        self._formatChosen()

    def stop(self):
        """Stop the mesher if it runs; it leaves no file."""
        self._mesher.stop()

    def _chosen(self):
        if self._ui.exportOrgansCombo.currentIndex == _ALL:
            return [organ for organ in self._organs if organ.surface is not None]
        return [self._current] if self._current is not None and self._current.surface is not None else []

    def _suffix(self):
        return self._ui.exportFormatCombo.itemData(self._ui.exportFormatCombo.currentIndex)

    def _formatChosen(self, _index=None):
        ui, meshing, exact = self._ui, self._suffix() in MESH_FORMATS, self._suffix() == ".step"
        showRow(exact, ui.exportFacesLabel, ui.exportFacesSpin)
        showRow(meshing, ui.meshSizeLabel, ui.meshSizeSlider, ui.meshOrderLabel, ui.meshOrderCombo)
        showRow(meshing, ui.meshWallLabel, ui.meshWallSlider, ui.cancelExportButton)
        ui.exportButton.enabled = bool(self._chosen()) and not self.running
        ui.cancelExportButton.enabled = self.running

    def _export(self):
        folder, suffix = folderIn(self._ui.exportFolderEdit), self._suffix()
        if not folder:
            self._show(_("Choose a folder to write to."))
            return
        self._ui.exportFolderEdit.addCurrentPathToHistory()
        try:
            if suffix in MESH_FORMATS:
                self._mesh(folder, suffix)
            else:
                paths = exportSurfaces(self._chosen(), folder, suffix, faces=self._ui.exportFacesSpin.value)
                self._show(_("Written: {files}").format(files=", ".join(map(str, paths))))
        except (ValueError, OSError) as error:
            self._show(str(error))

    def _mesh(self, folder, suffix):
        ui = self._ui
        how = {
            "sizeMm": ui.meshSizeSlider.value,
            "order": ui.meshOrderCombo.itemData(ui.meshOrderCombo.currentIndex),
            "wallMm": ui.meshWallSlider.value,
        }
        self._mesher.mesh(lambda work: meshArguments(self._chosen(), work, folder, suffix, **how))
