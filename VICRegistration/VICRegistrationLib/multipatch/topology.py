"""Topology of a model: which patches have a border in common, and in which direction they run along it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .model import MultiPatchModel, Part, Patch

# Borders of a patch in counter-clockwise order, seen against its normal; whether the parameter falls along them.
_ROUND = (("v_min", False), ("u_max", False), ("v_max", True), ("u_min", True))


@dataclass(frozen=True, eq=False)
class Side:
    """One border of a patch.

    Parameters
    ----------
    patch : Patch
    name : {"u_min", "u_max", "v_min", "v_max"}
    edge : tuple of int
        Indices of the border's control points, in the same order for all patches that share it.
    forward : bool
        Whether the border has that order when it is followed counter-clockwise around the patch.
    same : bool
        Whether the patch's parameter grows in the order of `edge`.
    """

    patch: Patch
    name: str
    edge: tuple[int, ...]
    forward: bool
    same: bool

    @property
    def axis(self) -> int:
        """Parameter along the border: 0 for u, 1 for v."""
        return 1 if self.name.startswith("u") else 0


def sides(patch: Patch) -> list[Side]:
    """Return the borders of a patch counter-clockwise, without those that are a single point (a pole)."""
    found, borders = [], patch.borders()
    for name, backwards in _ROUND:
        row = tuple(int(index) for index in borders[name])
        if len(set(row)) > 1:
            edge = min(row, row[::-1])
            same = edge == row
            found.append(Side(patch, name, edge, same != backwards, same))
    return found


def shell(model: MultiPatchModel, part: Part) -> list[tuple[Patch, bool]]:
    """Return the patches of a part as a shell, each with whether its normal has to be reversed.

    The shell of a cord has its foot too, whose normal points into the cord. Patches of a sheet are reversed so that all
    normals point to the same side.
    """
    patches = [(patch, False) for patch in model.patches_of(part.name)]
    if part.kind == "cord":
        return [(model.patch(part.foot), True), *patches]
    return _oriented([patch for patch, _ in patches]) if part.kind == "sheet" else patches


def sides_by_edge(patches: Iterable[Patch]) -> dict[tuple[int, ...], list[Side]]:
    """Return the borders of patches by the control points that they share."""
    met: dict[tuple[int, ...], list[Side]] = {}
    for patch in patches:
        for side in sides(patch):
            met.setdefault(side.edge, []).append(side)
    return met


def open_edges(faces: Iterable[tuple[Patch, bool]]) -> list[Side]:
    """Find the borders of a shell that do not belong to exactly two patches with consistent normals."""
    met: dict[tuple[int, ...], list[tuple[Side, bool]]] = {}
    for patch, turned in faces:
        for side in sides(patch):
            met.setdefault(side.edge, []).append((side, side.forward != turned))
    return [ways[0][0] for ways in met.values() if sorted(way for _, way in ways) != [False, True]]


def _oriented(patches: list[Patch]) -> list[tuple[Patch, bool]]:
    """Reverse patches so that neighbours run along their common border in opposite directions, if possible."""
    turned: dict[str, bool] = {}
    met = sides_by_edge(patches)
    for start in patches:
        waiting = [] if start.name in turned else [start]
        turned.setdefault(start.name, False)
        while waiting:
            patch = waiting.pop()
            for side in sides(patch):
                for other in met[side.edge]:
                    if other.patch.name not in turned:
                        turned[other.patch.name] = turned[patch.name] != (side.forward == other.forward)
                        waiting.append(other.patch)
    return [(patch, turned[patch.name]) for patch in patches]


def share_of_points(patch: Patch, others: Iterable[Patch]) -> int:
    """Count the control points of a patch's borders that other patches share."""
    rim = np.unique(np.concatenate(list(patch.borders().values())))
    theirs = [other.indices.ravel() for other in others]
    return int(np.isin(rim, np.concatenate(theirs)).sum()) if theirs else 0
