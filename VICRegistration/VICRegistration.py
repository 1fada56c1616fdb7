"""Slicer module of VICRegistration: organs of an MRI as smooth B-spline surfaces."""

from __future__ import annotations

import numpy as np
import qt
import slicer
import vtk
from slicer.i18n import tr as _
from slicer.i18n import translate
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleTest,
    ScriptedLoadableModuleWidget,
)


class VICRegistration(ScriptedLoadableModule):
    """What Slicer shows about the module."""

    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        self.parent.title = _("VIC Registration")
        self.parent.categories = [translate("qSlicerAbstractCoreModule", "Segmentation")]
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


class VICRegistrationWidget(ScriptedLoadableModuleWidget):
    """The panel: says how to fit an organ in this version."""

    def setup(self):
        """Build the panel."""
        ScriptedLoadableModuleWidget.setup(self)
        label = qt.QLabel(
            _(
                "In this version organs are fitted from the command line, not from this panel:\n\n"
                "vic-registration fit IMAGE --organ NAME --seed R,A,S --output DIR\n\n"
                "IMAGE is a file or a DICOM folder; the seed is a place inside the organ in RAS mm. "
                "Open the surface DIR/NAME.vtp here: it appears in place.\n\n"
                "In the Python console, VICRegistrationLogic().imageFromVolume(node) gives a volume of the "
                "scene to the library VICRegistrationLib."
            )
        )
        label.setWordWrap(True)
        label.setTextInteractionFlags(qt.Qt.TextSelectableByMouse)
        self.layout.addWidget(label)
        self.layout.addStretch(1)


class VICRegistrationLogic(ScriptedLoadableModuleLogic):
    """Hands nodes of the scene to VICRegistrationLib."""

    def imageFromVolume(self, volumeNode):
        """Copy a volume node into an Image of the library, where it stands in the world.

        Parameters
        ----------
        volumeNode : vtkMRMLScalarVolumeNode

        Returns
        -------
        VICRegistrationLib.imaging.image.Image

        Raises
        ------
        ValueError
            If the volume is under a transform that is not linear, or is no image that can be fitted.
        """
        from VICRegistrationLib.imaging.image import Image

        parent = volumeNode.GetParentTransformNode()
        if parent is not None and not parent.IsTransformToWorldLinear():
            raise ValueError(
                _(
                    "The volume {name} is under a transform that bends it; a linear one is needed; "
                    "harden the transform first."
                ).format(name=volumeNode.GetName())
            )
        toWorld, ijkToRas = vtk.vtkMatrix4x4(), vtk.vtkMatrix4x4()
        slicer.vtkMRMLTransformNode.GetMatrixTransformBetweenNodes(parent, None, toWorld)
        volumeNode.GetIJKToRASMatrix(ijkToRas)
        matrix = slicer.util.arrayFromVTKMatrix(toWorld) @ slicer.util.arrayFromVTKMatrix(ijkToRas)
        return Image(slicer.util.arrayFromVolume(volumeNode).copy(), matrix)


class VICRegistrationTest(ScriptedLoadableModuleTest):
    """Self test: the library is installed and reads a volume of the scene."""

    def setUp(self):
        """Start from an empty scene."""
        slicer.mrmlScene.Clear()

    def runTest(self):
        """Run every test."""
        self.setUp()
        self.test_imageFromVolume()

    def test_imageFromVolume(self):
        """An oblique, left-handed volume under a transform keeps its grey levels and its place."""
        array = np.arange(60, dtype=np.int16).reshape(3, 4, 5)
        ijkToRas = np.array([[0.6, 0, 0, 10], [0, 0.3, 2.4, -20], [0, 0.4, -1.8, 5], [0, 0, 0, 1]])
        node = slicer.util.addVolumeFromArray(array, ijkToRAS=ijkToRas, name="VIC self test")
        transform = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "VIC shift")
        transform.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(np.eye(4) + np.eye(4, k=3) * 7))
        node.SetAndObserveTransformNodeID(transform.GetID())
        image = VICRegistrationLogic().imageFromVolume(node)
        np.testing.assert_array_equal(image.array, array)
        np.testing.assert_allclose(image.to_ras(np.array([[2.0, 1.0, 1.0]])), [[18.2, -17.3, 3.6]])
        self.delayDisplay(_("The self test passed."))
