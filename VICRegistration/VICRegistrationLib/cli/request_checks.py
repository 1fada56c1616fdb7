"""Checks of requests against the image, before the first organ is fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..imaging.image import Image
from ..registration.boundary_points import LARGEST_DISTANCE_MM
from ..segmentation.seeds import point_outside
from .configuration import OrganRequest


def check_request(image: Image, request: OrganRequest) -> None:
    """Refuse seeds and boundary points outside of an image, and a threshold beyond its grey levels.

    Parameters
    ----------
    image : Image
    request : OrganRequest

    Raises
    ------
    ValueError
        The message has the points in RAS mm if they lie in the image as LPS coordinates or as voxel indices.
    """
    _check_points(image, "seed", request.seeds)
    # The wall may lie beyond the border of the volume, but not farther than a correction can move the surface.
    _check_points(image, "boundary", request.boundary, reach=LARGEST_DISTANCE_MM)
    if request.options.threshold is not None:
        _check_threshold(image, *request.options.threshold)


def _check_points(image: Image, word: str, points: Sequence[Sequence[float]], *, reach: float = 0.0) -> None:
    """Refuse points that lie farther than `reach` mm outside of an image."""
    inside = _inside(image, points, reach)
    if all(inside):
        return
    first = np.asarray(points[inside.index(False)], dtype=float)
    what = "seed" if word == "seed" else "boundary point"
    msg = f"{point_outside(image, what, first)}. {_advice(image, word, points)}"
    raise ValueError(msg)


def _advice(image: Image, word: str, points: Sequence[Sequence[float]]) -> str:
    """Say in which other coordinates the points lie in the image, if so, and give them in RAS mm."""
    meant = {
        "LPS coordinates (of DICOM, ITK and ITK-SNAP)": np.asarray(points, dtype=float) * (-1.0, -1.0, 1.0),
        "voxel indices i,j,k": _from_indices(image, points),
    }
    likely = {what: ras for what, ras in meant.items() if _all_in(image, ras)}
    if not likely:
        return "Give RAS coordinates in mm, as Slicer shows them for the mouse pointer."
    which = "it" if len(points) == 1 else "all of them"
    return " ".join(f"Taken as {what}, {which} would lie inside: {_call(word, ras)}." for what, ras in likely.items())


def _from_indices(image: Image, points: Sequence[Sequence[float]]) -> np.ndarray | None:
    """RAS coordinates of points that are voxels, (n, 3) mm."""
    indices = np.asarray(points, dtype=float)
    if np.any(indices != np.round(indices)) or np.any(indices < 0) or np.any(indices >= image.size):
        return None
    return image.to_ras(indices)


def _all_in(image: Image, points: np.ndarray | None) -> bool:
    return points is not None and all(_inside(image, points))


def _inside(image: Image, points: Sequence[Sequence[float]], reach: float = 0.0) -> list[bool]:
    """Whether points lie in a voxel of the volume, or not farther than `reach` mm from one."""
    places = np.asarray(points, dtype=float).reshape(-1, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        index = image.to_ijk(places)
        nearest = np.clip(index, -0.5, image.size - 0.5)
        away = np.linalg.norm(image.to_ras(nearest) - image.to_ras(index), axis=1)
    # Equality, because comparisons with an index that has overflowed to NaN are False.
    return ((index == nearest).all(axis=1) | (away <= reach)).tolist()


def _call(word: str, points: np.ndarray) -> str:
    """Text with points as flags and as a key of the configuration."""
    texts = [[f"{round(float(value), 2) + 0.0:g}" for value in point] for point in points]
    flags = " ".join(f"--{word}={','.join(text)}" for text in texts)
    lists = ", ".join(f"[{', '.join(text)}]" for text in texts)
    return f'in RAS mm, give {flags} (in a configuration "{word}": [{lists}])'


def _check_threshold(image: Image, low: float, high: float) -> None:
    least, most = float(image.array.min()), float(image.array.max())
    if low > high or (low <= most and high >= least):
        return
    msg = (
        f"The threshold {low:g} to {high:g} contains no voxel: the grey levels of the image go from {least:g} to "
        f"{most:g}. Give the lowest and the highest grey level of the organ."
    )
    raise ValueError(msg)
