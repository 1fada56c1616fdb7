"""Resampling of an image on another grid, and signed distances from the boundary of a mask, by ITK."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk
from scipy import ndimage

from .image import Image


def resampled(image: Image, ijk_to_ras: np.ndarray, size: np.ndarray) -> Image:
    """Interpolate an image linearly on another grid.

    Parameters
    ----------
    image : Image
        Masks count as 0 and 1.
    ijk_to_ras : (4, 4) ndarray
        The other grid.
    size : (3,) array_like of int
        Its number of voxels along i, j, k.

    Returns
    -------
    Image
        Of floating point numbers; 0 if a voxel's centre lies outside of the image's outer faces, as with
        :class:`.sampling.Sampler`.
    """
    array = image.array.view(np.uint8) if image.array.dtype == bool else image.array
    # In indices of both grids, because ITK allows no sheared directions.
    between = image.ras_to_ijk @ ijk_to_ras
    filter_ = sitk.ResampleImageFilter()
    filter_.SetSize([int(count) for count in size])
    filter_.SetTransform(sitk.AffineTransform(between[:3, :3].ravel().tolist(), between[:3, 3].tolist()))
    filter_.SetInterpolator(sitk.sitkLinear)
    filter_.SetOutputPixelType(sitk.sitkFloat64)
    volume = filter_.Execute(sitk.GetImageFromArray(np.ascontiguousarray(array)))
    return Image(sitk.GetArrayFromImage(volume), ijk_to_ras)


def signed_distances(mask: np.ndarray, step: float) -> np.ndarray:
    """Signed distance of every voxel's centre from the boundary of a mask, on a grid of cubes.

    Parameters
    ----------
    mask : (k, j, i) ndarray of bool
        Neither empty nor full.
    step : float
        Edge of a voxel, mm.

    Returns
    -------
    (k, j, i) ndarray
        mm, negative inside: the distance from the nearest centre on the other side, minus half a voxel.
    """
    distances = _outside_distances(mask) - 0.5
    # Distances inside need only one layer of background around the mask.
    box = tuple(slice(max(part.start - 1, 0), part.stop + 1) for part in ndimage.find_objects(mask.view(np.uint8))[0])
    distances[box] = np.where(mask[box], 0.5 - _outside_distances(~mask[box]), distances[box])
    return step * distances


def _outside_distances(mask: np.ndarray) -> np.ndarray:
    """Distance of the voxels outside of a mask from the nearest one inside, in voxels; 0 inside."""
    volume = sitk.GetImageFromArray(mask.view(np.uint8))
    found = sitk.SignedMaurerDistanceMap(volume, insideIsPositive=False, squaredDistance=False)
    return np.maximum(sitk.GetArrayFromImage(found), 0.0)
