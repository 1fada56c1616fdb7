"""Separating an organ of the scene, by its seeds or by a segment that was drawn."""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from .organ_nodes import hasSegment, segmentOf
from .parameters import OrganState, RegionSource
from .points import placedPoints
from .regions import regionFromSegment, regionVolumeMl, showRegion
from .sentences import sentence
from .volumes import imageFromVolume, localPoints


def canBeSeparated(organ):
    """Whether an organ has seeds, or a segment if that is its source.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    bool
    """
    if organ.source is RegionSource.SEGMENT:
        return organ.inputSegmentation is not None and bool(organ.inputSegmentId)
    return organ.seeds is not None and organ.seeds.GetNumberOfDefinedControlPoints() > 0


def separateOrgan(organ, volumeNode):
    """Separate an organ and show its region.

    Parameters
    ----------
    organ : OrganParameters
        A threshold that is automatic is set to the suggestion.
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    region : VICRegistrationLib.imaging.region.Region
    warnings : list of str
        What may be wrong with the region.

    Raises
    ------
    ValueError
        If the organ cannot be separated; its segment is then empty.
    """
    from ..registration.diagnostics import region_diagnostics

    image, region = imageAndRegion(organ, volumeNode)
    warnings = [sentence(diagnostic) for diagnostic in region_diagnostics(image, region)]
    return region, warnings + _seedWarnings(organ, volumeNode, image, region)


def imageAndRegion(organ, volumeNode):
    """Separate an organ, show its region, and store the options that were chosen; return the image and the region."""
    try:
        image = imageFromVolume(volumeNode)
        region = _regionOf(organ, volumeNode, image)
    except ValueError:
        # With a segment as source, the organ's own region may hold the user's edit, and is not emptied.
        if hasSegment(organ) and organ.source is not RegionSource.SEGMENT:
            showRegion(organ.regions, organ.regionSegmentId, None)
        raise
    # One event for all changes: the panel looks at the whole organ at every event.
    with slicer.util.NodeModify(organ.parameterNode):
        segmentationNode, segmentId = segmentOf(organ, volumeNode)
        showRegion(segmentationNode, segmentId, region)
        if region.threshold is not None and organ.thresholdAutomatic:
            _setThreshold(organ, region.threshold)
        if region.erosion is not None and organ.erosionAutomatic:
            organ.erosionMm = float(region.erosion)
        if organ.state in (OrganState.NEW, OrganState.FAILED):
            organ.state = OrganState.SEPARATED
        if organ.surface is None:
            organ.volumeMl = regionVolumeMl(region, volumeNode)
    return image, region


def _regionOf(organ, volumeNode, image):
    from ..segmentation.separation import separate

    if organ.source is RegionSource.SEGMENT:
        return regionFromSegment(organ.inputSegmentation, organ.inputSegmentId, volumeNode, image)
    seeds = localPoints(volumeNode, placedPoints(organ.seeds))
    if not len(seeds):
        raise ValueError(_("The organ {name} has no seed. Place a point inside the organ.").format(name=organ.label))
    options = organ.options()
    return separate(image, seeds, threshold=options.threshold, erosion=options.erosion, dilation=options.dilation)


def _setThreshold(organ, threshold):
    from slicer.parameterNodeWrapper import FloatRange

    low, high = (float(level) for level in threshold)
    if (organ.threshold.minimum, organ.threshold.maximum) != (low, high):
        organ.threshold = FloatRange(low, high)


def _seedWarnings(organ, volumeNode, image, region):
    """Warn of seeds outside of a region that was taken from a segment."""
    import numpy as np

    if organ.source is not RegionSource.SEGMENT:
        return []
    seeds = localPoints(volumeNode, placedPoints(organ.seeds))
    if not len(seeds):
        return []
    voxels = np.rint(image.to_ijk(seeds)[:, ::-1]).astype(int) - np.asarray(region.offset)
    within = np.all((voxels >= 0) & (voxels < region.mask.shape), axis=1)
    held = [bool(region.mask[tuple(voxel)]) for voxel in voxels[within]]
    if all(held) and all(within):
        return []
    return [_("Not all seeds lie in the segment. Check that it is the right one.")]
