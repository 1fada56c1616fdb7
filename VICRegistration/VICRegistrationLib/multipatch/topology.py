"""Which patches of a model meet along which border, and in which direction."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .model import MultiPatchModel, Part, Patch

# Counter-clockwise seen from where the normal points: the borders of a patch, and whether they run backwards.
_ROUND = (("v_min", False), ("u_max", False), ("v_max", True), ("u_min", True))


@dataclass(frozen=True, eq=False)
class Side:
    """One border of a patch, where its surface lies to the left of the way.

    Parameters
    ----------
    patch : Patch
    name : {"u_min", "u_max", "v_min", "v_max"}
    edge : tuple of int
        Control points of the border in an order that is the same for all patches that share it.
    forward : bool
        Whether the way around the patch runs in that order.
    same : bool
        Whether the patch's parameter grows in that order.
    """

    patch: Patch
    name: str
    edge: tuple[int, ...]
    forward: bool
    same: bool

    @property
    def axis(self) -> int:
        """Along which parameter it runs: 0 for u, 1 for v."""
        return 1 if self.name.startswith("u") else 0


def sides(patch: Patch) -> list[Side]:
    """Return the borders of a patch around it, without those that are single points."""
    found, borders = [], patch.borders()
    for name, backwards in _ROUND:
        row = tuple(int(index) for index in borders[name])
        if len(set(row)) > 1:
            edge = min(row, row[::-1])
            same = edge == row
            found.append(Side(patch, name, edge, same != backwards, same))
    return found


def shell(model: MultiPatchModel, part: Part) -> list[tuple[Patch, bool]]:
    """Patches that bound or make up a part, each with whether its normal has to be turned.

    A cord is bounded by its foot too, whose normal points into it. Patches of a sheet are turned so that all show the
    same side.
    """
    patches = [(patch, False) for patch in model.patches_of(part.name)]
    if part.kind == "cord":
        return [(model.patch(part.foot), True), *patches]
    return _oriented([patch for patch, _ in patches]) if part.kind == "sheet" else patches


def sides_by_edge(patches: Iterable[Patch]) -> dict[tuple[int, ...], list[Side]]:
    """Borders of patches that are the same edge, by its control points."""
    met: dict[tuple[int, ...], list[Side]] = {}
    for patch in patches:
        for side in sides(patch):
            met.setdefault(side.edge, []).append(side)
    return met


def open_edges(faces: Iterable[tuple[Patch, bool]]) -> list[Side]:
    """Find the borders of a shell that two of its patches do not run along in opposite directions."""
    met: dict[tuple[int, ...], list[tuple[Side, bool]]] = {}
    for patch, turned in faces:
        for side in sides(patch):
            met.setdefault(side.edge, []).append((side, side.forward != turned))
    return [ways[0][0] for ways in met.values() if sorted(way for _, way in ways) != [False, True]]


def _oriented(patches: list[Patch]) -> list[tuple[Patch, bool]]:
    """Turn patches so that neighbours run along their common border in opposite directions, as far as that can be."""
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
    """Count the points of a patch's borders that other patches have too."""
    rim = np.unique(np.concatenate(list(patch.borders().values())))
    theirs = [other.indices.ravel() for other in others]
    return int(np.isin(rim, np.concatenate(theirs)).sum()) if theirs else 0
