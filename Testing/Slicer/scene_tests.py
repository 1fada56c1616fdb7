"""Scenes that are saved, loaded, closed and changed by others."""

from __future__ import annotations

import gc

import numpy as np
import slicer
import vtk
from panel_case import PanelTestCase, waitFor

from VICRegistrationLib.mrml import samples
from VICRegistrationLib.mrml.surfaces import createModel, surfaceFromModel
from VICRegistrationLib.mrml.volumes import showInSlices


class SceneTest(PanelTestCase):
    """What is saved, loaded, renamed and removed."""

    def test_aSavedSceneComesBack(self):
        organ = self.fitted("rectum")
        self.ui.erosionAutomaticCheck.click()
        self.ui.erosionSlider.value = 1.5
        self.waitForRegion()
        net, message = surfaceFromModel(organ.surface).control_net, organ.message
        with self.savedAndLoaded():
            self.assertEqual(self.ui.organsTable.rowCount, 0)
        self.assertEqual(self.ui.organsTable.rowCount, 1)
        self.assertEqual(self.ui.organsTable.item(0, 2).text(), "rectum")
        loaded = self.organ
        self.assertEqual(surfaceFromModel(loaded.surface).control_net.tobytes(), net.tobytes())
        self.assertEqual((loaded.message, loaded.erosionMm, self.ui.erosionSlider.value), (message, 1.5, 1.5))
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertLess(self.distance(loaded), 0.3)

    def test_deletedNodesAreMadeAgainOrMissed(self):
        organ = self.fitted("bladder")
        for node in (organ.surface, organ.convergence, organ.plot, organ.boundaryPoints, organ.regions):
            slicer.mrmlScene.RemoveNode(node)
            slicer.app.processEvents()
        self.assertFalse(self.ui.refitButton.enabled)
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertLess(self.distance(organ), 0.3)
        slicer.mrmlScene.RemoveNode(organ.seeds)
        self.assertEqual(organ.seeds.GetNumberOfControlPoints(), 0)
        slicer.mrmlScene.RemoveNode(organ.parameterNode)
        self.assertEqual(self.ui.organsTable.rowCount, 0)

    def test_noNodeIsChosenInPlaceOfADeletedOne(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        organ = self.organ
        # Each has neighbours in its selector's list: the other volume, the region, the surface of another organ.
        other = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "other")
        segmentations = [slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode") for _ in range(2)]
        models = [createModel(name, (1.0, 0.0, 0.0)) for name in ("first", "second", "third")]
        self.ui.segmentSelector.setCurrentNode(segmentations[0])
        self.ui.referenceSegmentSelector.setCurrentNode(segmentations[1])
        self.ui.referenceModelSelector.setCurrentNode(models[1])
        self.assertIs(organ.referenceModel, models[1])
        for node in (*segmentations, models[1], self.volume):
            slicer.mrmlScene.RemoveNode(node)
            slicer.app.processEvents()
        chosen = [organ.inputSegmentation, organ.referenceSegmentation, organ.referenceModel]
        self.assertEqual(chosen, [None, None, None])
        self.assertIsNone(self.panel.parameters.volume)
        self.assertIsNone(self.ui.volumeSelector.currentNode())
        self.assertIsNotNone(other.GetScene())

    def test_theFirstVolumeThatIsLoadedIsChosen(self):
        slicer.mrmlScene.RemoveNode(self.volume)
        slicer.app.processEvents()
        self.assertIsNone(self.ui.volumeSelector.currentNode())
        self.assertFalse(self.ui.addOrganButton.enabled)
        self.assertIn("Load an MRI", self.ui.fitStatusLabel.text)
        hidden = slicer.mrmlScene.CreateNodeByClass("vtkMRMLScalarVolumeNode")
        hidden.UnRegister(None)
        hidden.SetHideFromEditors(True)
        slicer.mrmlScene.AddNode(hidden)
        slicer.app.processEvents()
        volume = samples.addPhantomVolume()
        waitFor(lambda: self.ui.addOrganButton.enabled)
        self.assertIs(self.ui.volumeSelector.currentNode(), volume)
        self.assertIn("Press Add organ", self.ui.fitStatusLabel.text)
        self.add("bladder")
        self.assertEqual(self.ui.fitStatusLabel.text, "")

    def test_theVolumeInTheSliceViewsIsChosenUntilThereIsAnOrgan(self):
        composite = self.sliceComposite()
        # Slicer shows what it has loaded last; then another one is chosen in the view.
        for volume in (samples.addPhantomVolume(), samples.addPhantomVolume(), self.volume):
            composite.SetBackgroundVolumeID(volume.GetID())
            waitFor(lambda volume=volume: self.ui.volumeSelector.currentNode() is volume)
        self.add("bladder")
        other = samples.addPhantomVolume()
        composite.SetBackgroundVolumeID(other.GetID())
        waitFor(lambda: self.ui.furtherStacksTable.rowCount == 3)
        self.assertIs(self.ui.volumeSelector.currentNode(), self.volume)
        self.ui.removeOrganButton.click()
        composite.SetBackgroundVolumeID(samples.addPhantomVolume().GetID())
        waitFor(lambda: self.ui.furtherStacksTable.rowCount == 4)
        self.assertIs(self.ui.volumeSelector.currentNode(), self.volume)

    def test_aVolumeThatTheUserHasChosenStays(self):
        composite, chosen = self.sliceComposite(), samples.addPhantomVolume()
        chosen.SetName("chosen")
        for volume in (chosen, self.volume, chosen):
            self.ui.volumeSelector.setCurrentNode(volume)
            # The selector signals it if a user has chosen.
            self.panel.showVolume(volume)
            rows = self.ui.furtherStacksTable.rowCount
            composite.SetBackgroundVolumeID(samples.addPhantomVolume().GetID())
            waitFor(lambda rows=rows: self.ui.furtherStacksTable.rowCount == rows + 1)
            self.assertIs(self.ui.volumeSelector.currentNode(), volume)
        self.widget.exit()
        composite.SetBackgroundVolumeID(self.volume.GetID())
        self.widget.enter()
        self.assertIs(self.ui.volumeSelector.currentNode(), chosen)
        with self.savedAndLoaded():
            pass
        self.assertEqual(self.ui.volumeSelector.currentNode().GetName(), "chosen")
        self.sliceComposite().SetBackgroundVolumeID(samples.addPhantomVolume().GetID())
        waitFor(lambda: self.ui.furtherStacksTable.rowCount == 5)
        self.assertEqual(self.ui.volumeSelector.currentNode().GetName(), "chosen")

    def test_noOtherVolumeIsChosenForOrgansWhileAnotherModuleIsShown(self):
        self.add("bladder")
        slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "other")
        self.widget.exit()
        slicer.mrmlScene.RemoveNode(self.volume)
        self.widget.enter()
        self.assertIsNone(self.ui.volumeSelector.currentNode())
        self.assertIn("Load an MRI", self.ui.fitStatusLabel.text)

    def test_pointsThatArePlacedAreSeen(self):
        organ = self.fitted("bladder")
        self.ui.organsTable.cellWidget(0, 0).click()
        self.assertFalse(organ.boundaryPoints.GetDisplayNode().GetVisibility())
        self.ui.boundaryPlaceWidget.setPlaceModeEnabled(True)
        self.assertTrue(organ.boundaryPoints.GetDisplayNode().GetVisibility())
        self.assertFalse(organ.surface.GetDisplayNode().GetVisibility())

    def test_aDeletedSegmentIsMissed(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        organ = self.organ
        organ.regions.GetSegmentation().RemoveSegment(organ.regionSegmentId)
        slicer.app.processEvents()
        self.ui.organsTable.item(0, 2).setText("Harnblase")
        self.assertEqual(organ.regions.GetSegmentation().GetNumberOfSegments(), 0)
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertEqual(organ.regions.GetSegmentation().GetNumberOfSegments(), 1)

    def test_voxelsAreFreedWithTheScene(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        freed = []
        self.volume.GetImageData().AddObserver(vtk.vtkCommand.DeleteEvent, lambda caller, event: freed.append(event))
        self.volume = None
        slicer.mrmlScene.Clear()
        # Slice views keep the voxels that they have shown until they show others.
        other = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode")
        slicer.util.updateVolumeFromArray(other, np.zeros((2, 2, 2), dtype=np.int16))
        showInSlices(other)
        slicer.app.processEvents()
        gc.collect()
        self.assertEqual(len(freed), 1)

    def test_anOrganIsRenamedColouredHiddenAndRemoved(self):
        organ = self.fitted("bladder")
        self.ui.organsTable.item(0, 2).setText("Harnblase")
        self.assertEqual((organ.label, organ.surface.GetName()), ("Harnblase", "Harnblase surface"))
        self.ui.organsTable.cellWidget(0, 0).click()
        self.assertFalse(organ.surface.GetDisplayNode().GetVisibility())
        self.ui.organsTable.cellWidget(0, 0).click()
        self.assertTrue(organ.surface.GetDisplayNode().GetVisibility())
        models = slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLModelNode")
        self.ui.removeOrganButton.click()
        self.assertEqual(slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLModelNode"), models - 1)
        self.assertEqual(self.ui.organsTable.rowCount, 0)
        self.assertFalse(self.ui.fitButton.enabled)

    def test_theOrganThatIsChosenIsTheOneThatIsShown(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        self.ui.netRowsSpin.value = 11
        self.add("rectum")
        self.assertEqual(self.ui.netRowsSpin.value, 9)
        self.ui.organsTable.selectRow(0)
        self.assertEqual((self.organ.label, self.ui.netRowsSpin.value), ("bladder", 11))
        self.assertIs(self.ui.seedPlaceWidget.currentNode(), self.organ.seeds)

    def test_clicksDoNotGoToTheOrganBefore(self):
        self.fitted("bladder")
        self.add("rectum")
        self.ui.organsTable.selectRow(0)
        self.assertFalse(self.ui.seedPlaceWidget.placeModeEnabled)
        self.ui.boundaryPlaceWidget.setPlaceModeEnabled(True)
        self.ui.organsTable.selectRow(1)
        self.assertFalse(self.ui.boundaryPlaceWidget.placeModeEnabled)
        self.assertFalse(self.isPlacing())

    def test_clicksPlaceNothingInAListThatIsDeleted(self):
        self.add("bladder")
        self.assertTrue(self.isPlacing())
        slicer.mrmlScene.RemoveNode(self.organ.seeds)
        self.assertFalse(self.isPlacing())
        self.ui.boundaryPlaceWidget.setPlaceModeEnabled(True)
        slicer.mrmlScene.RemoveNode(self.organ.boundaryPoints)
        self.assertFalse(self.isPlacing())

    def test_noPlaceModeIsLeftBehind(self):
        self.add("bladder")
        self.assertTrue(self.ui.seedPlaceWidget.placeModeEnabled)
        self.widget.exit()
        self.assertFalse(self.ui.seedPlaceWidget.placeModeEnabled)
        self.widget.enter()

    def test_whatAScriptChangesIsSeen(self):
        self.add("bladder")
        other = samples.addPhantomVolume()
        # Each has values of its own, and the panel has others.
        organ = next(iter(self.widget.logic.organs()))
        organ.label = "Harnblase"
        self.assertEqual(self.ui.organsTable.item(0, 2).text(), "Harnblase")
        self.widget.logic.getParameterNode().volume = other
        self.assertIs(self.ui.volumeSelector.currentNode(), other)
        self.assertIs(self.panel.separateSection._volume, other)

    def test_whatHappensWhileAnotherModuleIsShownIsSeenAfterwards(self):
        self.add("bladder")
        organ = self.organ
        self.widget.exit()
        self.assertFalse(self.ui.fitButton.enabled)
        organ.seeds.AddControlPointWorld(*self.phantom.seeds["bladder"][0])
        self.assertFalse(self.panel.separateSection.isWaiting)
        organ.netRows = 12
        self.assertEqual(self.ui.organsTable.rowCount, 0)
        self.widget.enter()
        self.assertEqual((self.ui.organsTable.rowCount, self.ui.netRowsSpin.value), (1, 12))
        self.assertTrue(self.ui.fitButton.enabled)
