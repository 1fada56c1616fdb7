"""An organ cut out of its volume, from seeds in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..imaging.image import Image, as_image
from ..imaging.region import Region
from ..messages import Diagnostic
from .checks import TooLarge, check_scale
from .edge_support import agreement, area_without_edge, edge_support
from .fluid_level import find_fluid_level
from .growing import grown_region
from .ray_edges import levels_at
from .region_pieces import with_pieces
from .remedies import remedy
from .seeds import checked_seeds
from .star_region import shaped_region
from .star_surface import Star

# Below this Dice coefficient, two regions are not the same organ: one has leaked, is a fragment, or is bent.
_SAME_ORGAN = 0.85
# Of two regions of the same organ, the shape is taken where it has less boundary without an edge by this area, for a
# volume of 1: the other one follows details. In 107 bladders, most of them changed, the mean Dice coefficient of what
# is taken is within 0.001 of its best from 0.06 to 0.2. Of others, that with less of it is.
_LESS_WITHOUT_EDGE = 0.1
# A boundary with less of an edge is none.
_LEAST_SUPPORT = 0.5
# Nor is one found in surroundings whose contrast is less than so many standard deviations of the noise: noise alone has
# 1.4 to 2.2 of them, organs tried had 36 and more.
_NOISE = 6.0


def separate(image: Image, seeds, *, threshold=None, erosion=None, dilation=None, fill: bool = True) -> Region:
    """Separate the organ that holds the seeds from its surroundings.

    By default in two ways. Voxels within limits of grey levels that hold together with the seeds: this follows organs
    of any shape, and leaks where a wall is open (`grown_region`). And those within the star-shaped surface on which the
    image shows most of an edge: this needs no limits, and finds only what is in view from the middle (`shaped_region`).
    The second is taken where less of its boundary is without an edge, as where the first has lobes or misses a part,
    and where the first has leaked; else the first. To the second, small pieces of the first are added or taken away
    where the edges support it (`with_pieces`). Where the region ends at the level between two fluids
    (`find_fluid_level`), it is continued by the layer behind that.

    Parameters
    ----------
    image : Image or path
    seeds : array_like, shape (n, 3) or (3,)
        Points in the organ, RAS mm. A seed up to 4 mm beside the voxels within the threshold is moved to the nearest.
    threshold : (float, float), optional
        Lowest and highest grey level of the organ, the same everywhere. By default, limits that follow the signal
        along the organ, `Limits.along`; ``threshold`` of the result is what is typical of them.
    erosion : float, optional
        Radius of the erosion in mm. Slices thicker than it are not eroded into one another. By default 2 mm, or
        the first of 4 and 6 mm at which the region is at most 1.3 times what the rays from the seeds span
        (`find_edges`), or less where the organ is too thin for 2 mm or would fall into pieces.
    dilation : float, optional
        Radius of the dilation in mm, by default that of the erosion.
    fill : bool
        Fill cavities.

    Returns
    -------
    Region
        An organ cut by the border of the volume is not an error: see ``touches_border``. Nor is one much larger
        than what the rays span: see ``diagnostics``.

    Raises
    ------
    ValueError
        If the volume is not given in mm, if a seed lies outside of it or of the threshold or does not survive the
        erosion, if the threshold or a radius makes no sense, if the seeds lie in separate pieces, or if the region has
        leaked over most of the volume: then with a threshold or an erosion that was tried and works, if there is one.

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
            return _with_layer(image, seeds, _chosen(image, seeds, fill), fill)
        return grown_region(image, seeds, threshold=threshold, erosion=erosion, dilation=dilation, fill=fill)
    except TooLarge as error:
        tried = remedy(image, seeds, error.threshold, erosion=erosion, dilation=dilation, fill=fill)
        msg = f"{error} {tried}"
        raise ValueError(msg) from error


def _with_layer(image: Image, seeds: np.ndarray, region: Region, fill: bool) -> Region:
    """Continue a region that ends at a level between two fluids by the layer behind it.

    Without the contrast at the level, limits of grey levels along an organ leak, so it is done by the organ's shape.
    """
    level = find_fluid_level(image, region)
    if level is None:
        return region
    even = level.removed_from(image)
    values = {"area_cm2": level.area_cm2, "side": level.side}
    ends = replace(region, diagnostics=(*region.diagnostics, Diagnostic("ends_at_level", values)))
    found = shaped_region(even, seeds, fill=fill)
    if found is None:
        return ends
    shaped, star = found
    if not level.is_passed_by(shaped) or level.support_behind(even, shaped, star) < _LEAST_SUPPORT:
        return ends
    whole = _better(even, level.joined(image, region, shaped), shaped, star, fill)
    included = Diagnostic("layer_included", {**values, "layer_ml": level.layer_ml(whole)})
    by_code = {found.code: found for found in (*region.diagnostics, *whole.diagnostics, included)}
    return replace(whole, diagnostics=tuple(by_code.values()))


def _chosen(image: Image, seeds: np.ndarray, fill: bool) -> Region:
    """Separate an organ in both ways, and choose."""
    try:
        grown, refused = grown_region(image, seeds, fill=fill), None
    except ValueError as error:
        grown, refused = None, error
    found = shaped_region(image, seeds, fill=fill)
    if found is None:
        if refused is not None:
            raise refused
        return grown
    shaped, star = found
    if grown is None:
        if edge_support(image, shaped, star) < _LEAST_SUPPORT or _is_noise(image, seeds, star):
            raise refused
        return shaped
    return _better(image, grown, shaped, star, fill)


def _better(image: Image, grown: Region, shaped: Region, star: Star, fill: bool) -> Region:
    """Choose the region that the image supports better; the shape is completed by pieces of the other one."""
    # A leak has edges too, at other tissue.
    leaked = bool(grown.diagnostics) and edge_support(image, shaped, star) >= _LEAST_SUPPORT
    less = np.subtract(*(area_without_edge(image, region, star) for region in (grown, shaped)))
    same = agreement(grown, shaped) >= _SAME_ORGAN
    better = grown
    if leaked or less > (_LESS_WITHOUT_EDGE if same else 0.0):
        better = with_pieces(image, shaped, grown, star, fill=fill)
    if same:
        return better
    sizes = {"grown_ml": grown, "shaped_ml": shaped, "taken_ml": better}
    values = {name: float(region.volume_ml) for name, region in sizes.items()}
    return replace(better, diagnostics=(*better.diagnostics, Diagnostic("starts_differ", values)))


def _is_noise(image: Image, seeds: np.ndarray, star: Star) -> bool:
    """Whether what differs around the seeds differs by no more than noise does."""
    return star.contrast < _NOISE * float(levels_at(image, seeds, star.contrast)[1].max())
