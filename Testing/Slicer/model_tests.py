"""The generic model of several organs."""

from __future__ import annotations

import os
import tempfile

import slicer
from panel_case import PanelTestCase, gmshCanBeLoaded, waitFor

from VICRegistrationLib.mrml import samples
from VICRegistrationLib.mrml.generic_model_nodes import findModel, partsOf


class ModelTest(PanelTestCase):
    """The generic model: its organs, landmarks, fit, colours and files."""

    def setUp(self):
        super().setUp()
        for name in ("bladder", "vagina"):
            self.add(name)
            self.placeSeeds(name)
        self.ui.modelSection.collapsed = False

    def tearDown(self):
        self.ui.modelSection.collapsed = True
        super().tearDown()

    def choice(self, name):
        """Combo box of an organ of the model."""
        table = self.ui.modelOrgansTable
        row = next(row for row in range(table.rowCount) if table.item(row, 0).text() == name)
        return table.cellWidget(row, 1)

    def waitForModel(self):
        waitFor(lambda: not self.panel.modelSection.running)

    def fitModel(self):
        self.ui.fitModelButton.click()
        self.waitForModel()

    def parts(self):
        return {node.GetName(): node for node in partsOf(self.volume)}

    def test_itsOrgansAreThoseOfTheTableWithTheirNames(self):
        self.assertEqual(self.ui.modelOrgansTable.rowCount, 3)
        names = {name: self.choice(name).currentText for name in ("bladder", "vagina", "rectum")}
        self.assertEqual(names, {"bladder": "bladder", "vagina": "vagina", "rectum": "predict"})
        self.assertFalse(self.ui.exportModelButton.enabled or self.ui.patchColorCheck.enabled)

    def test_anOrganIsChosenForAnother(self):
        choice = self.choice("rectum")
        choice.setCurrentIndex(choice.findText("vagina"))
        self.assertEqual(self.choice("rectum").currentText, "vagina")
        self.assertEqual(self.choice("vagina").currentText, "predict")
        self.panel.organs.rename(self.organ, "colon")
        self.panel.refresh()
        self.assertEqual(self.choice("rectum").currentText, "colon")

    def test_theModelIsFittedColouredAndWritten(self):
        self.fitModel()
        self.assertTrue({"bladder", "vagina", "rectum (predicted)", "levator ani (estimated)"} < set(self.parts()))
        self.assertIn("Model fitted to bladder, vagina", self.ui.modelStatusLabel.text)
        self.ui.patchColorCheck.click()
        self.assertTrue(self.parts()["bladder"].GetDisplayNode().GetScalarVisibility())
        self.ui.patchColorCheck.click()
        self.assertFalse(self.parts()["bladder"].GetDisplayNode().GetScalarVisibility())
        self.ui.modelFolderEdit.currentPath = ""
        self.ui.exportModelButton.click()
        self.assertIn("Choose a folder", self.ui.modelStatusLabel.text)
        with tempfile.TemporaryDirectory() as folder:
            self.ui.modelFolderEdit.currentPath = folder
            self.ui.exportModelButton.click()
            self.assertIn("Written", self.ui.modelStatusLabel.text)
            self.assertTrue({"model.json", "model.step", "model.vtp"} < set(os.listdir(folder)))

    def test_aMeshIsWrittenToo(self):
        if not gmshCanBeLoaded():
            self.skipTest("gmsh is not installed, or lacks a library of the system")
        self.fitModel()
        self.ui.modelMeshCombo.setCurrentIndex(self.ui.modelMeshCombo.findData(".inp"))
        # Nothing is visible without the main window.
        self.assertFalse(self.ui.modelMeshSizeSlider.isHidden())
        self.ui.modelMeshSizeSlider.value = 8.0
        with tempfile.TemporaryDirectory() as folder:
            self.ui.modelFolderEdit.currentPath = folder
            self.ui.exportModelButton.click()
            self.assertTrue(self.ui.cancelModelButton.enabled)
            waitFor(lambda: not self.ui.cancelModelButton.enabled)
            self.assertTrue({"model.json", "model.inp"} < set(os.listdir(folder)))
        self.assertIn("model.inp", self.ui.modelStatusLabel.text)
        self.assertIn("tetrahedra", self.ui.modelStatusLabel.text)
        self.ui.modelMeshCombo.setCurrentIndex(0)

    def test_cancelLeavesTheEarlierResult(self):
        self.fitModel()
        text = findModel(self.volume).GetText()
        self.ui.fitModelButton.click()
        slicer.app.processEvents()
        self.assertFalse(self.ui.fitModelButton.enabled or self.ui.fitButton.enabled)
        self.ui.cancelModelButton.click()
        self.waitForModel()
        self.assertIn("Cancelled", self.ui.modelStatusLabel.text)
        self.assertEqual(findModel(self.volume).GetText(), text)
        self.assertTrue(self.ui.fitModelButton.enabled and self.ui.fitButton.enabled)

    def test_anOrganGoesMeanwhile(self):
        self.ui.fitModelButton.click()
        slicer.app.processEvents()
        self.ui.removeOrganButton.click()
        self.waitForModel()
        self.assertIn("was deleted", self.ui.modelStatusLabel.text)
        self.assertEqual(self.parts(), {})
        self.fitModel()
        self.assertIn("at least 2 are needed", self.ui.modelStatusLabel.text)

    def test_theSceneIsClosedMeanwhile(self):
        self.ui.fitModelButton.click()
        slicer.app.processEvents()
        slicer.mrmlScene.Clear()
        self.waitForModel()
        self.assertFalse(self.ui.modelSection.enabled)

    def test_aSavedSceneComesBackWithItsModel(self):
        self.ui.newLandmarksButton.click()
        self.ui.landmarkPlaceWidget.setPlaceModeEnabled(False)
        landmarks = self.ui.modelLandmarksSelector.currentNode().GetName()
        self.fitModel()
        self.ui.patchColorCheck.click()
        text, parts, told = findModel(self.volume).GetText(), set(self.parts()), self.ui.modelStatusLabel.text
        with self.savedAndLoaded():
            self.assertEqual(self.ui.modelStatusLabel.text, "")
            self.assertFalse(self.ui.modelSection.enabled or self.ui.exportModelButton.enabled)
            self.assertEqual(self.ui.landmarksPlacedLabel.text, "")
        self.volume = self.ui.volumeSelector.currentNode()
        self.assertEqual((findModel(self.volume).GetText(), set(self.parts())), (text, parts))
        self.assertEqual(self.ui.modelStatusLabel.text, told)
        self.assertTrue(self.ui.patchColorCheck.checked and self.ui.exportModelButton.enabled)
        self.assertEqual(self.ui.modelLandmarksSelector.currentNode().GetName(), landmarks)

    def test_theVolumeGoesMeanwhile(self):
        self.ui.fitModelButton.click()
        slicer.app.processEvents()
        slicer.mrmlScene.RemoveNode(self.volume)
        self.waitForModel()
        self.assertIn("was deleted", self.ui.modelStatusLabel.text)
        self.assertFalse(self.ui.modelSection.enabled)

    def test_eachVolumeHasAModelOfItsOwn(self):
        self.fitModel()
        told, first = self.ui.modelStatusLabel.text, self.volume
        self.ui.volumeSelector.setCurrentNode(samples.addPhantomVolume())
        self.assertEqual(self.ui.modelStatusLabel.text, "")
        self.assertFalse(self.ui.exportModelButton.enabled or self.ui.patchColorCheck.enabled)
        self.ui.volumeSelector.setCurrentNode(first)
        self.assertEqual(self.ui.modelStatusLabel.text, told)

    def test_landmarksArePlacedByTheirNames(self):
        self.ui.newLandmarksButton.click()
        node = self.ui.modelLandmarksSelector.currentNode()
        self.assertEqual(node.GetNumberOfControlPoints(), 6)
        self.assertTrue(self.ui.landmarkPlaceWidget.placeModeEnabled)
        self.assertIn(f"0 of 6 placed; next: {node.GetNthControlPointLabel(0)}", self.ui.landmarksPlacedLabel.text)
        node.SetNthControlPointPositionWorld(0, 0.0, 58.0, -44.0)
        self.assertIn(f"1 of 6 placed; next: {node.GetNthControlPointLabel(1)}", self.ui.landmarksPlacedLabel.text)
        slicer.mrmlScene.RemoveNode(node)
        self.assertEqual(self.ui.modelLandmarksSelector.currentNode(), None)
        self.assertFalse(self.ui.landmarkPlaceWidget.enabled or self.ui.landmarkPlaceWidget.placeModeEnabled)
        self.assertEqual(self.ui.landmarksPlacedLabel.text, "")

    def test_aLandmarkIsSkippedOrTakenBack(self):
        self.ui.newLandmarksButton.click()
        node, label = self.ui.modelLandmarksSelector.currentNode(), self.ui.landmarksPlacedLabel
        first, second = (node.GetNthControlPointLabel(index) for index in range(2))
        self.ui.skipLandmarkButton.click()
        self.assertIn(f"0 of 6 placed, 1 skipped; next: {second}", label.text)
        node.SetNthControlPointPositionWorld(1, 0.0, 58.0, -44.0)
        self.assertIn("1 of 6 placed, 1 skipped", label.text)
        takeBack = self.ui.landmarkPlaceWidget.deleteButton()
        self.assertFalse(takeBack.isHidden())
        takeBack.click()
        self.assertIn(f"0 of 6 placed, 1 skipped; next: {second}", label.text)
        takeBack.click()
        self.assertIn(f"0 of 6 placed; next: {first}", label.text)
        for _ in range(6):
            self.assertTrue(self.ui.landmarkPlaceWidget.placeModeEnabled)
            self.ui.skipLandmarkButton.click()
        self.assertIn("0 of 6 placed, 6 skipped", label.text)
        self.assertFalse(self.ui.skipLandmarkButton.enabled or self.ui.landmarkPlaceWidget.placeModeEnabled)

    def test_clicksDoNotGoToTheListBefore(self):
        self.ui.newLandmarksButton.click()
        self.assertTrue(self.isPlacing())
        self.ui.modelLandmarksSelector.setCurrentNode(None)
        self.assertFalse(self.isPlacing())
        self.assertFalse(self.ui.skipLandmarkButton.enabled)

    def test_aModelInAFileIsChosen(self):
        combo = self.ui.genericModelCombo
        combo.setCurrentIndex(combo.count - 1)
        self.assertFalse(self.ui.modelFileEdit.isHidden())
        self.ui.modelFileEdit.currentPath = os.path.join(tempfile.gettempdir(), "no model.json")
        self.assertIn("choose a model file that exists", self.ui.modelStatusLabel.text)
        self.assertEqual(self.ui.modelOrgansTable.rowCount, 0)
        combo.setCurrentIndex(0)
        self.assertEqual(self.ui.modelOrgansTable.rowCount, 3)
