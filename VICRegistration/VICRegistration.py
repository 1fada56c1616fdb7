"""Slicer module of VICRegistration: organs of an MRI as smooth B-spline surfaces."""

from __future__ import annotations

import contextlib
import sys

import slicer
from slicer.i18n import tr as _
from slicer.i18n import translate
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleTest,
    ScriptedLoadableModuleWidget,
)
from slicer.util import VTKObservationMixin

from VICRegistrationLib.mrml import colors, comparing, fitting, references, samples, separating, surfaces, volumes
from VICRegistrationLib.mrml.organ_nodes import boundaryPointsOf, modelOf, seedsOf, volumeOf
from VICRegistrationLib.mrml.organs import Organs
from VICRegistrationLib.mrml.parameters import ModuleParameters, RegionSource
from VICRegistrationLib.mrml.points import addPoints


class VICRegistration(ScriptedLoadableModule):
    """What Slicer shows about the module."""

    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        self.parent.title = _("VIC Registration")
        self.parent.categories = [translate("qSlicerAbstractCoreModule", "Segmentation")]
        # Slicer must load these first: classes of theirs are used when this file is imported.
        self.parent.dependencies = ["Markups", "Models", "Plots", "Segmentations", "SubjectHierarchy", "Tables"]
        self.parent.contributors = ["VICRegistration contributors"]
        self.parent.helpText = _(
            "Fits one smooth closed B-spline surface per organ to a magnetic resonance image, "
            "by virtual image correlation. For research only, not for clinical use."
        )
        self.parent.acknowledgementText = _(
            "The method is that of Z. Jiang, O. Mayeur, J.-F. Witz, P. Lecomte-Grosbras, J. Dequidt, "
            "M. Cosson, C. Duriez and M. Brieu: Virtual image correlation of magnetic resonance images for "
            "3D geometric modelling of pelvic organs. Strain 55(3):e12305, 2019. doi:10.1111/str.12305"
        )
        slicer.app.connect("startupCompleted()", registerSampleData)


def registerSampleData():
    """Offer the synthetic pelvic MRI in the module Sample Data."""
    import SampleData

    for source in samples.sources():
        SampleData.SampleDataLogic.registerCustomSampleDataSource(**source)


class VICRegistrationWidget(ScriptedLoadableModuleWidget, VTKObservationMixin):
    """Opens and closes the panel with the module and the scene."""

    def __init__(self, parent=None):
        VTKObservationMixin.__init__(self)
        self.logic = self.panel = self.ui = None
        self._reopen = False
        # Last, because without a parent it calls setup at once.
        ScriptedLoadableModuleWidget.__init__(self, parent)

    def setup(self):
        """Build the panel."""
        from VICRegistrationLib.gui.panel import Panel

        ScriptedLoadableModuleWidget.setup(self)
        widget = slicer.util.loadUI(self.resourcePath("UI/VICRegistration.ui"))
        self.layout.addWidget(widget)
        self.ui = slicer.util.childWidgetVariables(widget)
        widget.setMRMLScene(slicer.mrmlScene)
        self.logic = VICRegistrationLogic()
        self.panel = Panel(self.ui, self.logic)
        scene = slicer.mrmlScene
        for event in (scene.StartCloseEvent, scene.StartImportEvent):
            self.addObserver(scene, event, self.onSceneGoes)
        for event in (scene.EndCloseEvent, scene.EndImportEvent):
            self.addObserver(scene, event, self.onSceneCame)
        # Slicer does not call enter after a reload, nor for a panel that a script asks for.
        self.panel.open()

    def enter(self):
        """Follow the scene while the module is shown."""
        self.panel.open()

    def exit(self):
        """Follow the scene no longer; a fit under way goes on."""
        self.panel.close()

    def cleanup(self):
        """Stop the panel and remove observers."""
        if self.panel is not None:
            self.panel.stop()
        self.removeObservers()

    def onReload(self):
        """Reload the library with the module."""
        for name in [name for name in sys.modules if name.split(".")[0] == "VICRegistrationLib"]:
            del sys.modules[name]
        ScriptedLoadableModuleWidget.onReload(self)

    def onSceneGoes(self, caller=None, event=None):
        """Stop the panel before the scene is closed or another one is imported."""
        self._reopen = self._reopen or self.panel.isOpen
        self.panel.stop()

    def onSceneCame(self, caller=None, event=None):
        """Open the panel for the scene as it is now."""
        if self._reopen:
            self._reopen = False
            self.panel.open()


class VICRegistrationLogic(ScriptedLoadableModuleLogic):
    """Separates, fits and corrects organs of the scene; scripts and the panel share the same organs."""

    def getParameterNode(self):
        """Parameters of the module.

        Returns
        -------
        VICRegistrationLib.mrml.parameters.ModuleParameters
        """
        return ModuleParameters(ScriptedLoadableModuleLogic.getParameterNode(self))

    def organs(self):
        """Organs of the scene.

        Returns
        -------
        VICRegistrationLib.mrml.organs.Organs
            Can be iterated; adds, renames and removes organs.
        """
        return Organs(self.getParameterNode())

    def addOrgan(
        self, volumeNode, seeds=None, thresholds=None, *, name="organ", erosion=None, dilation=None, segment=None
    ):
        """Add an organ and separate it.

        Parameters
        ----------
        volumeNode : vtkMRMLScalarVolumeNode
        seeds : (n, 3) array_like or vtkMRMLMarkupsFiducialNode, optional
            Points in the organ, world RAS mm. Not needed with `segment`.
        thresholds : (low, high), optional
            Grey levels of the organ; suggested from the seeds if not given.
        name : str
        erosion : float, optional
            Depth of erosion that cuts bridges to neighbours, mm; automatic if not given.
        dilation : float, optional
            Depth by which the region grows back, mm; as the erosion if not given.
        segment : (vtkMRMLSegmentationNode, str), optional
            Segmentation and ID of a segment, to be used instead of seeds and thresholds.

        Returns
        -------
        VICRegistrationLib.mrml.parameters.OrganParameters

        Raises
        ------
        ValueError
            If the organ cannot be separated; nothing is added then.
        """
        with self._added(
            volumeNode, seeds, thresholds, name=name, erosion=erosion, dilation=dilation, segment=segment
        ) as organ:
            separating.separateOrgan(organ, volumeNode)
        return organ

    def fit(
        self,
        volumeNode,
        seeds=None,
        thresholds=None,
        *,
        options=None,
        boundaryPoints=None,
        further=(),
        onStep=None,
        **rest,
    ):
        """Add an organ, separate it, and fit a surface to it.

        Parameters
        ----------
        volumeNode, seeds, thresholds, **rest
            As for :meth:`addOrgan`.
        options : VICRegistrationLib.registration.options.FitOptions, optional
            Options of the fit; those of the separation are the other parameters.
        boundaryPoints : (n, 3) array_like, optional
            Points that the surface is to pass through, world RAS mm.
        further : sequence of vtkMRMLScalarVolumeNode
            Further stacks of the patient, which the surface is fitted to as well.
        onStep : callable, optional
            Called with every step.

        Returns
        -------
        VICRegistrationLib.mrml.parameters.OrganParameters
            Its `surface` is the model node and `convergence` a table; `volumeMl` and `message` have the result.

        Raises
        ------
        ValueError
            If the organ cannot be separated or fitted; nothing is added then.
        """
        from VICRegistrationLib.registration.steps import finish

        with self._added(volumeNode, seeds, thresholds, **rest) as made:
            if options is not None:
                made.setFitOptions(options)
            addPoints(boundaryPointsOf(made, volumeNode), boundaryPoints)
            finish(fitting.fitSteps(made, volumeNode, further), onStep)
            self.getParameterNode().furtherStacks = list(further)
        return made

    def refit(self, organ, boundaryPoints=None, *, onStep=None):
        """Fit an organ again from the surface it has, through its boundary points.

        Parameters
        ----------
        organ : VICRegistrationLib.mrml.parameters.OrganParameters
        boundaryPoints : (n, 3) array_like, optional
            Points to add, world RAS mm.
        onStep : callable, optional

        Returns
        -------
        (n,) ndarray
            Distances of all boundary points from the new surface, mm; positive outside.

        Raises
        ------
        ValueError
            If the organ has no surface yet, or cannot be fitted.
        """
        from VICRegistrationLib.registration.steps import finish

        volumeNode = volumeOf(organ) or self.getParameterNode().volume
        volumes.imageFromVolume(volumeNode)
        addPoints(boundaryPointsOf(organ, volumeNode), boundaryPoints)
        finish(fitting.refitSteps(organ, volumeNode), onStep)
        return fitting.boundaryDeviations(organ, volumeNode)

    def surface(self, organ):
        """B-spline surface of an organ.

        Parameters
        ----------
        organ : VICRegistrationLib.mrml.parameters.OrganParameters

        Returns
        -------
        VICRegistrationLib.geometry.surface.BSplineSurface
            Local RAS mm: that of the volume before its parent transform.

        Raises
        ------
        ValueError
            If the organ has no surface.
        """
        return surfaces.surfaceOf(organ)

    def setSurface(self, organ, surface):
        """Set the surface of an organ, for instance one of another program, to start a refit from.

        Parameters
        ----------
        organ : VICRegistrationLib.mrml.parameters.OrganParameters
        surface : VICRegistrationLib.geometry.surface.BSplineSurface
            Local RAS mm.
        """
        volumeNode = volumeOf(organ) or self.getParameterNode().volume
        volumes.imageFromVolume(volumeNode)
        surfaces.showSurface(modelOf(organ, volumeNode), surface, name=organ.label)

    def compare(self, organ, reference, segment=None, *, patient=None):
        """Compare the surface of an organ with a reference, colour it, and write a row into the table of comparisons.

        Parameters
        ----------
        organ : VICRegistrationLib.mrml.parameters.OrganParameters
        reference : vtkMRMLSegmentationNode or vtkMRMLModelNode
        segment : str, optional
            ID or name of the segment; not needed if there is only one.
        patient : str, optional
            The name stored with the volume if not given.

        Returns
        -------
        VICRegistrationLib.analysis.comparison.Comparison

        Raises
        ------
        ValueError
            If they cannot be compared; nothing is changed then.
        """
        volumeNode = volumeOf(organ) or self.getParameterNode().volume
        segmentId = references.segmentIdOf(reference, segment)
        return comparing.compareOrgan(organ, volumeNode, reference, segmentId, patient=patient)

    def color(self, organ, name=None):
        """Colour the surface of an organ, with a legend.

        Parameters
        ----------
        organ : VICRegistrationLib.mrml.parameters.OrganParameters
        name : str, optional
            "Deviation (mm)" or "Standard deviation (mm)"; the organ's own colour if not given.

        Raises
        ------
        ValueError
            If the surface has no such scalars.
        """
        colors.colorBy(organ.surface, name)

    @contextlib.contextmanager
    def _added(self, volumeNode, seeds, thresholds, *, name="organ", erosion=None, dilation=None, segment=None):
        """Add an organ with its seeds or segment, and remove it again if the work on it fails."""
        volumes.imageFromVolume(volumeNode)
        parameters = self.getParameterNode()
        with Organs(parameters).adding(name) as organ:
            parameters.volume = volumeNode
            addPoints(seedsOf(organ, volumeNode), seeds)
            organ.setSeparation(threshold=thresholds, erosion=erosion, dilation=dilation)
            if segment is not None:
                organ.source = RegionSource.SEGMENT
                organ.inputSegmentation, organ.inputSegmentId = segment
            yield organ


class VICRegistrationTest(ScriptedLoadableModuleTest):
    """Self test of the logic on the synthetic MRI; Testing/Slicer has those of the panel."""

    def setUp(self):
        """Start from an empty scene with the synthetic MRI."""
        slicer.mrmlScene.Clear()
        self.phantom, self.volume = samples.phantom(), samples.addPhantomVolume()
        self.logic = VICRegistrationLogic()

    def runTest(self):
        """Run every test."""
        for test in (self.test_fit, self.test_refit, self.test_furtherStack, self.test_sceneBundle, self.test_badSeed):
            self.setUp()
            test()
        self.delayDisplay(_("The self test passed."))

    def test_fit(self):
        """Every organ is fitted within a third of a pixel of the truth, from clicks alone."""
        for name, seeds in self.phantom.seeds.items():
            organ = self.logic.fit(self.volume, seeds, name=name)
            self.assertLess(self.deviation(organ), 0.2)
            self.assertAlmostEqual(organ.volumeMl, self.phantom.surfaces[name].volume() / 1000.0, delta=1.0)

    def test_refit(self):
        """A boundary point 5 mm outside of the bladder is reached within half a millimetre."""
        organ = self.logic.fit(self.volume, self.phantom.seeds["bladder"], name="bladder")
        surface = self.logic.surface(organ)
        u, v = surface.midpoints(1, 1)
        deviations = self.logic.refit(organ, surface.points(u, v) + 5.0 * surface.normals(u, v))
        self.assertLess(abs(deviations[0]), 0.5)

    def test_furtherStack(self):
        """An axial stack, before which the patient has moved, halves the rectum's distance from the truth."""
        stack, seeds = samples.addPhantomStack(), self.phantom.seeds["rectum"]
        organ = self.logic.fit(self.volume, seeds, name="rectum", further=[stack])
        self.assertLess(self.deviation(organ), 0.07)

    def test_sceneBundle(self):
        """A scene that is saved and loaded holds the organ bit for bit."""
        import tempfile

        organ = self.logic.fit(self.volume, self.phantom.seeds["rectum"], name="rectum")
        net, threshold = self.logic.surface(organ).control_net, organ.threshold.minimum
        with tempfile.TemporaryDirectory() as folder:
            self.assertTrue(slicer.util.saveScene(f"{folder}/scene.mrb"))
            slicer.mrmlScene.Clear()
            slicer.util.loadScene(f"{folder}/scene.mrb")
        (loaded,) = self.logic.organs()
        self.assertEqual(self.logic.surface(loaded).control_net.tobytes(), net.tobytes())
        self.assertEqual((loaded.label, loaded.threshold.minimum), ("rectum", threshold))

    def test_badSeed(self):
        """A seed outside of the volume is refused, and leaves nothing in the scene."""
        before = slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLMarkupsFiducialNode")
        with self.assertRaisesRegex(ValueError, "outside"):
            self.logic.fit(self.volume, [(1000.0, 0.0, 0.0)])
        self.assertEqual(slicer.mrmlScene.GetNumberOfNodesByClass("vtkMRMLMarkupsFiducialNode"), before)

    def deviation(self, organ):
        """Mean distance of an organ's surface from the truth, mm."""
        from VICRegistrationLib.analysis.distances import deviation

        return deviation(self.logic.surface(organ), self.phantom.surfaces[organ.label], n_points=2000).mean
