"""The section that fits."""

from __future__ import annotations

import numpy as np
import qt
import slicer
from panel_case import PanelTestCase

from VICRegistrationLib.mrml.parameters import Loss
from VICRegistrationLib.mrml.surfaces import surfaceFromModel
from VICRegistrationLib.registration.options import OPTIONS


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

    def test_aNewOrganThatWaitsIsNotFittedAfterCancelOrClosing(self):
        self.ui.fitAtOnceCheck.checked = True
        for end in (self.ui.cancelButton.click, slicer.mrmlScene.Clear):
            for name in ("bladder", "vagina"):
                self.add(name)
                self.organ.seeds.AddControlPointWorld(*self.phantom.seeds[name][0])
                self.panel.separateSection.separate()
            self.assertTrue(self.panel.fitSection.running)
            end()
            self.waitForFit()
            slicer.app.processEvents()
            self.assertFalse(self.panel.fitSection.running)
            self.assertNotIn("needed", self.ui.fitStatusLabel.text)
            self.assertFalse([organ for organ in self.panel.organs if organ.surface is not None])

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
        self.assertIn(f" {organ.convergence.GetNumberOfRows()} iterations", organ.message)

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

    def test_anOrganThatIsRemovedWhileItWaitsIsNotFitted(self):
        for name in ("bladder", "vagina"):
            self.add(name)
            self.placeSeeds(name)
        self.ui.fitAllButton.click()
        self.ui.removeOrganButton.click()
        self.waitForFit()
        self.assertEqual([organ.label for organ in self.panel.organs], ["bladder"])
        self.assertIn("bladder: ", self.ui.fitStatusLabel.text)
        self.assertTrue(self.ui.fitButton.enabled)

    def test_newOrgansAreFittedOneAfterTheOther(self):
        self.ui.fitAtOnceCheck.checked = True
        self.add("bladder")
        self.placeSeeds("bladder", count=1)
        self.add("vagina")
        self.organ.seeds.AddControlPointWorld(*self.phantom.seeds["vagina"][0])
        # As after the delay, which the first fit may not outlast.
        self.panel.separateSection.separate()
        self.assertTrue(self.panel.fitSection.running)
        self.add("rectum")
        self.assertTrue(self.isPlacing())
        self.waitForFit()
        self.assertTrue(self.isPlacing())
        self.assertEqual([organ.surface is not None for organ in self.panel.organs], [True, True, False])

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
