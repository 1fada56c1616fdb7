"""The synthetic pelvic MRI as a volume of the scene, for trying things on."""

from __future__ import annotations

import functools

import slicer

from .volumes import showInSlices

NAME = "VIC pelvis phantom"


@functools.lru_cache(maxsize=1)
def phantom():
    """Synthetic MRI of a pelvis whose organs are known; painted once, which takes seconds.

    Returns
    -------
    VICRegistrationLib.phantoms.pelvis.PelvisPhantom
    """
    from ..phantoms.pelvis import pelvis_phantom

    return pelvis_phantom()


def addPhantomVolume():
    """Add the synthetic MRI to the scene and show it.

    Returns
    -------
    vtkMRMLScalarVolumeNode
    """
    image = phantom().image
    node = slicer.util.addVolumeFromArray(
        image.array, ijkToRAS=image.ijk_to_ras, name=slicer.mrmlScene.GenerateUniqueName(NAME)
    )
    showInSlices(node)
    return node
