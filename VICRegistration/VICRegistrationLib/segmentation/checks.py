"""Checks of the input of a separation and of its region: errors for the user, and diagnostics."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_box
from ..messages import Diagnostic

# A region that takes a larger share of the volume is a leak into the surroundings.
_LARGEST_SHARE = 0.6
# So is a region that touches this many faces of the volume: a stack that ends within an organ cuts it at two.
_MOST_FACES = 4
# A region this many times as large as the volume that the rays from the seeds span is reported as a leak.
LEAK_FACTOR = 1.3
# The longest side of a volume, mm, lies between these: the erosion by 2 mm from both sides would leave nothing of a
# smaller volume, and a larger one is longer than any body.
_SIDES_MM = (4.0, 1e4)


class TooLarge(ValueError):
    """Error: a region is too large, or touches too many faces of the volume, to be one organ.

    Parameters
    ----------
    message : str
    threshold : (float, float)
        Lowest and highest grey level of the region.
    """

    def __init__(self, message, threshold):
        super().__init__(message)
        self.threshold = threshold


def check_scale(image):
    """Raise a ValueError if the size of a volume shows that its unit is not the millimetre."""
    sides = image.spacing * image.size
    shortest, longest = _SIDES_MM
    if shortest <= sides.max() <= longest:
        return
    size = " x ".join(f"{side:.3g}" for side in sides)
    if sides.max() < shortest:
        like, unit, factor = "smaller than any organ", "metres", "1000 times as large"
    else:
        like, unit, factor = "larger than any body", "micrometres", "a thousandth of that"
    msg = (
        f"The volume is {size} mm, {like}; all lengths must be in millimetres. If the file holds {unit}, make its "
        f"spacing and origin {factor} (in Slicer: module Volumes, Volume Information)."
    )
    raise ValueError(msg)


def checked_threshold(threshold):
    """Return a user's threshold as two numbers; raises a ValueError if it is not two, or empty."""
    try:
        low, high = (float(value) for value in threshold)
    except (TypeError, ValueError):
        msg = f"The threshold is {threshold!r}; it must be two grey levels, the lowest and the highest."
        raise ValueError(msg) from None
    if not low <= high:
        msg = (
            f"The threshold {low:.6g} to {high:.6g} is empty; the lowest grey level must come first and not "
            "exceed the highest."
        )
        raise ValueError(msg)
    return low, high


def checked_radius(name, radius, image):
    """Return a user's radius, mm, as a number; raises a ValueError if it is negative or longer than any organ is thick.

    The name is used in the message.
    """
    radius = float(radius)
    if not (np.isfinite(radius) and radius >= 0):
        msg = f"The {name} is {radius:g} mm; it must be zero or a positive length."
        raise ValueError(msg)
    largest = float((image.spacing * image.size).max()) / 2.0
    if radius > largest:
        msg = (
            f"The {name} is {radius:g} mm, more than half of the volume's longest side, {largest:.4g} mm; no organ is "
            "that thick. Use a few millimetres."
        )
        raise ValueError(msg)
    return radius


def refuse_seed(image, seed, voxel, limits, *, suggested):
    """Raise the ValueError for a seed, at a voxel (k, j, i), outside of the limits that were suggested or given."""
    level, low, high = float(image.array[tuple(voxel)]), limits.low, limits.high
    if suggested:
        msg = (
            f"No threshold could be suggested that holds the seed {place(seed)}: its grey level is {level:.6g}, "
            f"the suggestion {low:.6g} to {high:.6g}. The organ may be thin or the seed in a wall; give the "
            "threshold as its lowest and highest grey level, or move the seed."
        )
    else:
        msg = (
            f"The grey level at the seed {place(seed)} is {level:.6g}, outside the threshold {low:.6g} "
            f"to {high:.6g}; move the seed into the organ or widen the threshold."
        )
    raise ValueError(msg)


def refuse_erosion(image, seeds, voxels, inside, erosion):
    """Raise the ValueError for a seed around which the erosion leaves no voxel, with a radius that leaves some."""
    depths = ndimage.distance_transform_edt(inside, sampling=image.spacing[::-1])
    enough = []
    for voxel in voxels:
        near, distances = ball_box(inside, voxel, image.ijk_to_ras[:3, :3], erosion)
        enough.append(depths[near][distances < depths[near]].max())
    worst = int(np.argmin(enough))
    msg = (
        f"The erosion of {erosion:g} mm leaves nothing around the seed {place(seeds[worst])}: the organ is "
        f"too thin there. Use an erosion below {enough[worst]:.2g} mm or move the seed deeper into the organ."
    )
    raise ValueError(msg)


def refuse_leak(image, seeds, edges, limits, factor):
    """Raise TooLarge for a component of the seeds that is many times what the rays from them span."""
    low = max(limits.low, float(image.array.min()))
    msg = (
        f"The grey levels {low:.6g} to {limits.high:.6g} around the seed {place(seeds[0])} are connected to more "
        f"than {factor:g} times the {edges.volume / 1000.0:.1f} ml seen from it: that is no organ. Place the seed "
        "deeper in the organ or add a second one."
    )
    raise TooLarge(msg, (low, limits.high))


def fills_volume(image, region):
    """Whether a region takes most of the volume, or touches so many of its faces that it is not one organ."""
    share = np.count_nonzero(region.mask) / image.array.size
    return share > _LARGEST_SHARE or len(region.touches_border) >= _MOST_FACES


def check_leak(image, region):
    """Raise TooLarge if a region takes most of the volume, or touches most of its faces."""
    if not fills_volume(image, region):
        return
    share = np.count_nonzero(region.mask) / image.array.size
    faces = len(region.touches_border)
    reach = f"touches {faces} of the six faces of the volume" if share <= _LARGEST_SHARE else "fills most of the volume"
    low, high = region.threshold
    msg = (
        f"The separated region {reach} ({share:.0%} of it): with the threshold {low:.6g} to {high:.6g} it is "
        "not one organ."
    )
    raise TooLarge(msg, region.threshold)


def check_pieces(region):
    """Raise a ValueError if a region has several pieces."""
    count = ndimage.label(region.mask)[1]
    if count > 1:
        low, high = region.threshold
        remedy = "widen the threshold or lower the erosion" if region.erosion else "widen the threshold"
        msg = (
            f"The separated region falls into {count} pieces, which one closed surface cannot hold (threshold "
            f"{low:.6g} to {high:.6g}, erosion {region.erosion:g} mm). Fit them one by one, or {remedy} so that they "
            "join."
        )
        raise ValueError(msg)


def leak_diagnostics(region, edges, volume):
    """Report a region as a leak if it is much larger than what the rays from the seeds span.

    Parameters
    ----------
    region : Region
    edges : Edges
        Of the rays from the seeds.
    volume : float
        Volume of the region before cavities were filled, mm^3.

    Returns
    -------
    tuple of Diagnostic
        One, or none.
    """
    if volume <= LEAK_FACTOR * edges.volume:
        return ()
    low, high = (float(level) for level in region.threshold)
    volumes = {"region_ml": float(region.volume_ml), "seen_ml": float(edges.volume) / 1000.0}
    return (Diagnostic("region_larger_than_seen", {**volumes, "low": low, "high": high, "erosion_mm": region.erosion}),)


def place(seed):
    """Format a point, RAS mm, for a message."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*seed)
