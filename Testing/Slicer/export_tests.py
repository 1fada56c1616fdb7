"""Files that are exported, and meshes."""

from __future__ import annotations

import os
import tempfile

import numpy as np
import slicer
from panel_case import PanelTestCase, gmshCanBeLoaded, waitFor


class ExportTest(PanelTestCase):
    """Files for CAD and simulation."""

    def choose(self, suffix, folder):
        """Choose a format and a folder."""
        combo = self.ui.exportFormatCombo
        combo.setCurrentIndex([combo.itemData(index) for index in range(combo.count)].index(suffix))
        self.ui.exportFolderEdit.currentPath = folder

    def export(self, suffix, folder):
        """Export in a format, and wait for the end."""
        self.choose(suffix, folder)
        self.assertTrue(self.ui.exportButton.enabled)
        self.ui.exportButton.click()
        waitFor(lambda: not self.panel.exportSection.running)

    def test_nothingIsExportedBeforeAFit(self):
        self.add("rectum")
        self.assertFalse(self.ui.exportButton.enabled)

    def test_theSurfacesAreWrittenWhereTheyLie(self):
        self.fitted("rectum")
        self.fitted("vagina")
        self.ui.exportOrgansCombo.setCurrentIndex(1)
        with tempfile.TemporaryDirectory() as folder:
            self.export(".step", folder)
            self.export(".stl", folder)
            self.assertEqual(sorted(os.listdir(folder)), ["organs.step", "rectum.stl", "vagina.stl"])
            with open(os.path.join(folder, "organs.step"), encoding="ascii") as file:
                text = file.read()
        self.assertTrue(text.startswith("ISO-10303-21;"))
        self.assertEqual(text.count("MANIFOLD_SOLID_BREP"), 2)
        self.assertIn("vagina", text)

    def test_aMeshComesBackAsAModel(self):
        if not gmshCanBeLoaded():
            self.skipTest("gmsh is not installed, or lacks a library of the system")
        organ = self.fitted("rectum")
        self.ui.meshSizeSlider.value = 6.0
        with tempfile.TemporaryDirectory() as folder:
            self.export(".vtu", folder)
            self.assertIn("rectum.vtu", os.listdir(folder))
        mesh = slicer.util.getNode("rectum mesh")
        self.assertEqual(mesh.GetMesh().GetClassName(), "vtkUnstructuredGrid")
        low, high = np.reshape(mesh.GetMesh().GetBounds(), (3, 2)).T
        np.testing.assert_allclose([low, high], np.reshape(organ.surface.GetPolyData().GetBounds(), (3, 2)).T, atol=0.5)
        self.assertIn("tetrahedra", self.ui.exportStatusLabel.text)
        self.assertIn('"inverted": 0', mesh.GetAttribute("VIC.quality"))

    def test_aMeshIsCancelled(self):
        if not gmshCanBeLoaded():
            self.skipTest("gmsh is not installed, or lacks a library of the system")
        self.fitted("rectum")
        # Takes minutes if it is left alone.
        self.ui.meshSizeSlider.value = 1.0
        with tempfile.TemporaryDirectory() as folder:
            self.choose(".vtu", folder)
            self.ui.exportButton.click()
            self.assertTrue(self.ui.cancelExportButton.enabled)
            asked = self.ui.exportStatusLabel.text
            waitFor(lambda: self.ui.exportStatusLabel.text != asked)
            self.ui.cancelExportButton.click()
            waitFor(lambda: not self.panel.exportSection.running)
            self.assertEqual(self.ui.exportStatusLabel.text, "Cancelled; no mesh was written.")
            # The mesher itself is gone as well, and what it has begun.
            waitFor(lambda: not os.listdir(folder))
        self.assertTrue(self.ui.exportButton.enabled)

    def test_withoutAFolderNothingIsWritten(self):
        self.fitted("rectum")
        self.ui.exportFolderEdit.currentPath = ""
        self.ui.exportButton.click()
        self.assertIn("folder", self.ui.exportStatusLabel.text)
