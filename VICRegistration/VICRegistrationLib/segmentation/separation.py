"""Separation of an organ from its surroundings, from seeds in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..imaging.image import Image, as_image
from ..imaging.region import Region, dice_coefficient
from ..messages import Diagnostic
from .axis_surface import find_along_axis
from .checks import TooLarge, check_scale
from .edge_support import area_without_edge, edge_support, strength_apart
from .fluid_level import find_fluid_level
from .growing import grown_region
from .ray_edges import levels_at
from .ray_surface import RaySurface
from .region_pieces import with_pieces
from .remedies import remedy
from .seeds import checked_seeds
from .shaped_region import shaped_region
from .star_surface import find_star

# If the Dice coefficient of two regions is smaller, they are not the same organ: one has leaked or is a fragment.
_SAME_ORGAN = 0.85
# Of two regions that are alike, the grown one follows details better. So the one of a shape is taken only if its area
# without an edge (`area_without_edge`) is smaller by more than this. In 107 bladders, most of them changed, the mean
# Dice coefficient of the region taken is within 0.001 of its best from 0.06 to 0.2.
_LESS_WITHOUT_EDGE = 0.1
# If the Dice coefficient is smaller than the first number, the grown region often lacks a dark part or has a lobe, and
# their borders may have edges too. Then it is taken only if the area without an edge of the one of a shape is larger by
# more than the second number. Of 369 clicks in bladders, changed or not, tubes and random shapes, 13 give a region with
# a Dice coefficient under 0.9, and 23 without this; 13 also with 0.91 to 0.95 for the first number and with 0.11 to 0.3
# for the second one, and 14 with half and with twice of the second one.
_ALIKE, _MORE_WITHOUT_EDGE = 0.92, 0.2
# A region is taken for an organ only if the mean edge strength along its boundary is at least this. If no region can be
# grown, this alone refuses the star-shaped one in 4 of 50 images of noise smoothed by a Gaussian of 3 voxels.
_LEAST_SUPPORT = 0.5
# Its contrast must also be at least so many standard deviations of the noise: noise alone has 1.4 to 2.2 of them,
# organs tried had 36 and more. Without this, 2 of 50 images of white noise give a region, and 11 of 50 of noise
# smoothed by a Gaussian of 0.7 voxels.
_LEAST_CONTRAST = 6.0


def separate(image: Image, seeds, *, threshold=None, erosion=None, dilation=None, fill: bool = True) -> Region:
    """Separate the organ that contains the seeds from its surroundings.

    By default two regions are computed, and one is chosen:

    - the voxels within limits of grey levels that are connected with the seeds (`grown_region`). This region follows
      organs of any shape, but leaks where the wall has a gap;
    - the voxels inside of the star-shaped surface of least cost (`find_star`, `shaped_region`). This region needs no
      limits, but contains only what can be reached by straight lines from its centre. If it is not the same organ as
      the first region, a surface along the organ's axis (`find_along_axis`) is found too, and the one of both with
      clearer edges where they differ is used.

    If the two regions are alike, the second one is chosen if a clearly smaller area of its boundary has no edge. If
    they differ by more, as when the first has lobes or lacks a part, it is chosen unless a clearly larger area of its
    boundary has no edge, or the first ends at the level between two fluids. It is also chosen if the first has leaked.
    Small pieces by which the first one differs are then added or removed if the edges around them support it
    (`with_pieces`). If the chosen region ends at the level between two fluids (`find_fluid_level`), the layer behind
    the level is added.

    With a threshold or a radius, only the first region is computed.

    Parameters
    ----------
    image : Image or path
    seeds : array_like, shape (n, 3) or (3,)
        Points in the organ, RAS mm. A seed that is not within the threshold is moved to a voxel that is, by up to 4 mm.
    threshold : (float, float), optional
        Lowest and highest grey level of the organ, the same everywhere. By default, limits that vary over the organ
        as the signal does (`Limits.along`); ``threshold`` of the result has typical ones.
    erosion : float, optional
        Radius of the erosion in mm. If slices are thicker, it acts only within them. By default 2 mm, or 4 or 6 mm if
        the region is otherwise more than 1.3 times as large as the volume that the rays from the seeds span
        (`find_edges`), or less if the organ is too thin for 2 mm or would fall into pieces.
    dilation : float, optional
        Radius of the dilation in mm; by default the radius of the erosion.
    fill : bool
        Fill cavities.

    Returns
    -------
    Region
        An organ that is cut by the border of the volume is not an error: see ``touches_border``. Nor is one that is
        much larger than the volume that the rays span: see ``diagnostics``.

    Raises
    ------
    ValueError
        If the volume is not given in mm, if a seed lies outside of it or of the threshold, if the erosion leaves
        nothing around a seed, if the threshold is empty or a radius negative or too large, if the seeds lie in separate
        pieces, or if the region has leaked over most of the volume. In the last case the message has a threshold or an
        erosion that works, if one was found.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> region = vic.separate(image, [[23, 23, 23]])
    >>> region.touches_border
    ()
    """
    image = as_image(image)
    check_scale(image)
    seeds = checked_seeds(image, seeds)
    try:
        if threshold is None and erosion is None and dilation is None:
            return _with_layer(image, seeds, _by_both_ways(image, seeds, fill), fill)
        return grown_region(image, seeds, threshold=threshold, erosion=erosion, dilation=dilation, fill=fill)
    except TooLarge as error:
        tried = remedy(image, seeds, error.threshold, erosion=erosion, dilation=dilation, fill=fill)
        msg = f"{error} {tried}"
        raise ValueError(msg) from error


def _with_layer(image: Image, seeds: np.ndarray, region: Region, fill: bool) -> Region:
    """Add the layer behind a level between two fluids to a region that ends there.

    The layer comes from the star-shaped surface in the image without the contrast at the level. A grown region would
    leak in that image.
    """
    level = find_fluid_level(image, region)
    if level is None:
        return region
    even = level.removed_from(image)
    values = {"area_cm2": level.area_cm2, "side": level.side}
    ends = replace(region, diagnostics=(*region.diagnostics, Diagnostic("ends_at_level", values)))
    star = find_star(even, seeds)
    shaped = shaped_region(even, star, seeds, fill=fill)
    if shaped is None:
        return ends
    if not level.is_passed_by(shaped) or level.support_behind(even, shaped, star) < _LEAST_SUPPORT:
        return ends
    whole = _better(even, level.joined(image, region, shaped), shaped, star, fill)
    included = Diagnostic("layer_included", {**values, "layer_ml": level.layer_ml(whole)})
    by_code = {found.code: found for found in (*region.diagnostics, *whole.diagnostics, included)}
    return replace(whole, diagnostics=tuple(by_code.values()))


def _by_both_ways(image: Image, seeds: np.ndarray, fill: bool) -> Region:
    """Separate an organ in both ways, and choose one region."""
    try:
        grown, refused = grown_region(image, seeds, fill=fill), None
    except ValueError as error:
        grown, refused = None, error
    shaped, surface = _by_shape(image, seeds, grown, fill)
    if shaped is None:
        if refused is not None:
            raise refused
        return grown
    if grown is None:
        if edge_support(image, shaped, surface) < _LEAST_SUPPORT:
            raise refused
        return shaped
    # Either the grown region agrees with this one, or `starts_differ` says that it does not.
    return _better(image, grown, replace(shaped, diagnostics=()), surface, fill)


def _by_shape(image: Image, seeds: np.ndarray, grown: Region | None, fill: bool) -> tuple[Region | None, RaySurface]:
    """Separate an organ by its shape: with a star-shaped surface, or with one along the axis.

    A star-shaped surface that agrees with the grown region is enough. If there is no grown region, and the contrast is
    that of noise, there is no organ.
    """
    star = find_star(image, seeds)
    if grown is None and _is_noise(image, seeds, star.contrast):
        return None, star
    shaped = shaped_region(image, star, seeds, fill=fill)
    if None not in (grown, shaped) and dice_coefficient(grown, shaped) >= _SAME_ORGAN:
        return shaped, star
    along = find_along_axis(image, star)
    whole = None if along is None else shaped_region(image, along, seeds, fill=fill)
    if whole is None:
        return shaped, star
    if shaped is None:
        return whole, along
    if dice_coefficient(shaped, whole) >= _SAME_ORGAN:
        return shaped, star
    taken, surface = shaped, star
    if strength_apart(image, whole, star, star) > strength_apart(image, shaped, along, star):
        taken, surface = whole, along
    values = {"star_ml": shaped, "along_ml": whole, "taken_ml": taken}
    return _with(taken, "surfaces_differ", values), surface


def _with(region: Region, code: str, sizes: dict[str, Region]) -> Region:
    """Add a diagnostic that has the volumes of regions to a region."""
    values = {name: float(each.volume_ml) for name, each in sizes.items()}
    return replace(region, diagnostics=(*region.diagnostics, Diagnostic(code, values)))


def _better(image: Image, grown: Region, shaped: Region, surface: RaySurface, fill: bool) -> Region:
    """Choose the region that the edges support better; the one of a shape is completed by pieces of the grown one."""
    # The boundary of a leak may lie at edges of other tissue, so its edges are not compared.
    leaked = bool(grown.diagnostics) and edge_support(image, shaped, surface) >= _LEAST_SUPPORT
    less = np.subtract(*(area_without_edge(image, region, surface) for region in (grown, shaped)))
    agreement, limit = dice_coefficient(grown, shaped), _LESS_WITHOUT_EDGE
    # A region that ends at a level between two fluids gets the layer behind it later.
    if agreement < _ALIKE and find_fluid_level(image, grown) is None:
        limit = -_MORE_WITHOUT_EDGE
    better = grown
    if leaked or less > limit:
        better = with_pieces(image, shaped, grown, surface, fill=fill)
    if agreement >= _SAME_ORGAN:
        return better
    return _with(better, "starts_differ", {"grown_ml": grown, "shaped_ml": shaped, "taken_ml": better})


def _is_noise(image: Image, seeds: np.ndarray, contrast: float) -> bool:
    """Whether a contrast is no larger than noise explains."""
    return contrast < _LEAST_CONTRAST * float(levels_at(image, seeds, contrast)[1].max())
