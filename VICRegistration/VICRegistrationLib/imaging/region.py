"""The voxels of one organ, on a crop of the image's grid."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..messages import Diagnostic
from .boxes import bounds
from .image import Image, as_image
from .morphology import fill_holes
from .resampling import resampled

# Share of a label outside of its largest piece from which on it is reported. In labels of experts, stray voxels have up
# to 0.002 of it, and parts that an empty slice cuts off have 0.017 to 0.58.
_STRAY_SHARE = 0.005
_FACES = (("k-", "k+"), ("j-", "j+"), ("i-", "i+"))


@dataclass(frozen=True, eq=False)
class Region:
    """The voxels of one organ, on a crop of the image's grid.

    Attributes
    ----------
    mask : ndarray of bool, shape (nk, nj, ni)
        The crop leaves a margin of one voxel of background wherever the volume has one.
    offset : tuple of 3 int
        First voxel (k, j, i) of the crop in the image.
    ijk_to_ras : ndarray, shape (4, 4)
        Takes voxels (i, j, k) of the crop to RAS mm.
    threshold : tuple of 2 float or None
        Lowest and highest grey level of the organ; None if the mask was given.
    touches_border : tuple of str
        Faces of the volume that the organ touches, out of "k-", "k+", "j-", "j+", "i-" and "i+"; it may continue
        beyond them.
    erosion : float or None
        Radius of the erosion in mm; None if the mask was given.
    diagnostics : tuple of Diagnostic
        Warnings about the region.

    Examples
    --------
    See :func:`region_from_mask`.

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> image = vic.Image.from_array(np.zeros((4, 4, 4)), np.eye(4))
    >>> vic.region_from_mask(image, np.ones((4, 4, 4))).touches_border
    ('k-', 'k+', 'j-', 'j+', 'i-', 'i+')
    """

    mask: np.ndarray
    offset: tuple
    ijk_to_ras: np.ndarray
    threshold: tuple | None
    touches_border: tuple
    erosion: float | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    def __repr__(self):
        nk, nj, ni = self.mask.shape
        limits = "" if self.threshold is None else ", grey levels {:.5g} to {:.5g}".format(*self.threshold)
        return f"Region({self.volume_ml:.3g} ml in {ni} x {nj} x {nk} voxels{limits})"

    @property
    def image(self) -> Image:
        """The mask as an image."""
        return Image(self.mask, self.ijk_to_ras)

    @property
    def spacing(self) -> np.ndarray:
        """Voxel spacing in mm along i, j and k, shape (3,)."""
        return self.image.spacing

    @property
    def volume_ml(self) -> float:
        """Volume of the voxels in millilitres."""
        return np.count_nonzero(self.mask) * self.image.voxel_volume / 1000.0

    @property
    def border_area(self) -> float:
        """Area of the region's faces at the border of its image, mm^2."""
        steps, area = self.ijk_to_ras[:3, :3], 0.0
        for face in self.touches_border:
            axis = "ijk".index(face[0])
            pixel = np.linalg.norm(np.cross(*np.delete(steps, axis, axis=1).T))
            area += pixel * np.count_nonzero(self.mask.take(0 if face[1] == "-" else -1, axis=2 - axis))
        return float(area)

    def in_box(self, start, stop) -> np.ndarray:
        """Mask of the region in a box of its image's voxels.

        Parameters
        ----------
        start, stop : (3,) array_like of int
            First voxel (k, j, i) of a box that contains the region's crop, and one past its last voxel.

        Returns
        -------
        ndarray of bool, shape (nk, nj, ni)
        """
        mask = np.zeros(np.subtract(stop, start), dtype=bool)
        first = np.subtract(self.offset, start)
        mask[tuple(map(slice, first, first + self.mask.shape))] = self.mask
        return mask


def common_box(first: Region, second: Region) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest box of voxels that contains the crops of two regions of one image.

    Parameters
    ----------
    first, second : Region

    Returns
    -------
    start, stop : ndarray, shape (3,)
        First voxel (k, j, i), and one past the last one.
    """
    ends = (np.add(region.offset, region.mask.shape) for region in (first, second))
    return np.minimum(first.offset, second.offset), np.maximum(*ends)


def dice_coefficient(first: Region, second: Region) -> float:
    """Dice coefficient of two regions of one image.

    Parameters
    ----------
    first, second : Region

    Returns
    -------
    float
        From 0, if they have no voxel in common, to 1, if they are equal.
    """
    masks = [region.in_box(*common_box(first, second)) for region in (first, second)]
    return 2.0 * np.count_nonzero(masks[0] & masks[1]) / sum(map(np.count_nonzero, masks))


def region_from_mask(image: Image | str | os.PathLike, mask, *, largest_component: bool = False) -> Region:
    """Make a region from a segmentation on the image's grid.

    Parameters
    ----------
    image : Image or path
    mask : ndarray, shape (nk, nj, ni)
        Voxels other than zero belong to the organ.
    largest_component : bool
        Keep only the largest component (face neighbours); others that are more than stray voxels are reported in
        ``diagnostics``.

    Returns
    -------
    Region
        With ``threshold`` None.

    Raises
    ------
    TypeError
        If the mask is no array.
    ValueError
        If it is empty or has another shape than the image.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> image = vic.Image.from_array(np.zeros((10, 20, 20)), np.diag([1, 1, 3, 1]))
    >>> mask = np.zeros(image.array.shape, dtype=bool)
    >>> mask[3:7, 5:15, 5:15] = True
    >>> vic.region_from_mask(image, mask)
    Region(1.2 ml in 12 x 12 x 6 voxels)
    """
    if isinstance(mask, (Image, str, os.PathLike)):
        msg = (
            f"A mask is an array on the image's grid, and {type(mask).__name__} was given; region_from_label takes "
            "label images and their files, on any grid."
        )
        raise TypeError(msg)
    image, mask = as_image(image), np.asarray(mask)
    if mask.shape != image.array.shape:
        msg = (
            f"The mask has shape {mask.shape} and the image {image.array.shape} (k, j, i); they must share "
            "one grid. Resample the mask to the image."
        )
        raise ValueError(msg)
    mask = mask != 0
    if not mask.any():
        msg = "The mask is empty; it must hold the organ's voxels. Choose another segment or label."
        raise ValueError(msg)
    mask, diagnostics = _largest_piece(mask) if largest_component else (mask, ())
    return replace(region_from_crop(image, mask, np.zeros(3, dtype=int), fill=False), diagnostics=diagnostics)


def region_from_label(image: Image | str | os.PathLike, label: Image | str | os.PathLike) -> Region:
    """Make a region from a label on any grid: the image's voxels where the interpolated label is at least one half.

    Parameters
    ----------
    image : Image or path
        The grey levels.
    label : Image or path
        Voxels other than zero belong to the organ, see :func:`.labels.read_label`. Only the largest piece is taken;
        others that are more than stray voxels are reported in ``diagnostics``.

    Returns
    -------
    Region
        On the image's grid, with ``threshold`` None and cavities filled.

    Raises
    ------
    ValueError
        If the label is empty, or has no voxel in the image.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> image = vic.Image.from_array(np.zeros((10, 20, 20)), np.diag([1, 1, 3, 1]))
    >>> label = vic.Image.from_array(np.ones((5, 5, 5)), np.diag([2, 2, 2, 1]))
    >>> vic.region_from_label(image, label)
    Region(0.729 ml in 10 x 10 x 4 voxels)
    """
    image, label = as_image(image), as_image(label)
    mask = label.array != 0
    if not mask.any():
        msg = "The label is empty; it must hold the organ's voxels. Choose another segment or label."
        raise ValueError(msg)
    first, last = bounds(mask)
    corners = np.array(list(itertools.product(*zip(first[::-1] - 0.5, last[::-1] - 0.5))))
    ends = image.to_ijk(label.to_ras(corners))[:, ::-1]
    start = np.clip(np.floor(ends.min(axis=0)).astype(int), 0, image.array.shape)
    stop = np.clip(np.ceil(ends.max(axis=0)).astype(int) + 1, 0, image.array.shape)
    inside = np.zeros(np.maximum(stop - start, 0), dtype=bool)
    if inside.size:
        crop = image.crop(start, stop)
        box = label.crop(np.maximum(first - 1, 0), np.minimum(last + 1, mask.shape))
        inside = resampled(Image(box.array != 0, box.ijk_to_ras), crop.ijk_to_ras, crop.size).array >= 0.5
    if not inside.any():
        msg = (
            "The label lies outside of the image, or is too thin for its voxels; choose a label of the same patient in "
            "the same frame."
        )
        raise ValueError(msg)
    largest, diagnostics = _largest_piece(inside)
    return replace(region_from_crop(image, largest, start, fill=True), diagnostics=diagnostics)


def _largest_piece(mask: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...]]:
    """Take the largest piece of a label, and report the others if they are more than stray voxels."""
    pieces, count = ndimage.label(mask)
    sizes = np.bincount(pieces.ravel())[1:]
    left_out = 1.0 - sizes.max() / sizes.sum()
    values = {"count": count, "left_out": float(left_out)}
    diagnostics = (Diagnostic("segmentation_in_pieces", values),) if left_out > _STRAY_SHARE else ()
    return pieces == sizes.argmax() + 1, diagnostics


def region_from_crop(image, mask, start, *, fill, threshold=None, erosion=None):
    """Make a region from a mask whose first voxel is voxel `start` (k, j, i) of the image."""
    shape = np.array(image.array.shape)
    first, last = bounds(mask)
    low = np.maximum(start + first - 1, 0)
    high = np.minimum(start + last + 1, shape)
    crop = np.zeros(high - low, dtype=bool)
    shift = start + first - low
    crop[tuple(map(slice, shift, shift + last - first))] = mask[tuple(map(slice, first, last))]
    touches = tuple(
        name
        for names, at_low, at_high in zip(_FACES, start + first == 0, start + last == shape)
        for name, touched in zip(names, (at_low, at_high))
        if touched
    )
    return Region(
        mask=fill_holes(crop) if fill else crop,
        offset=tuple(low.tolist()),
        ijk_to_ras=image.crop(low, high).ijk_to_ras,
        threshold=threshold,
        touches_border=touches,
        erosion=erosion,
    )
