"""Checks of a model: detached parts, folds, parts that pass through others, another unit or frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from vtkmodules.vtkFiltersModeling import vtkSelectEnclosedPoints

from ..geometry.polydata import polydata
from ..geometry.validity import check_surface, crossing_triangles
from ..messages import Diagnostic
from .model import MultiPatchModel, Part, Patch
from .topology import open_edges, share_of_points, shell
from .triangles import model_triangles

# Smallest and largest diagonal of the box around an organ, mm.
_ORGAN_SIZES = (15.0, 500.0)
# A part passes through an organ if it is deeper inside than this, mm. From 1e-9 to 0.5 the same is found: nothing in
# the pelvis as it ships, deformed at random or fitted to the demo; and a cord that was drawn through the rectum.
_DEEP = 0.1
# Largest distance of a landmark from the nearest point of the model, mm; about 25 mm in the model that ships.
_FAR_LANDMARK = 100.0
# Samples of a patch in each direction.
_SAMPLES = 13


def check_model(model: MultiPatchModel) -> tuple[Diagnostic, ...]:
    """Look for everything that makes a model unusable.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    tuple of Diagnostic
        Empty for a good model. Parts that pass through others are looked for only if nothing else is wrong.
    """
    found = [*_sizes(model), *_frame(model), *_organs(model), *check_connections(model), *_folds(model)]
    found = found or _landmarks(model)
    return tuple(found or [*through_organs(model), *through_cords(model), *through_sheets(model)])


def check_connections(model: MultiPatchModel) -> tuple[Diagnostic, ...]:
    """Look for sheets and cords that are not attached, and cords that are not closed.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    tuple of Diagnostic
    """
    found = []
    for part in model.parts:
        own = model.patches_of(part.name)
        if part.kind == "cord":
            found += _cord(model, part)
        elif part.kind == "sheet":
            others = [patch for patch in model.patches if patch.part != part.name]
            if sum(share_of_points(patch, others) > 1 for patch in own) == 0:
                found.append(Diagnostic("part_detached", {"part": part.name}))
    return tuple(found)


def require_meshable(model: MultiPatchModel) -> None:
    """Refuse a model that is not in mm, or whose parts are not attached.

    Raises
    ------
    ValueError
        With the sentence of the first problem.
    """
    found = [*_sizes(model), *check_connections(model)]
    if found:
        msg = f"The model cannot be meshed: {found[0].sentence()}"
        raise ValueError(msg)


def through_organs(model: MultiPatchModel) -> Iterator[Diagnostic]:
    """Find sheets and cords that pass through an organ, and organs that overlap.

    Parameters
    ----------
    model : MultiPatchModel

    Yields
    ------
    Diagnostic
        One for each part and organ, with the deepest place; two organs that overlap are reported once.
    """
    for part in model.parts:
        points = _part_samples(model, part)
        first = model.organs.index(part.name) + 1 if part.kind == "organ" else 0
        for organ, parent in list(model.parents.items())[first:]:
            low, high = parent.control_net.min(axis=(0, 1)), parent.control_net.max(axis=(0, 1))
            near = points[((points > low) & (points < high)).all(axis=1)]
            if not len(near):
                continue
            distances = parent.closest_points(near).distances
            deepest = int(np.argmin(distances))
            if distances[deepest] < -_DEEP:
                depth = {"depth_mm": -float(distances[deepest])}
                code = "organs_overlap" if part.kind == "organ" else "passes_through_organ"
                yield Diagnostic(code, {"part": part.name, "organ": organ, **depth, **_place(near[deepest])})


def through_cords(model: MultiPatchModel) -> Iterator[Diagnostic]:
    """Find sheets and cords that pass through a cord.

    Parameters
    ----------
    model : MultiPatchModel

    Yields
    ------
    Diagnostic
        One for each part and cord, with a place.
    """
    mesh = model_triangles(model)
    samples = {part.name: _part_samples(model, part) for part in model.parts if part.kind != "organ"}
    for cord in model.parts:
        if cord.kind != "cord":
            continue
        bounds = polydata(mesh.points, mesh.triangles[mesh.of(patch for patch, _ in shell(model, cord))])
        for name, points in samples.items():
            if name == cord.name:
                continue
            inside = points[_enclosed(points, bounds)]
            if len(inside):
                yield Diagnostic("passes_through_cord", {"part": name, "cord": cord.name, **_place(inside[0])})


def through_sheets(model: MultiPatchModel) -> Iterator[Diagnostic]:
    """Find sheets that pass through other sheets.

    Parameters
    ----------
    model : MultiPatchModel

    Yields
    ------
    Diagnostic
        One for each pair of sheets, with a place.
    """
    sheets = [part.name for part in model.parts if part.kind == "sheet"]
    if len(sheets) < 2:
        return
    mesh = model_triangles(model)
    numbers = np.array([sheets.index(patch.part) if patch.part in sheets else -1 for patch in model.patches])
    sheet_of = numbers[mesh.patch_of]
    triangles, sheet_of = mesh.triangles[sheet_of >= 0], sheet_of[sheet_of >= 0]
    pairs = crossing_triangles(mesh.points, triangles)
    pairs = np.take_along_axis(pairs, np.argsort(sheet_of[pairs], axis=1), axis=1)
    found = sheet_of[pairs]
    for first, second in np.unique(found[found[:, 0] < found[:, 1]], axis=0):
        one = pairs[(found == (first, second)).all(axis=1)][0]
        place = mesh.points[triangles[one]].mean(axis=(0, 1))
        yield Diagnostic("passes_through_sheet", {"part": sheets[first], "sheet": sheets[second], **_place(place)})


def patch_samples(model: MultiPatchModel, patch: Patch) -> np.ndarray:
    """Points of a patch at the middles of equal parameter intervals, (n, 3) RAS mm."""
    surface = patch.surface(model.points)
    return surface.points(*surface.midpoints(_SAMPLES, _SAMPLES))


def _part_samples(model: MultiPatchModel, part: Part) -> np.ndarray:
    return np.concatenate([patch_samples(model, patch) for patch in model.patches_of(part.name)])


def _enclosed(points: np.ndarray, bounds) -> np.ndarray:
    selection = vtkSelectEnclosedPoints()
    selection.SetInputData(polydata(points, np.zeros((0, 3), dtype=int)))
    selection.SetSurfaceData(bounds)
    selection.SetTolerance(1e-6)
    selection.Update()
    return np.array([bool(selection.IsInside(number)) for number in range(len(points))])


def _cord(model: MultiPatchModel, part: Part) -> list[Diagnostic]:
    """Problems of a cord: it does not have all points of its foot's border, or is not closed."""
    foot = model.patch(part.foot)
    needed = len(np.unique(np.concatenate(list(foot.borders().values()))))
    found = share_of_points(foot, model.patches_of(part.name))
    if found < needed:
        values = {"part": part.name, "foot": foot.name, "found": found, "needed": needed}
        return [Diagnostic("foot_detached", values)]
    faces = shell(model, part)
    return [
        Diagnostic("part_not_closed", {"part": part.name, "patch": side.patch.name, "side": side.name})
        for side in open_edges(faces)[:1]
    ]


def _organs(model: MultiPatchModel) -> list[Diagnostic]:
    """Problems of the closed surfaces."""
    return [
        Diagnostic("organ_invalid", {"part": organ, "problem": problem.diagnostic})
        for organ, parent in model.parents.items()
        for problem in check_surface(parent)[:1]
    ]


def _folds(model: MultiPatchModel) -> list[Diagnostic]:
    """Patches where normals of neighbouring samples differ by 90 degrees or more."""
    found = []
    for patch in model.patches:
        surface = patch.surface(model.points)
        u, v = surface.midpoints(_SAMPLES, _SAMPLES)
        normals = surface.normals(u, v).reshape(_SAMPLES, _SAMPLES, 3)
        turned = np.zeros((_SAMPLES, _SAMPLES), dtype=bool)
        turned[1:] |= (normals[1:] * normals[:-1]).sum(axis=2) <= 0.0
        turned[:, 1:] |= (normals[:, 1:] * normals[:, :-1]).sum(axis=2) <= 0.0
        if turned.any():
            at = int(np.flatnonzero(turned)[0])
            point = surface.points(u[at : at + 1], v[at : at + 1])[0]
            found.append(Diagnostic("patch_folded", {"patch": patch.name, **_place(point)}))
    return found


def _sizes(model: MultiPatchModel) -> list[Diagnostic]:
    """Organs that are too small or too large."""
    low, high = _ORGAN_SIZES
    return [
        Diagnostic("another_unit", {"part": organ, "size_mm": parent.size, "least_mm": low, "most_mm": high})
        for organ, parent in model.parents.items()
        if not low <= parent.size <= high
    ]


def _frame(model: MultiPatchModel) -> list[Diagnostic]:
    """Parts whose names contradict RAS: x runs to the left, or y to the back."""
    found = []
    places = {**{part.name: _middle(model, part) for part in model.parts}, **model.landmarks}
    for name, place in places.items():
        other = f"left{name[5:]}"
        if name.startswith("right") and other in places and place[0] < places[other][0]:
            found.append(Diagnostic("another_frame", {"first": name, "second": other, "direction": "to the left of"}))
    if {"bladder", "rectum"} <= set(places) and places["bladder"][1] < places["rectum"][1]:
        values = {"first": "rectum", "second": "bladder", "direction": "in front of"}
        found.append(Diagnostic("another_frame", values))
    return found[:1]


def _landmarks(model: MultiPatchModel) -> list[Diagnostic]:
    """Landmarks that lie far from all points of the model."""
    found = []
    for name, place in model.landmarks.items():
        away = float(np.linalg.norm(model.points - place, axis=1).min())
        if away > _FAR_LANDMARK:
            found.append(Diagnostic("model_landmark_far", {"landmark": name, "away_mm": away, **_place(place)}))
    return found


def _middle(model: MultiPatchModel, part: Part) -> np.ndarray:
    return model.points[np.concatenate([patch.indices.ravel() for patch in model.patches_of(part.name)])].mean(axis=0)


def _place(point: np.ndarray) -> dict[str, float]:
    return dict(zip("ras", np.asarray(point).tolist()))
