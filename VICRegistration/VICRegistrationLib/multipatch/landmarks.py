"""Landmarks: named points on bone, which guide the fit of a model where it is far from organs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..files import reason
from ..frames import RAS_TO_LPS
from .model import MultiPatchModel

# A landmark farther than this from its position by the organs alone has a wrong name or frame.
LARGEST_DISTANCE_MM = 30.0


def read_landmarks(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Read landmarks from a file.

    Parameters
    ----------
    path : path
        A point list of Slicer (.mrk.json) with the names as labels, or a JSON object of names with R, A, S in mm.

    Returns
    -------
    dict of str to (3,) ndarray
        RAS mm.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no such file, or a name occurs twice.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        msg = f"The landmarks {path} cannot be read ({reason(error)}); give a file that exists."
        raise OSError(msg) from error
    except (ValueError, RecursionError) as error:
        msg = f"The landmarks {path} are not valid JSON ({reason(error)}); correct the file."
        raise ValueError(msg) from error
    pairs = _of_slicer(content, path) if isinstance(content, dict) and "markups" in content else None
    if pairs is None:
        pairs = list(content.items()) if isinstance(content, dict) else []
    found = {}
    for name, place in pairs:
        if name in found:
            msg = f"The landmarks {path} hold {name!r} twice; remove one."
            raise ValueError(msg)
        found[name] = _checked(name, place, path)
    if not found:
        msg = f"{path} holds no landmarks; give a point list of Slicer, or an object of names with [R, A, S] in mm."
        raise ValueError(msg)
    return found


def _of_slicer(content: Mapping[str, object], path: Path) -> list[tuple[str, object]]:
    """Labels and positions of the points that have a position, RAS mm."""
    pairs = []
    try:
        for markup in content["markups"]:
            sides = np.ones(3) if markup.get("coordinateSystem", "LPS") in ("RAS", "0") else RAS_TO_LPS
            for point in markup["controlPoints"]:
                if point.get("positionStatus", "defined") == "defined":
                    pairs.append((str(point["label"]), (np.array(point["position"], dtype=float) * sides).tolist()))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        msg = f"{path} is no point list of Slicer ({reason(error)}); save the list as .mrk.json again."
        raise ValueError(msg) from error
    return pairs


def _checked(name: str, place: object, path: Path) -> np.ndarray:
    try:
        point = np.array(place, dtype=float)
    except (TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        msg = f"The landmark {name!r} in {path} is {place!r}; three numbers R, A, S in mm are needed."
        raise ValueError(msg)
    return point


def check_names(model: MultiPatchModel, landmarks: Mapping[str, np.ndarray]) -> None:
    """Refuse landmarks that a model does not have."""
    unknown = [name for name in landmarks if name not in model.landmarks]
    if unknown:
        known = "; ".join(model.landmarks) or "none"
        msg = f"The model has no landmark {unknown[0]!r}; it has: {known}. Name it like one of these, or remove it."
        raise ValueError(msg)


def check_distances(landmarks: Mapping[str, np.ndarray], expected: np.ndarray) -> None:
    """Refuse landmarks that are far from where they are expected.

    Parameters
    ----------
    landmarks : mapping of str to (3,) ndarray
        RAS mm.
    expected : (n, 3) ndarray
        Their positions by the map that follows from the organs alone, RAS mm.

    Raises
    ------
    ValueError
        If one is more than `LARGEST_DISTANCE_MM` away.
    """
    away = np.linalg.norm(np.array(list(landmarks.values())) - expected, axis=1)
    worst = int(away.argmax())
    if away[worst] > LARGEST_DISTANCE_MM:
        place = ", ".join(f"{value:.0f}" for value in expected[worst])
        msg = (
            f"The landmark {list(landmarks)[worst]!r} is {away[worst]:.0f} mm from ({place}) mm, where it is expected "
            f"by the organs; up to {LARGEST_DISTANCE_MM:g} mm is plausible. Check its name, and its frame (RAS or LPS)."
        )
        raise ValueError(msg)
