"""Further stacks."""

from __future__ import annotations

import gc
import json

import numpy as np
import slicer
import vtk
from panel_case import PanelTestCase, waitFor

from VICRegistrationLib.mrml.surfaces import surfaceFromModel


class StacksTest(PanelTestCase):
    """Further stacks: choose, fit, save, load, delete one under way."""

    SHIFT = (1.5, -1.0, 1.0)

    def setUp(self):
        super().setUp()
        self.stack = self.addStack("AX", self.SHIFT)
        waitFor(lambda: self.table.rowCount == 1)

    @property
    def table(self):
        return self.ui.furtherStacksTable

    def addStack(self, name, shift):
        """Add the same voxels once more, displaced; one in a corner differs, as the same image is refused."""
        matrix = vtk.vtkMatrix4x4()
        self.volume.GetIJKToRASMatrix(matrix)
        for axis in range(3):
            matrix.SetElement(axis, 3, matrix.GetElement(axis, 3) + shift[axis])
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", name)
        node.SetIJKToRASMatrix(matrix)
        voxels = vtk.vtkImageData()
        voxels.DeepCopy(self.volume.GetImageData())
        voxels.SetScalarComponentFromDouble(0, 0, 0, 0, voxels.GetScalarComponentAsDouble(0, 0, 0, 0) + 1.0)
        node.SetAndObserveImageData(voxels)
        return node

    def check(self, row=0):
        return self.table.cellWidget(row, 0)

    def test_volumesAreListedWhereTheyShowTheSamePlace(self):
        self.assertFalse(self.table.isHidden() or self.ui.furtherStacksLabel.isHidden())
        self.assertEqual((self.check().text, self.check().checked), ("AX", False))
        self.stack.SetName("AX & more")
        self.assertEqual(self.check().text, "AX && more")
        away = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "away")
        matrix = vtk.vtkMatrix4x4()
        matrix.SetElement(0, 3, 1000.0)
        away.SetMatrixTransformToParent(matrix)
        self.stack.SetAndObserveTransformNodeID(away.GetID())
        self.assertEqual(self.table.rowCount, 0)
        self.assertTrue(self.table.isHidden() and self.ui.furtherStacksLabel.isHidden())
        self.stack.SetAndObserveTransformNodeID(None)
        self.assertEqual(self.table.rowCount, 1)
        self.ui.volumeSelector.setCurrentNode(self.stack)
        self.assertEqual(self.check().text, self.volume.GetName().replace("&", "&&"))

    def test_organsFollowTheirVolumeWhileAnotherOneIsChosen(self):
        organ = self.fitted("bladder")
        before = organ.volumeMl
        self.ui.volumeSelector.setCurrentNode(self.stack)
        larger = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "larger")
        matrix = vtk.vtkMatrix4x4()
        matrix.SetElement(0, 0, 2.0)
        larger.SetMatrixTransformToParent(matrix)
        self.volume.SetAndObserveTransformNodeID(larger.GetID())
        self.assertIs(organ.surface.GetParentTransformNode(), larger)
        self.assertAlmostEqual(organ.volumeMl, 2.0 * before, places=6)

    def test_aVolumeThatIsRemovedLeavesTheList(self):
        self.addStack("COR", (0.0, 0.0, 0.5))
        waitFor(lambda: self.table.rowCount == 2)
        self.check(0).click()
        self.check(1).click()
        slicer.mrmlScene.RemoveNode(self.stack)
        self.assertEqual((self.table.rowCount, self.check().text, self.check().checked), (1, "COR", True))
        self.assertEqual([node.GetName() for node in self.panel.parameters.furtherStacks], ["COR"])

    def test_voxelsOfAStackThatIsRemovedAreFreed(self):
        self.add("bladder")
        self.check().click()
        freed = []
        self.stack.GetImageData().AddObserver(vtk.vtkCommand.DeleteEvent, lambda caller, event: freed.append(event))
        slicer.mrmlScene.RemoveNode(self.stack)
        self.stack = None
        slicer.app.processEvents()
        gc.collect()
        self.assertEqual(len(freed), 1)

    def test_theFitTakesWhatIsTickedAndShowsTheMotion(self):
        self.check().click()
        organ = self.fitted("bladder")
        self.assertLess(self.distance(organ), 0.3)
        moved, away = self.table.item(0, 1).text(), float(np.linalg.norm(self.SHIFT))
        self.assertAlmostEqual(float(moved.split(" mm, ")[0]), away, delta=0.3)
        self.assertIn(f"used, moved {moved.split(' mm')[0]} ± ", self.table.item(0, 1).toolTip())
        self.assertIn("(standard deviations)", self.table.item(0, 1).toolTip())
        # As an earlier version has kept it.
        records = [json.loads(text) for text in organ.stackRecords]
        organ.stackRecords = [
            json.dumps({key: value for key, value in record.items() if "Deviation" not in key}) for record in records
        ]
        self.panel.refresh()
        self.assertIn(f"used, moved {moved.split(' mm')[0]} mm, ", self.table.item(0, 1).toolTip())
        self.assertNotIn("±", self.table.item(0, 1).toolTip())
        # The other organ has not been fitted yet.
        self.assertFalse(self.table.isColumnHidden(2))
        self.add("vagina")
        self.assertEqual(self.table.item(0, 1).text(), "")
        self.assertFalse(self.table.cellWidget(0, 2).enabled)
        self.assertTrue(self.table.isColumnHidden(2))

    def test_aStackThatIsLeftOutSaysWhy(self):
        slicer.util.updateVolumeFromArray(self.stack, np.full_like(slicer.util.arrayFromVolume(self.volume), 7))
        self.check().click()
        organ = self.fitted("bladder")
        self.assertEqual(self.table.item(0, 1).text(), "left out")
        self.assertIn("The stack AX was left out.", self.table.item(0, 1).toolTip())
        self.assertIn("The stack AX was left out.", organ.message)
        self.assertFalse(self.table.cellWidget(0, 2).enabled)

    def test_theMotionIsMadeATransform(self):
        self.check().click()
        organ = self.fitted("bladder")
        self.table.cellWidget(0, 2).click()
        made = self.stack.GetParentTransformNode()
        matrix = vtk.vtkMatrix4x4()
        made.GetMatrixTransformToWorld(matrix)
        place = matrix.MultiplyPoint([*np.add(self.phantom.seeds["bladder"][0], self.SHIFT), 1.0])[:3]
        np.testing.assert_allclose(place, self.phantom.seeds["bladder"][0], atol=0.5)
        self.assertFalse(self.table.cellWidget(0, 2).enabled)
        self.assertIs(organ.contours()[0].GetParentTransformNode(), made)
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertLess(float(self.table.item(0, 1).text().split()[0]), 0.3)

    def test_everyViewShowsTheContourOfItsStack(self):
        self.check().click()
        organ = self.fitted("bladder")
        composite = self.sliceComposite()
        slices = slicer.util.getNodesByClass("vtkMRMLSliceNode")
        view = next(node for node in slices if node.GetLayoutName() == composite.GetLayoutName())
        (contour,) = organ.contours()
        for volume, expected in (
            (self.stack, (False, True)),
            (self.volume, (True, False)),
            (self.stack, (False, True)),
        ):
            composite.SetBackgroundVolumeID(volume.GetID())
            displays = [node.GetDisplayNode() for node in (organ.surface, contour)]
            shown = tuple(bool(d.GetVisibility2D() and d.IsDisplayableInView(view.GetID())) for d in displays)
            self.assertEqual(shown, expected)

    def test_aCloneOfAnAlignedStackIsAligned(self):
        self.check().click()
        self.fitted("bladder")
        self.table.cellWidget(0, 2).click()
        # Clones are made in the module Data.
        self.widget.exit()
        hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
        clone = slicer.vtkSlicerSubjectHierarchyModuleLogic.CloneSubjectHierarchyItem
        item = clone(hierarchy, hierarchy.GetItemByDataNode(self.stack))
        copy = hierarchy.GetItemDataNode(item)
        waitFor(lambda: copy.GetParentTransformNode() is not None)
        self.assertIs(copy.GetParentTransformNode(), self.stack.GetParentTransformNode())

    def test_aStackIsDeletedMeanwhile(self):
        self.check().click()
        organ = self.fitted("bladder")
        before = surfaceFromModel(organ.surface).control_net
        self.ui.fitButton.click()
        # No step yet: a fit that is told again from memory ends in the first slice of time.
        slicer.mrmlScene.RemoveNode(self.stack)
        self.waitForFit()
        self.assertIn("The stack AX was deleted", self.ui.fitStatusLabel.text)
        np.testing.assert_array_equal(surfaceFromModel(organ.surface).control_net, before)
        self.assertEqual((self.table.rowCount, organ.contours()), (0, []))
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertIn("iterations", self.ui.fitStatusLabel.text)

    def test_aSavedSceneComesBackWithItsStacks(self):
        self.check().click()
        self.fitted("bladder")
        text = self.table.item(0, 1).text()
        with self.savedAndLoaded():
            self.assertEqual(self.table.rowCount, 0)
        waitFor(lambda: self.table.rowCount == 1)
        self.assertEqual((self.check().text, self.check().checked), ("AX", True))
        self.assertEqual(self.table.item(0, 1).text(), text)
        self.assertEqual(len(self.organ.contours()), 1)
