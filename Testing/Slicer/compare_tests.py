"""Comparing surfaces, and their colours."""

from __future__ import annotations

import numpy as np
import slicer
import vtk
from panel_case import PanelTestCase

from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.mrml.surfaces import createModel, showSurface, surfaceFromModel


class CompareTest(PanelTestCase):
    """A surface beside a segment and beside another model: numbers, colours, the table."""

    def setUp(self):
        super().setUp()
        self.compared = self.fitted("rectum")
        self.ui.referenceKindCombo.setCurrentIndex(0)

    def expertsSegment(self, *, name="rectum", empty=False, shift=0.0):
        """A segment that is the true organ, on a grid of its own, as another program might have written it."""
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "expert")
        node.CreateDefaultDisplayNodes()
        node.GetSegmentation().AddEmptySegment("truth", name, [1.0, 0.0, 0.0])
        if not empty:
            mesh = triangulate(self.phantom.surfaces[name], chord_error=0.1)
            low, high = mesh.points.min(axis=0) - 3.0, mesh.points.max(axis=0) + 3.0
            shape = tuple(int(size) for size in (high - low)[::-1])
            matrix = np.eye(4)
            matrix[:3, 3] = low
            mask = volume_fractions(mesh.points, mesh.triangles, shape, matrix) >= 0.5
            matrix[2, 3] += shift
            grid = slicer.util.addVolumeFromArray(mask.astype(np.uint8), ijkToRAS=matrix, name="grid")
            node.SetReferenceImageGeometryParameterFromVolumeNode(grid)
            slicer.util.updateSegmentBinaryLabelmapFromArray(mask.astype(np.uint8), node, "truth", grid)
            slicer.mrmlScene.RemoveNode(grid)
        return node

    def choose(self, node):
        """Choose a segmentation with its only segment, or a model, as the reference."""
        if node.IsA("vtkMRMLModelNode"):
            self.ui.referenceKindCombo.setCurrentIndex(1)
            self.ui.referenceModelSelector.setCurrentNode(node)
        else:
            self.ui.referenceSegmentSelector.setCurrentNode(node)
            self.ui.referenceSegmentSelector.setCurrentSegmentID("truth")

    def compare(self, node):
        """Compare with a reference; returns what is told."""
        self.choose(node)
        self.ui.compareButton.click()
        return self.ui.compareStatusLabel.text

    def colorBy(self, name):
        """Choose what the surface is coloured by."""
        self.ui.colorByCombo.setCurrentIndex(self.ui.colorByCombo.findData(name))

    def test_theSurfaceIsComparedWithASegment(self):
        text = self.compare(self.expertsSegment())
        self.assertIn("expert: rectum", text)
        self.assertIn("Hausdorff", text)
        display = self.organ.surface.GetDisplayNode()
        self.assertTrue(display.GetScalarVisibility())
        self.assertEqual(display.GetActiveScalarName(), "Deviation (mm)")
        low, high = display.GetScalarRange()
        self.assertEqual(low, -high)
        self.assertEqual(self.ui.colorByCombo.currentIndex, 1)
        legend = slicer.modules.colors.logic().GetColorLegendDisplayNode(self.organ.surface)
        self.assertIn("(mm)", legend.GetTitleText())
        self.assertTrue(legend.GetVisibility())

    def test_theTableIsCopied(self):
        self.ui.copyTableButton.click()
        self.assertIn("no comparison", self.ui.compareStatusLabel.text)
        segment = self.expertsSegment()
        self.compare(segment)
        self.ui.patientEdit.setText("Patient 2")
        self.compare(segment)
        self.ui.copyTableButton.click()
        self.assertIn("2 row", self.ui.compareStatusLabel.text)
        lines = slicer.app.clipboard().text().splitlines()
        self.assertEqual(len(lines), 3)
        self.assertTrue(lines[0].startswith("Patient,Organ,Reference,"))
        self.assertTrue(lines[1].startswith("VIC pelvis phantom"))
        self.assertTrue(lines[2].startswith("Patient 2,rectum,expert: rectum,"))

    def test_thePatientIsThatOfTheVolume(self):
        self.assertEqual(self.ui.patientEdit.placeholderText, self.volume.GetName())
        self.ui.patientEdit.setText("Patient 2")
        self.compare(self.expertsSegment())
        self.add("bladder")
        self.assertEqual(self.ui.patientEdit.text, "Patient 2")

    def test_theOrgansOwnColourComesBack(self):
        self.assertEqual(self.ui.colorByCombo.currentIndex, 0)
        self.colorBy("Deviation (mm)")
        self.assertIn("Press Compare", self.ui.compareStatusLabel.text)
        self.assertEqual(self.ui.colorByCombo.currentIndex, 0)
        self.compare(self.expertsSegment())
        self.colorBy("")
        display = self.organ.surface.GetDisplayNode()
        self.assertFalse(display.GetScalarVisibility())
        self.colorBy("Deviation (mm)")
        self.assertTrue(display.GetScalarVisibility())
        # The deviation of a new surface is not known.
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertFalse(display.GetScalarVisibility())
        self.assertEqual(self.ui.colorByCombo.currentIndex, 0)
        self.assertEqual(self.ui.compareStatusLabel.text, "")

    def test_theConfidenceIsShownWhereThereIsOne(self):
        surface = surfaceFromModel(self.organ.surface)
        # A surface of an older scene has none.
        showSurface(self.organ.surface, surface, name="rectum")
        self.colorBy("Standard deviation (mm)")
        self.assertIn("Fit the organ again", self.ui.compareStatusLabel.text)
        showSurface(
            self.organ.surface, surface, name="rectum", standardDeviation=lambda places: 0.2 + 0.1 * places[:, 1]
        )
        self.colorBy("Standard deviation (mm)")
        display = self.organ.surface.GetDisplayNode()
        self.assertEqual(display.GetActiveScalarName(), "Standard deviation (mm)")
        self.assertEqual(display.GetScalarRange()[0], 0.0)

    def test_anotherSurfaceIsTheReference(self):
        self.fitted("vagina")
        self.ui.organsTable.selectRow(0)
        self.assertIn("do not overlap", self.compare(slicer.util.getNode("vagina surface")))
        self.assertIn("the organ itself", self.compare(self.organ.surface))
        copy = createModel("second reader", (1.0, 0.0, 0.0))
        showSurface(copy, self.phantom.surfaces["rectum"], name="rectum")
        self.assertIn("Against second reader", self.compare(copy))
        # Each organ has a reference of its own.
        self.ui.organsTable.selectRow(1)
        self.assertEqual(self.ui.referenceModelSelector.currentNode(), None)
        self.assertEqual(self.ui.compareStatusLabel.text, "")
        self.ui.organsTable.selectRow(0)
        self.assertIs(self.ui.referenceModelSelector.currentNode(), copy)
        self.assertIn("Against second reader", self.ui.compareStatusLabel.text)

    def test_whatCannotBeComparedIsToldInTheSection(self):
        self.assertTrue(self.ui.compareButton.enabled)
        self.ui.compareButton.click()
        self.assertIn("No reference", self.ui.compareStatusLabel.text)
        self.assertIn("is empty", self.compare(self.expertsSegment(empty=True)))
        self.assertIn("do not overlap", self.compare(self.expertsSegment(shift=300.0)))
        flat = vtk.vtkPlaneSource()
        flat.Update()
        sheet = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "sheet")
        sheet.SetAndObservePolyData(flat.GetOutput())
        self.assertIn("open", self.compare(sheet))
        slicer.mrmlScene.RemoveNode(sheet)
        self.ui.compareButton.click()
        self.assertIn("No reference", self.ui.compareStatusLabel.text)
        self.assertFalse(self.organ.surface.GetDisplayNode().GetScalarVisibility())
        self.add("bladder")
        self.assertFalse(self.ui.compareButton.enabled)
        self.assertIn("no surface yet", self.ui.compareStatusLabel.text)

    def test_aSegmentDeletedWhileTheModuleIsLeftIsNoLongerChosen(self):
        node = self.expertsSegment()
        node.GetSegmentation().AddEmptySegment("other", "other", [0.0, 1.0, 0.0])
        self.choose(node)
        self.widget.exit()
        node.GetSegmentation().RemoveSegment("truth")
        slicer.app.processEvents()
        self.widget.enter()
        selector = self.ui.referenceSegmentSelector
        self.assertEqual(self.organ.referenceSegmentId, "")
        self.assertEqual(selector.currentSegmentID(), "")
        # What is chosen next counts at once.
        selector.setCurrentSegmentID("other")
        self.assertEqual(self.organ.referenceSegmentId, "other")

    def test_nodesAreDeletedAndTheModuleIsLeftWhileColoursAreShown(self):
        segment = self.expertsSegment()
        self.compare(segment)
        self.widget.exit()
        self.assertFalse(self.ui.compareButton.enabled)
        self.assertTrue(self.compared.surface.GetDisplayNode().GetScalarVisibility())
        self.widget.enter()
        self.assertIn("Hausdorff", self.ui.compareStatusLabel.text)
        slicer.mrmlScene.RemoveNode(segment)
        slicer.app.processEvents()
        self.assertEqual(self.organ.referenceSegmentation, None)
        slicer.mrmlScene.RemoveNode(self.organ.surface)
        slicer.app.processEvents()
        self.assertFalse(self.ui.compareButton.enabled)
        self.assertFalse(self.ui.colorByCombo.enabled)
        self.ui.removeOrganButton.click()
        # Results are kept until they are deleted as a table.
        self.ui.copyTableButton.click()
        self.assertIn("1 row", self.ui.compareStatusLabel.text)
        slicer.mrmlScene.Clear()
        self.ui.copyTableButton.click()
        self.assertIn("no comparison", self.ui.compareStatusLabel.text)

    def test_aScriptsComparisonIsSeen(self):
        segment = self.expertsSegment()
        found = self.panel.logic.compare(self.organ, segment)
        self.assertIn(f"mean {found.to_surface.mean:.2f} mm", self.ui.compareStatusLabel.text)
        self.assertIs(self.ui.referenceSegmentSelector.currentNode(), segment)
        self.assertEqual(self.ui.colorByCombo.currentIndex, 1)
        self.assertLess(found.to_surface.mean, 0.3)
