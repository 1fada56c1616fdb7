"""Grey levels that tell an organ from its surroundings, found from seeds in it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .image import Image
from .sampling import Sampler

_NUDGE_MM = 1e-6 * np.array([1.0, 1.7, 2.9])
# Level around a seed: the voxels within this distance.
_BALL_MM = 3.0
# Inside level along a ray: the mean over a window that ends before the sample, clear of a blurred edge.
_WINDOW_MM, _LAG_MM = 6.0, 1.5
# Behind the edge, the outside level is the one farthest from the inside within this depth, as in a thin wall.
_DEPTH_MM = 4.0
_LONGEST_RAY_MM = 150.0
# Rays within 15 degrees of each other are neighbours.
_COS_AROUND = np.cos(np.deg2rad(15.0))
# An edge is a step by this share of the level, or by this many standard deviations of the noise.
_STEP_SHARE, _STEP_NOISE = 0.3, 4.0
# Fewer edges than this share of the rays are chance; and a side of the threshold needs a share of the edges.
_FEWEST_EDGES, _FEWEST_ON_SIDE = 0.1, 0.25


@dataclass(frozen=True, eq=False)
class Edges:
    """Where rays from the seeds leave the organ, one entry per ray.

    Attributes
    ----------
    distances : ndarray, shape (n_seeds, n_rays)
        From the seed to the edge in mm; to the end of the ray where no edge was found.
    found : ndarray of bool, shape (n_seeds, n_rays)
    points : ndarray, shape (n_seeds, n_rays, 3)
        Where the rays end, RAS mm.
    inner, outer : ndarray, shape (n_seeds, n_rays)
        Grey levels before and behind the edge; meaningless where none was found.
    middle, spread : float
        Median and scaled median absolute deviation of the grey levels inside.
    volume : float
        Volume in mm^3 that the rays span, of the seed that sees most: the mean over the rays of 4/3 pi r^3.
        It is right for an organ that the seed sees all of.
    """

    distances: np.ndarray
    found: np.ndarray
    points: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    middle: float
    spread: float
    volume: float


def find_edges(image: Image, seeds) -> Edges:
    """Follow rays from the seeds to the first place where the grey level changes for good.

    Parameters
    ----------
    image : Image
    seeds : array_like, shape (n, 3) or (3,)
        Points in the organ, RAS mm.

    Returns
    -------
    Edges

    Raises
    ------
    ValueError
        If a seed is not a point of the volume.

    Notes
    -----
    A change is a step away from the mean of the last millimetres, so a coil's slow bias is followed.
    The directions of the rays are symmetric under any permutation and flip of the image's axes and turn with
    them, so a permuted, flipped or rotated copy of the volume gives the same edges.
    """
    seeds = checked_seeds(image, seeds)
    step = float(image.spacing.min())
    directions = _directions(image)
    profiles, valid = _profiles(image, seeds, directions, step)
    level, noise = _levels_at(image, seeds)
    rays = len(directions)
    edge, inner, outer = _steps(profiles, valid, np.repeat(level, rays), np.repeat(noise, rays), step)
    found = edge >= 0
    last = np.where(found, edge, valid.sum(axis=1))
    inside = profiles[(np.arange(profiles.shape[1]) < last[:, None]) & valid & found[:, None]]
    middle = float(np.median(np.concatenate([inside, level])))
    spread = 1.4826 * float(np.median(np.abs(inside - middle))) if inside.size else 0.0
    shape = (len(seeds), rays)
    distances = (last * step).reshape(shape)
    return Edges(
        distances=distances,
        found=found.reshape(shape),
        points=seeds[:, None, :] + distances[..., None] * directions,
        inner=inner.reshape(shape),
        outer=outer.reshape(shape),
        middle=middle,
        spread=spread,
        volume=_spanned_volume(distances, directions),
    )


def suggest_threshold(image: Image, seeds) -> tuple[float, float]:
    """Suggest the lowest and highest grey level of the organ that holds the seeds.

    Rays run from every seed to the organ's edge (`find_edges`). The limit towards the levels outside is half
    way between the levels before and behind the edges. A side with few edges is limited by the spread of the
    levels inside, but no nearer than the level outside is on the other side.

    Parameters
    ----------
    image : Image
    seeds : array_like, shape (n, 3) or (3,)
        Points in the organ, RAS mm. They need not be central.

    Returns
    -------
    low, high : float

    Raises
    ------
    ValueError
        If a seed is outside the volume, or the rays find no edge.
    """
    return threshold_between(find_edges(image, seeds))


def threshold_between(edges: Edges) -> tuple[float, float]:
    """Put the threshold of `suggest_threshold` between the levels before and behind known edges."""
    falls = edges.found & (edges.outer < edges.inner)
    rises = edges.found & (edges.outer > edges.inner)
    if edges.found.sum() < _FEWEST_EDGES * edges.found.size:
        msg = (
            f"No edge of an organ was found around the seeds (grey level {edges.middle:.6g}); give the "
            "threshold as its lowest and highest grey level."
        )
        raise ValueError(msg)
    least = _FEWEST_ON_SIDE * edges.found.sum()
    half = (edges.inner + edges.outer) / 2
    low = np.median(half[falls]) if falls.sum() >= least else None
    high = np.median(half[rises]) if rises.sum() >= least else None
    if low is None:
        low = edges.middle - max(6 * edges.spread, np.median((edges.outer - edges.inner)[rises]))
    if high is None:
        high = edges.middle + max(6 * edges.spread, np.median((edges.inner - edges.outer)[falls]))
    return float(low), float(high)


def checked_seeds(image: Image, seeds) -> np.ndarray:
    """Bring seeds to shape (n, 3), RAS mm, and refuse those that are not points of the volume."""
    try:
        points = np.atleast_2d(np.asarray(seeds, dtype=float))
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        msg = f"The seeds have shape {np.shape(seeds)}; give at least one point R, A, S (mm) in the organ."
        raise ValueError(msg)
    if not np.isfinite(points).all():
        msg = "A seed has a coordinate that is not finite; give R, A, S in mm."
        raise ValueError(msg)
    with np.errstate(over="ignore", invalid="ignore"):
        index = image.to_ijk(points)
    # Not the other way round: a point so far away that its index overflows has no order.
    outside = ~((index >= -0.5) & (index <= image.size - 0.5)).all(axis=1)
    if outside.any():
        corners = image.to_ras(list(itertools.product(*([-0.5, n - 0.5] for n in image.size))))
        ranges = ", ".join(
            f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in zip("RAS", corners.min(0), corners.max(0))
        )
        place = ", ".join(f"{value:.1f}" if abs(value) < 1e6 else f"{value:g}" for value in points[outside][0])
        msg = f"The seed ({place}) mm lies outside the volume ({ranges} mm); place it in the organ (RAS mm)."
        raise ValueError(msg)
    return points


def voxels_of(image: Image, points) -> np.ndarray:
    """Voxels (k, j, i) that hold RAS points of the volume, shape (n, 3).

    A point between two voxels goes to the one on its right, anterior or superior side, whichever way the axes
    of the grid run.
    """
    index = image.to_ijk(np.asarray(points) + _NUDGE_MM)
    return np.rint(index[:, ::-1]).astype(int).clip(0, np.array(image.array.shape) - 1)


def _directions(image):
    """Return unit vectors along small whole-number directions of the grid's axes, RAS, (n, 3)."""
    whole = np.array([v for v in itertools.product(range(-3, 4), repeat=3) if np.gcd.reduce(v) == 1], dtype=float)
    directions = whole @ (image.ijk_to_ras[:3, :3] / image.spacing).T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _spanned_volume(distances, directions):
    """Volume of `Edges`, with every ray as long as the median of those around it: some slip through gaps."""
    around = directions @ directions.T > _COS_AROUND
    lengths = np.nanmedian(np.where(around, distances[:, None, :], np.nan), axis=2)
    return float(4 / 3 * np.pi * (lengths**3).mean(axis=1).max())


def _profiles(image, seeds, directions, step):
    """Grey levels along the rays of all seeds, shape (rays, samples), and where they are in the volume."""
    distances = np.arange(0.0, _LONGEST_RAY_MM, step)
    rays = directions[:, None, :] * distances[:, None]
    levels, valid = Sampler(image).values(seeds[:, None, None, :] + rays)
    levels = levels.reshape(-1, len(distances))
    # Single voxels of noise do not end an organ.
    return ndimage.median_filter(levels, size=(1, 3), mode="nearest"), valid.reshape(levels.shape)


def _levels_at(image, seeds):
    """Robust level and noise (median and scaled median deviation) in a ball around each seed."""
    reach = np.maximum(np.floor(_BALL_MM / image.spacing), 1)
    offsets = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = offsets[np.linalg.norm(offsets * image.spacing, axis=1) <= max(_BALL_MM, image.spacing.min())]
    voxels = voxels_of(image, seeds)[:, None, ::-1] + offsets.astype(int)
    voxels = voxels.clip(0, image.size - 1)
    levels = image.array[voxels[..., 2], voxels[..., 1], voxels[..., 0]].astype(float)
    middle = np.median(levels, axis=1)
    return middle, 1.4826 * np.median(np.abs(levels - middle[:, None]), axis=1)


def _steps(profiles, inside_volume, level, noise, step):
    """Find the first lasting step along each ray.

    Returns the sample of the edge (-1 where there is none) and the levels before and behind it.
    """
    window, lag = int(np.ceil(_WINDOW_MM / step)), int(np.ceil(_LAG_MM / step))
    before = np.repeat(level[:, None], window + lag, axis=1)
    sums = np.cumsum(np.hstack([np.zeros((len(level), 1)), before, profiles]), axis=1)
    running = (sums[:, window : window + profiles.shape[1]] - sums[:, : profiles.shape[1]]) / window

    smallest_step = np.maximum(_STEP_NOISE * noise, _STEP_SHARE * np.abs(level))
    far = (np.abs(profiles - running) > smallest_step[:, None]) & inside_volume
    far[:, :-1] &= far[:, 1:]
    edge = np.where(far.any(axis=1), far.argmax(axis=1), -1)

    at = np.maximum(edge, 0)[:, None]
    inner = np.take_along_axis(running, at, axis=1)
    depth = np.minimum(at + np.arange(max(int(round(_DEPTH_MM / step)), 2)), profiles.shape[1] - 1)
    behind = np.take_along_axis(profiles, depth, axis=1) - inner
    behind *= np.take_along_axis(inside_volume, depth, axis=1)
    signed = behind * np.sign(behind[:, :1])
    outer = inner + signed.max(axis=1, keepdims=True) * np.sign(behind[:, :1])
    return edge, inner[:, 0], outer[:, 0]
