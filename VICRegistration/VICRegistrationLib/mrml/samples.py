"""The synthetic pelvic MRI as volumes of the scene: one stack, and a further one."""

from __future__ import annotations

import functools

import slicer

from .volumes import showInSlices

NAME, STACK_NAME = "VIC pelvis phantom", "VIC pelvis phantom, axial"
# How far the patient has moved between both stacks.
_SHIFT_MM, _TURN_DEGREES = 2.7, 1.8


@functools.lru_cache(maxsize=1)
def phantom():
    """Synthetic MRI of a pelvis whose organs are known; painted once, which takes seconds.

    Returns
    -------
    VICRegistrationLib.phantoms.pelvis.PelvisPhantom
    """
    from ..phantoms.pelvis import pelvis_phantom

    return pelvis_phantom()


@functools.lru_cache(maxsize=1)
def phantomStack():
    """Axial stack of the same pelvis, after the patient has moved by 2.7 mm and 1.8 degrees.

    Returns
    -------
    VICRegistrationLib.phantoms.stacks.PhantomStack
    """
    from ..phantoms.stacks import further_stacks

    return further_stacks(1, shift_mm=_SHIFT_MM, turn_degrees=_TURN_DEGREES)[0]


def addPhantomVolume():
    """Add the synthetic MRI to the scene and show it.

    Returns
    -------
    vtkMRMLScalarVolumeNode
    """
    return _added(phantom().image, NAME)


def addPhantomStack():
    """Add the axial stack of the synthetic MRI to the scene and show it.

    Returns
    -------
    vtkMRMLScalarVolumeNode
    """
    return _added(phantomStack().image, STACK_NAME)


def sources():
    """List what the module Sample Data is to offer; it is painted here, not downloaded.

    Returns
    -------
    list of dict
        Arguments of SampleDataLogic.registerCustomSampleDataSource.
    """
    offered = ((NAME, addPhantomVolume), (STACK_NAME, addPhantomStack))
    return [
        {
            "category": "VICRegistration",
            "sampleName": name,
            "uris": "painted",
            "fileNames": name,
            "nodeNames": name,
            "customDownloader": lambda source, add=add: add(),
        }
        for name, add in offered
    ]


def _added(image, name):
    """Add an image to the scene and show it."""
    node = slicer.util.addVolumeFromArray(
        image.array, ijkToRAS=image.ijk_to_ras, name=slicer.mrmlScene.GenerateUniqueName(name)
    )
    showInSlices(node)
    return node
