"""Construction of a generic model: organs cut into patches, sheets from a border of a patch, cords from a patch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..geometry import bspline
from ..geometry.surface import BSplineSurface
from .cuts import OrganCuts
from .model import MultiPatchModel, Part, Patch, assembled

# Sheets and cords are cubic with two spans in the direction away from the organ, so that a map of space can bend them.
_DEGREE = 3
_ROWS = 5


@dataclass(frozen=True, eq=False)
class Border:
    """A B-spline curve that a sheet begins at.

    Parameters
    ----------
    indices : (n,) ndarray of int
        Indices of its control points.
    degree : int
    knots : (n + degree + 1,) ndarray
    """

    indices: np.ndarray
    degree: int
    knots: np.ndarray

    def positions(self) -> np.ndarray:
        """Return the Greville abscissae of the control points, (n,), scaled to 0 to 1."""
        places = bspline.greville_abscissae(self.degree, self.knots)
        return (places - places[0]) / (places[-1] - places[0])


class Drawing:
    """A model under construction.

    Parameters
    ----------
    parents : mapping of str to BSplineSurface
        Closed surface of each organ, RAS mm.
    cuts : mapping of str to OrganCuts
    """

    def __init__(self, parents: Mapping[str, BSplineSurface], cuts: Mapping[str, OrganCuts]) -> None:
        self._organs = assembled(parents, cuts, [Part(name, "organ") for name in parents])
        self._points = list(self._organs.points)
        self._patches = list(self._organs.patches)
        self._parts = list(self._organs.parts)
        self._fixed: dict[str, list[int]] = {}

    def point(self, index: int) -> np.ndarray:
        """Return the point with that index, (3,) RAS mm."""
        return self._points[index]

    def border(self, patch: str, side: str) -> Border:
        """Return the border of a patch at "u_min", "u_max", "v_min" or "v_max"."""
        found = self._patch(patch)
        axis = 1 if side.startswith("u") else 0
        return Border(found.borders()[side], found.degrees[axis], found.knots[axis])

    def line(self, first: int, last: int) -> Border:
        """Add a straight line between two points, given by their indices."""
        ends = np.array([self._points[first], self._points[last]])
        knots = bspline.uniform_clamped_knots(_DEGREE, _ROWS)
        places = bspline.greville_abscissae(_DEGREE, knots)[1:-1, None]
        inner = self._add((1.0 - places) * ends[0] + places * ends[1])
        return Border(np.concatenate([[first], inner, [last]]), _DEGREE, knots)

    def sheet(
        self,
        name: str,
        border: Border,
        end: np.ndarray,
        *,
        part: str = "",
        thickness: float = 2.0,
        first: np.ndarray | None = None,
        last: np.ndarray | None = None,
        fixed: str = "",
    ) -> Patch:
        """Add a patch of a sheet from a border to a curve in space.

        Parameters
        ----------
        name : str
            Name of the patch.
        border : Border
            Curve that it begins at.
        end : (k, 3) array_like
            Points on the curve that it ends at, in the order of the border, RAS mm.
        part : str
            Name of its sheet, which is added if it is new; by default that of the patch.
        thickness : float
            Thickness of the sheet, mm.
        first, last : (5,) ndarray of int, optional
            Indices of a neighbour's control points, from the border outward, that its first or last side shares.
        fixed : str
            Name of the place on bone that its end is fixed to.

        Returns
        -------
        Patch
            u along the border, v away from it.
        """
        knots = bspline.uniform_clamped_knots(_DEGREE, _ROWS)
        s, t = border.positions()[:, None, None], bspline.greville_abscissae(_DEGREE, knots)[:, None]
        begin = np.array([self._points[index] for index in border.indices])[:, None]
        net = (1.0 - t) * begin + t * _through(np.asarray(end, dtype=float), s[:, 0])[:, None]
        for place, share, side in ((0, 1.0 - s, first), (-1, s, last)):
            if side is not None:
                net = net + share * (np.array([self._points[index] for index in side]) - net[place])
        new = np.ones(net.shape[:2], dtype=bool)
        indices = np.zeros(net.shape[:2], dtype=int)
        new[:, 0], indices[:, 0] = False, border.indices
        for place, side in ((0, first), (-1, last)):
            if side is not None:
                new[place], indices[place] = False, side
        indices[new] = self._add(net[new])
        patch = Patch(name, part or name, (border.degree, _DEGREE), (border.knots, knots), indices)
        self._add_part(Part(part or name, "sheet", thickness))
        self._patches.append(patch)
        self._fix(fixed, indices[:, -1])
        return patch

    def cord(
        self,
        name: str,
        foot: str,
        end: Sequence[float],
        direction: Sequence[float],
        *,
        taper: float = 1.0,
        bow: Sequence[float] = (0.0, 0.0, 0.0),
        fixed: str = "",
    ) -> None:
        """Add a cord: a patch of an organ swept along a curve, with four sides and a flat end.

        Parameters
        ----------
        name : str
            Name of the part.
        foot : str
            Name of the organ's patch.
        end : (3,) array_like
            Centre of its end, RAS mm.
        direction : (3,) array_like
            Direction of its axis there.
        taper : float
            Ratio of the widths of end and foot.
        bow : (3,) array_like
            Displacement of the two inner control points of its axis, a cubic Bezier curve, mm.
        fixed : str
            Name of the place on bone that its end is fixed to.
        """
        base = self._patch(foot)
        rows = self._sections(base, np.asarray(end, dtype=float), np.asarray(direction, dtype=float), taper, bow)
        rim = np.ones(base.indices.shape, dtype=bool)
        rim[1:-1, 1:-1] = False
        whole = np.empty((_ROWS, *base.indices.shape), dtype=int)
        whole[0] = base.indices
        for number in range(1, _ROWS):
            kept = rim if number < _ROWS - 1 else np.ones_like(rim)
            whole[number][kept] = self._add(rows[number][kept])
        knots = bspline.uniform_clamped_knots(_DEGREE, _ROWS)
        (p, q), (along_u, along_v) = base.degrees, base.knots
        self._add_part(Part(name, "cord", foot=foot))
        # Normals outward.
        self._patches += [
            Patch(f"{name} side 1", name, (p, _DEGREE), (along_u, knots), whole[:, :, 0].T),
            Patch(f"{name} side 2", name, (q, _DEGREE), (along_v, knots), whole[:, -1, :].T),
            Patch(f"{name} side 3", name, (_DEGREE, p), (knots, along_u), whole[:, :, -1]),
            Patch(f"{name} side 4", name, (_DEGREE, q), (knots, along_v), whole[:, 0, :]),
            Patch(f"{name} end", name, (p, q), (along_u, along_v), whole[-1]),
        ]
        self._fix(fixed, whole[-1].ravel())

    def model(self, *, name: str, landmarks: Mapping[str, np.ndarray]) -> MultiPatchModel:
        """Return the model, with landmarks, RAS mm."""
        first = len(self._organs.points)
        return assembled(
            self._organs.parents,
            self._organs.cuts,
            self._parts,
            free_points=np.array(self._points[first:]),
            free_patches=self._patches[len(self._organs.patches) :],
            fixed={place: np.unique(group) for place, group in self._fixed.items()},
            landmarks=landmarks,
            name=name,
        )

    def _sections(self, base: Patch, end: np.ndarray, direction: np.ndarray, taper: float, bow) -> np.ndarray:
        """Control points of the cord's sections, (rows, n_u, n_v, 3)."""
        net = np.array([self._points[index] for index in base.indices.ravel()]).reshape(*base.indices.shape, 3)
        surface = BSplineSurface(base.degrees, *base.knots, net)
        (u,), (v,) = surface.midpoints(1, 1)
        normal, center = surface.normals([u], [v])[0], surface.points([u], [v])[0]
        direction = direction / np.linalg.norm(direction)
        reach = np.linalg.norm(end - center) / 3.0
        hull = np.array([center, center + reach * normal, end - reach * direction, end])
        hull[1:3] += bow
        axis = np.cross(normal, direction)
        angle = np.arctan2(np.linalg.norm(axis), normal @ direction)
        turn = Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * angle)
        t = bspline.greville_abscissae(_DEGREE, bspline.uniform_clamped_knots(_DEGREE, _ROWS))
        turns = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), turn]))(t).as_matrix()
        offset = net - center
        height = (offset @ normal)[..., None] * normal
        weights = np.column_stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
        sections = [
            place + ((offset - share * height) * (1.0 + share * (taper - 1.0))) @ matrix.T
            for place, share, matrix in zip(weights @ hull, t, turns)
        ]
        return np.array(sections)

    def _patch(self, name: str) -> Patch:
        for patch in self._patches:
            if patch.name == name:
                return patch
        msg = f"There is no patch {name!r}; the model has {', '.join(patch.name for patch in self._patches)}."
        raise ValueError(msg)

    def _add(self, points: np.ndarray) -> np.ndarray:
        first = len(self._points)
        self._points += list(points)
        return np.arange(first, len(self._points))

    def _add_part(self, part: Part) -> None:
        if part.name not in {known.name for known in self._parts}:
            self._parts.append(part)

    def _fix(self, place: str, indices: np.ndarray) -> None:
        if place:
            self._fixed.setdefault(place, []).extend(int(index) for index in indices)


def _through(points: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Points at s, (n, 1) from 0 to 1, of the polynomial curve through points (k, 3) at equal steps: (n, 3)."""
    at = np.linspace(0.0, 1.0, len(points))
    curve = np.polynomial.polynomial.polyfit(at, points, len(points) - 1)
    return np.polynomial.polynomial.polyval(s[:, 0], curve).T
