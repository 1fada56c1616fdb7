"""The panel as it is clicked: runs in Slicer, with and without its main window, and on the stand-ins.

In Slicer: ``Slicer --testing --no-main-window --python-script Testing/Slicer/run.py``.
"""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import qt
import slicer
import vtk

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.mrml import samples
from VICRegistrationLib.mrml.generic_model_nodes import findModel, partsOf
from VICRegistrationLib.mrml.parameters import Loss
from VICRegistrationLib.mrml.surfaces import createModel, showSurface, surfaceFromModel
from VICRegistrationLib.mrml.volumes import showInSlices
from VICRegistrationLib.registration.options import OPTIONS


def waitFor(condition):
    """Let Slicer work until a condition holds."""
    while not condition():
        slicer.app.processEvents()


def clickInSlice(position):
    """Click at a place (world RAS mm) in the red slice view; False where there is none."""
    layoutManager = slicer.app.layoutManager()
    slice_ = layoutManager.sliceWidget("Red") if layoutManager is not None else None
    if slice_ is None:
        return False
    node = slice_.mrmlSliceNode()
    node.JumpSliceByCentering(*position)
    slicer.app.processEvents()
    toView = vtk.vtkMatrix4x4()
    toView.DeepCopy(node.GetXYToRAS())
    toView.Invert()
    x, y = (round(value) for value in toView.MultiplyPoint([*position, 1.0])[:2])
    interactor = slice_.sliceView().interactor()
    for event in ("EnterEvent", "MouseMoveEvent", "LeftButtonPressEvent", "LeftButtonReleaseEvent"):
        interactor.SetEventInformation(x, y, 0, 0, chr(0), 0, None)
        interactor.InvokeEvent(event)
    slicer.app.processEvents()
    return True


def gmshCanBeLoaded():
    """Whether there is a gmsh that works, found out where it cannot do harm."""
    python = shutil.which("PythonSlicer") or sys.executable
    return subprocess.run([python, "-c", "import gmsh"], capture_output=True).returncode == 0


class PanelTestCase(unittest.TestCase):
    """A scene with the synthetic MRI, and the module's panel."""

    def setUp(self):
        slicer.mrmlScene.Clear()
        self.phantom = samples.phantom()
        self.widget = slicer.util.getModuleWidget("VICRegistration")
        self.volume = samples.addPhantomVolume()
        if slicer.app.layoutManager() is not None:
            slicer.util.selectModule("VICRegistration")
        # Modules are not entered without a main window, nor again when they are shown already.
        self.widget.enter()
        self.ui, self.panel = self.widget.ui, self.widget.panel
        self.ui.volumeSelector.setCurrentNode(self.volume)

    def tearDown(self):
        self.panel.stop()
        slicer.mrmlScene.Clear()

    @property
    def organ(self):
        return self.panel.organs.current()

    def add(self, name):
        """Add an organ of a preset."""
        self.ui.presetCombo.setCurrentIndex(self.ui.presetCombo.findText(name))
        self.ui.addOrganButton.click()

    def placeSeeds(self, name, *, count=3):
        """Place seeds as clicks do, and wait for the region."""
        for seed in self.phantom.seeds[name][:count]:
            before = self.organ.seeds.GetNumberOfDefinedControlPoints()
            self.ui.seedPlaceWidget.setPlaceModeEnabled(True)
            if not clickInSlice(seed):
                self.organ.seeds.AddControlPointWorld(*seed)
            self.ui.seedPlaceWidget.setPlaceModeEnabled(False)
            self.assertEqual(self.organ.seeds.GetNumberOfDefinedControlPoints(), before + 1)
        self.waitForRegion()

    def isPlacing(self):
        """Whether clicks into views place points, whoever has asked for that."""
        interaction = slicer.app.applicationLogic().GetInteractionNode()
        return interaction.GetCurrentInteractionMode() == interaction.Place

    def waitForRegion(self):
        waitFor(lambda: not self.panel.separateSection.isWaiting)

    def waitForFit(self):
        waitFor(lambda: not self.panel.fitSection.running)

    def fitted(self, name):
        """Add an organ and fit it."""
        self.add(name)
        self.placeSeeds(name)
        self.ui.fitButton.click()
        self.waitForFit()
        return self.organ

    def regionVoxels(self):
        """Number of voxels of the current organ's segment."""
        organ = self.organ
        mask = slicer.util.arrayFromSegmentBinaryLabelmap(organ.regions, organ.regionSegmentId, self.volume)
        return int(np.count_nonzero(mask))

    def distance(self, organ):
        """Mean distance from the truth, mm."""
        return deviation(surfaceFromModel(organ.surface), self.phantom.surfaces[organ.label], n_points=2000).mean


class SeparateTest(PanelTestCase):
    """Seeds, grey levels, erosion, and the region that follows them."""

    def test_aSeedSuggestsTheGreyLevelsAndShowsTheRegion(self):
        self.add("bladder")
        self.assertIn("seed", self.ui.regionStatusLabel.text)
        self.placeSeeds("bladder", count=1)
        truth = self.phantom.surfaces["bladder"].volume() / 1000.0
        self.assertAlmostEqual(self.organ.volumeMl, truth, delta=0.05 * truth)
        self.assertIn("ml", self.ui.regionStatusLabel.text)
        low, high = self.ui.thresholdRange.minimumValue, self.ui.thresholdRange.maximumValue
        self.assertAlmostEqual(low, self.organ.threshold.minimum, delta=0.5)
        self.assertAlmostEqual(high, self.organ.threshold.maximum, delta=0.5)
        self.assertTrue(400 < low < 850 < high)

    def test_theRegionFollowsTheGreyLevelsAndTheErosion(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        whole = self.regionVoxels()
        range_ = self.ui.thresholdRange
        range_.setValues(900, range_.maximumValue)
        self.waitForRegion()
        self.assertLess(self.regionVoxels(), 0.95 * whole)
        self.ui.suggestButton.click()
        self.waitForRegion()
        self.assertAlmostEqual(self.regionVoxels(), whole, delta=1)
        self.ui.erosionAutomaticCheck.click()
        self.ui.erosionSlider.value = 15.0
        self.waitForRegion()
        self.assertLess(self.regionVoxels(), whole)

    def test_whatIsWrongIsToldInTheStatusLine(self):
        self.add("bladder")
        self.organ.seeds.AddControlPointWorld(1000.0, 0.0, 0.0)
        self.waitForRegion()
        self.assertIn("outside", self.ui.regionStatusLabel.text)
        self.assertEqual(self.organ.surface, None)

    def test_aSegmentThatIsRemovedIsNotReplacedByAnother(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        regions, first = self.organ.regions, self.organ.regionSegmentId
        self.add("vagina")
        self.placeSeeds("vagina")
        self.add("uterus")
        self.ui.sourceCombo.setCurrentIndex(1)
        self.ui.segmentSelector.setCurrentNode(regions)
        self.ui.segmentSelector.setCurrentSegmentID(first)
        self.assertEqual(self.organ.inputSegmentId, first)
        regions.GetSegmentation().RemoveSegment(first)
        slicer.app.processEvents()
        self.assertIn(self.organ.inputSegmentId, ("", first))
        self.ui.fitButton.click()
        self.waitForFit()
        self.assertEqual(self.organ.surface, None)
        self.assertIn("segment", self.ui.fitStatusLabel.text)

    def test_aSegmentIsTakenInstead(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        regions, segmentId, volume = self.organ.regions, self.organ.regionSegmentId, self.organ.volumeMl
        self.add("uterus")
        self.ui.sourceCombo.setCurrentIndex(1)
        self.ui.segmentSelector.setCurrentNode(regions)
        self.ui.segmentSelector.setCurrentSegmentID(segmentId)
        self.waitForRegion()
        self.assertAlmostEqual(self.organ.volumeMl, volume, places=3)
        self.ui.fitButton.click()
        self.waitForFit()
        truth = self.phantom.surfaces["bladder"]
        self.assertLess(deviation(surfaceFromModel(self.organ.surface), truth, n_points=2000).mean, 0.3)


class FitTest(PanelTestCase):
    """Fitting, cancelling, and what may happen meanwhile."""

    def test_organsAreFittedNextToEachOther(self):
        for name in ("bladder", "vagina", "rectum"):
            self.add(name)
            self.placeSeeds(name)
        self.ui.fitAllButton.click()
        self.waitForFit()
        self.assertEqual([organ.label for organ in self.panel.organs], ["bladder", "vagina", "rectum"])
        for row, organ in enumerate(self.panel.organs):
            self.assertLess(self.distance(organ), 0.3)
            self.assertEqual(self.ui.organsTable.item(row, 3).text(), f"{organ.volumeMl:.1f}")
        self.assertEqual(self.ui.progressBar.value, 100)
        self.assertIn("iterations", self.ui.fitStatusLabel.text)
        self.add("uterus")
        self.assertEqual((self.ui.progressBar.value, self.ui.fitStatusLabel.text), (0, ""))

    def test_cancelBringsTheSurfaceBack(self):
        organ = self.fitted("bladder")
        before = surfaceFromModel(organ.surface).control_net
        self.ui.netAutomaticCheck.checked = False
        self.ui.netRowsSpin.value = 13
        self.ui.fitButton.click()
        slicer.app.processEvents()
        self.assertTrue(self.ui.cancelButton.enabled)
        self.ui.cancelButton.click()
        self.waitForFit()
        np.testing.assert_array_equal(surfaceFromModel(organ.surface).control_net, before)
        self.assertIn("Cancelled", self.ui.fitStatusLabel.text)

    def test_theFirstFitIsCancelledWithoutATrace(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        self.ui.fitButton.click()
        self.ui.cancelButton.click()
        self.waitForFit()
        self.assertEqual(self.organ.surface, None)
        self.assertTrue(self.ui.fitButton.enabled)

    def test_theVolumeGoesMeanwhile(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        self.ui.fitButton.click()
        slicer.app.processEvents()
        slicer.mrmlScene.RemoveNode(self.volume)
        self.waitForFit()
        self.assertFalse(self.ui.fitButton.enabled)

    def test_theSceneIsClosedMeanwhile(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        self.ui.fitButton.click()
        slicer.app.processEvents()
        slicer.mrmlScene.Clear()
        self.waitForFit()
        self.assertEqual(len(self.panel.organs), 0)
        self.assertEqual(self.ui.organsTable.rowCount, 0)

    def test_anotherModuleIsChosenMeanwhile(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        self.ui.fitButton.click()
        organ = self.organ
        self.widget.exit()
        self.waitForFit()
        self.widget.enter()
        self.assertLess(self.distance(self.panel.organs.of(organ.parameterNode)), 0.3)

    def test_asPublished(self):
        self.add("bladder")
        self.ui.asPublishedButton.click()
        self.assertEqual(self.organ.solver.value, "gradient-descent")
        self.assertEqual((self.organ.closure.value, self.organ.stopping.value), ("paper", "published"))
        self.assertEqual((self.organ.options().smoothness, self.organ.options().net), (0.0, (9, 7)))
        self.assertTrue(self.ui.netRowsSpin.enabled and self.ui.smoothnessSlider.enabled)
        self.ui.defaultsButton.click()
        self.assertEqual(self.organ.solver.value, "gauss-newton")
        self.assertTrue(self.ui.netAutomaticCheck.checked and self.ui.smoothnessAutomaticCheck.checked)
        self.assertFalse(self.ui.netRowsSpin.enabled or self.ui.netColumnsSpin.enabled)
        self.assertFalse(self.ui.smoothnessSlider.enabled)
        self.assertEqual((self.organ.options().net, self.organ.options().smoothness), (None, None))

    def test_optionsAreLabelledFromTheirTable(self):
        for widget, name in (("tauSlider", "tau"), ("netColumnsSpin", "net"), ("erosionSlider", "erosion")):
            self.assertIn(OPTIONS[name].help, getattr(self.ui, widget).toolTip)
        self.assertIn(OPTIONS["tau"].automatic, self.ui.tauAutomaticCheck.toolTip)
        labels = {name: getattr(self.ui, f"{name}Label").text for name in ("net", "maxIterations", "boundaryWeight")}
        self.assertEqual(
            labels,
            {"net": "Control net:", "maxIterations": "Iteration limit:", "boundaryWeight": "Weight of points:"},
        )

    def test_theRangesAreThoseOfTheOptions(self):
        self.add("bladder")
        for widget, name in (("tauSlider", "tau"), ("netRowsSpin", "net"), ("boundaryWeightSlider", "boundary_weight")):
            shown = getattr(self.ui, widget)
            self.assertEqual((shown.minimum, shown.maximum), OPTIONS[name].limits)
        self.organ.loss = Loss.HUBER
        self.assertEqual(self.ui.lossCombo.currentText, OPTIONS["loss"].choices["huber"])

    def test_theFitShowsWhatItHasChosen(self):
        organ = self.fitted("bladder")
        self.assertEqual((self.ui.netRowsSpin.value, self.ui.netColumnsSpin.value), (organ.netRows, organ.netColumns))
        self.assertAlmostEqual(self.ui.tauSlider.value, organ.tauMm, places=2)
        self.assertIn(f"net {organ.netRows}x{organ.netColumns}", self.ui.fitStatusLabel.text)

    def test_theConvergenceIsPlotted(self):
        organ = self.fitted("rectum")
        self.ui.convergenceCheck.click()
        self.assertTrue(organ.plot.GetNumberOfPlotSeriesNodes() == 1)
        self.assertEqual(organ.convergence.GetNumberOfRows(), int(organ.message.split()[0]))

    def test_theVerdictIsShownInTheTable(self):
        organ = self.fitted("bladder")
        self.assertEqual(organ.verdict, "good")
        item = self.ui.organsTable.item(0, 4)
        self.assertIn("good", item.toolTip())
        self.assertIsNotNone(item.data(qt.Qt.DecorationRole))
        organ.verdict, organ.verdictReasons = "poor", "the surface follows no edge"
        self.assertIn("no edge", item.toolTip())

    def test_theFillsOfFittedOrgansAreHidden(self):
        for name in ("bladder", "vagina"):
            self.add(name)
            self.placeSeeds(name)
        self.ui.fitAllButton.click()
        self.waitForFit()
        for organ in self.panel.organs:
            self.assertFalse(organ.regions.GetDisplayNode().GetSegmentVisibility(organ.regionSegmentId))
        self.assertFalse(self.ui.previewCheck.checked)

    def test_aNewOrganIsFittedAtOnce(self):
        self.ui.fitAtOnceCheck.checked = True
        try:
            self.add("bladder")
            self.placeSeeds("bladder", count=1)
            self.waitForFit()
            self.assertLess(self.distance(self.organ), 0.3)
            surface = surfaceFromModel(self.organ.surface).control_net
            # Only the first region of a new organ: changes of the grey levels are looked at before they are fitted.
            self.ui.erosionAutomaticCheck.click()
            self.ui.erosionSlider.value = 4.0
            self.waitForRegion()
            self.assertFalse(self.panel.fitSection.running)
            np.testing.assert_array_equal(surfaceFromModel(self.organ.surface).control_net, surface)
        finally:
            self.ui.fitAtOnceCheck.checked = False

    def test_the3dViewsAreFocusedOnTheFirstSurfaceOnly(self):
        self.fitted("bladder")
        self.assertEqual(self.volume.GetAttribute("VIC.focused"), "1")
        layoutManager = slicer.app.layoutManager()
        if layoutManager is None:
            return
        camera = layoutManager.threeDWidget(0).threeDView().cameraNode()
        before = camera.GetPosition()
        self.fitted("vagina")
        self.assertEqual(camera.GetPosition(), before)


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
        """Add the same voxels once more, displaced."""
        matrix = vtk.vtkMatrix4x4()
        self.volume.GetIJKToRASMatrix(matrix)
        for axis in range(3):
            matrix.SetElement(axis, 3, matrix.GetElement(axis, 3) + shift[axis])
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", name)
        node.SetIJKToRASMatrix(matrix)
        voxels = vtk.vtkImageData()
        voxels.DeepCopy(self.volume.GetImageData())
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
        self.assertIn(f"used, moved {moved.split(' mm')[0]} mm", self.table.item(0, 1).toolTip())
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
        composite = slicer.mrmlScene.GetFirstNodeByClass("vtkMRMLSliceCompositeNode")
        if composite is None:
            composite = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSliceCompositeNode")
            composite.SetLayoutName("Red")
            slicer.mrmlScene.AddNewNodeByClass("vtkMRMLViewNode")
            slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSliceNode").SetLayoutName("Red")
            slicer.app.processEvents()
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
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "scene.mrb")
            self.assertTrue(slicer.util.saveScene(path))
            slicer.mrmlScene.Clear()
            self.assertEqual(self.table.rowCount, 0)
            slicer.util.loadScene(path)
        waitFor(lambda: self.table.rowCount == 1)
        self.assertEqual((self.check().text, self.check().checked), ("AX", True))
        self.assertEqual(self.table.item(0, 1).text(), text)
        self.assertEqual(len(self.organ.contours()), 1)


class SizeTest(PanelTestCase):
    """The panel stays as narrow as Slicer's own modules."""

    SECTIONS = ("inputs", "separate", "fit", "correct", "export", "compare", "model", "advanced")

    def assertNarrow(self):
        slicer.app.processEvents()
        for name in self.SECTIONS:
            hint = getattr(self.ui, f"{name}Section").minimumSizeHint
            if hint is None:
                self.skipTest("widgets have no size outside of Slicer")
            self.assertLess(hint.width(), 480, name)

    def test_itStaysNarrowWithOrgansAndLongMessages(self):
        self.assertNarrow()
        self.fitted("bladder")
        self.assertNarrow()
        self.panel.organs.rename(self.organ, "a bladder with a name that nobody would type " * 3)
        self.organ.message = "\n".join(["a message that is far longer than the panel is wide " * 3] * 2)
        self.volume.SetName("a volume with a long name, as DICOM descriptions have them " * 3)
        self.panel.refresh()
        self.assertNarrow()

    def test_itStaysNarrowWithStacksAndTheGenericModel(self):
        stack = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "a stack with a long name " * 5)
        stack.SetAndObserveImageData(self.volume.GetImageData())
        waitFor(lambda: self.ui.furtherStacksTable.rowCount == 1)
        self.add("bladder")
        self.panel.organs.rename(self.organ, "a bladder with a name that nobody would type " * 3)
        self.ui.modelSection.collapsed = False
        self.ui.newLandmarksButton.click()
        self.assertNarrow()
        self.ui.modelSection.collapsed = True


class CorrectTest(PanelTestCase):
    """Boundary points."""

    def test_theSurfaceIsPulledToAPoint(self):
        organ = self.fitted("bladder")
        surface, before = surfaceFromModel(organ.surface), self.distance(organ)
        (u_low, u_high), (v_low, v_high) = surface.domain
        u, v = [0.3 * u_low + 0.7 * u_high], [0.5 * v_low + 0.5 * v_high]
        (point,) = surface.points(u, v) + 5.0 * surface.normals(u, v)
        organ.boundaryPoints.AddControlPointWorld(*point)
        self.assertEqual(self.ui.boundaryTable.rowCount, 1)
        self.assertAlmostEqual(float(self.ui.boundaryTable.item(0, 1).text()), 5.0, delta=0.1)
        self.assertIn("up to 5.0 mm", self.ui.correctStatusLabel.text)
        self.add("uterus")
        self.assertEqual(self.ui.correctStatusLabel.text, "")
        self.ui.organsTable.selectRow(0)
        self.ui.refitButton.click()
        self.waitForFit()
        self.assertLess(abs(float(self.ui.boundaryTable.item(0, 1).text())), 0.5)
        self.ui.undoPointButton.click()
        self.assertEqual(self.ui.boundaryTable.rowCount, 0)
        self.ui.refitButton.click()
        self.waitForFit()
        self.assertAlmostEqual(self.distance(organ), before, delta=0.02)
        self.assertEqual(surfaceFromModel(organ.surface).control_net.shape, surface.control_net.shape)


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
        self.assertIn("No folder", self.ui.modelStatusLabel.text)
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
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "scene.mrb")
            self.assertTrue(slicer.util.saveScene(path))
            slicer.mrmlScene.Clear()
            self.assertEqual(self.ui.modelStatusLabel.text, "")
            self.assertFalse(self.ui.modelSection.enabled or self.ui.exportModelButton.enabled)
            self.assertEqual(self.ui.landmarksPlacedLabel.text, "")
            slicer.util.loadScene(path)
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


class SceneTest(PanelTestCase):
    """What is saved, loaded, renamed and removed."""

    def test_aSavedSceneComesBack(self):
        organ = self.fitted("rectum")
        self.ui.erosionAutomaticCheck.click()
        self.ui.erosionSlider.value = 1.5
        self.waitForRegion()
        net, message = surfaceFromModel(organ.surface).control_net, organ.message
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "scene.mrb")
            self.assertTrue(slicer.util.saveScene(path))
            slicer.mrmlScene.Clear()
            self.assertEqual(self.ui.organsTable.rowCount, 0)
            slicer.util.loadScene(path)
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
