"""A scene and a panel for tests that click: in Slicer, with and without its main window, and on the stand-ins.

In Slicer: ``Slicer --testing --no-main-window --python-script Testing/Slicer/run.py``.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import slicer
import vtk

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.mrml import samples
from VICRegistrationLib.mrml.surfaces import surfaceFromModel


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
    return subprocess.run([sys.executable, "-c", "import gmsh"], capture_output=True).returncode == 0


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
        # It is remembered.
        self.ui.fitAtOnceCheck.checked = False
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

    def sliceComposite(self):
        """What says which volume a slice view shows; made where there is no main window, with views for it."""
        composite = slicer.mrmlScene.GetFirstNodeByClass("vtkMRMLSliceCompositeNode")
        if composite is None:
            composite = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSliceCompositeNode")
            composite.SetLayoutName("Red")
            slicer.mrmlScene.AddNewNodeByClass("vtkMRMLViewNode")
            slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSliceNode").SetLayoutName("Red")
            slicer.app.processEvents()
        return composite

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

    @contextlib.contextmanager
    def savedAndLoaded(self):
        """Save the scene and close it, and load it again after the block."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "scene.mrb")
            self.assertTrue(slicer.util.saveScene(path))
            slicer.mrmlScene.Clear()
            yield
            slicer.util.loadScene(path)

    def regionVoxels(self):
        """Number of voxels of the current organ's segment."""
        organ = self.organ
        mask = slicer.util.arrayFromSegmentBinaryLabelmap(organ.regions, organ.regionSegmentId, self.volume)
        return int(np.count_nonzero(mask))

    def distance(self, organ):
        """Mean distance from the truth, mm."""
        return deviation(surfaceFromModel(organ.surface), self.phantom.surfaces[organ.label], n_points=2000).mean
