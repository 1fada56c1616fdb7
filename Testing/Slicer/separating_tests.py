"""Separating an organ, correcting it by points, and the panel's width."""

from __future__ import annotations

import numpy as np
import slicer
from panel_case import PanelTestCase, waitFor

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.mrml.surfaces import surfaceFromModel


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

    def test_voxelsThatAreNoNumbersAreTold(self):
        levels = np.zeros((20, 20, 20), dtype=np.float32)
        levels[5:15, 5:15, 5:15] = 100.0
        levels[0, 0, :2] = np.inf, np.nan
        volume = slicer.util.addVolumeFromArray(levels)
        self.ui.volumeSelector.setCurrentNode(volume)
        self.add("bladder")
        self.assertEqual(self.ui.thresholdRange.maximum, 100.0)
        self.organ.seeds.AddControlPointWorld(10.0, 10.0, 10.0)
        self.waitForRegion()
        self.assertIn("2 of the image's 8000 voxels are not finite", self.ui.regionStatusLabel.text)

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

    def test_theRegionThatTheUserHasEditedIsChosen(self):
        self.add("bladder")
        self.placeSeeds("bladder")
        regions, segmentId = self.organ.regions, self.organ.regionSegmentId
        mask = slicer.util.arrayFromSegmentBinaryLabelmap(regions, segmentId, self.volume).copy()
        mask[:, :, int(np.argwhere(mask)[:, 2].mean()) :] = 0
        slicer.util.updateSegmentBinaryLabelmapFromArray(mask, regions, segmentId, self.volume)
        self.ui.sourceCombo.setCurrentIndex(1)
        self.waitForRegion()
        self.assertIn("No segment is chosen", self.ui.regionStatusLabel.text)
        self.ui.segmentSelector.setCurrentNode(regions)
        self.ui.segmentSelector.setCurrentSegmentID(segmentId)
        self.waitForRegion()
        self.assertEqual(self.regionVoxels(), np.count_nonzero(mask))


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
