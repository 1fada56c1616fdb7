"""Checks whether a surface bounds a solid: poles, normals, self-intersection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..messages import Diagnostic
from . import bspline
from .surface import BSplineSurface
from .triangulation import triangulate

# Smallest number of samples of the normals in u and v, about six degrees around an organ.
_LEAST_SAMPLES = (64, 40)
# No body lies farther from the origin than 100 m.
_FARTHEST_MM = 1e5


@dataclass(frozen=True)
class Problem:
    """One reason why a surface is not a valid organ.

    Parameters
    ----------
    kind : {"open", "folded pole", "flipped normal", "self-intersection"}
    diagnostic : Diagnostic
        What is wrong, and where.
    remedy : str
        What a caller who has the control net can do, as a sentence.
    parameters : (u, v)
        Place on the surface.
    point : (r, a, s)
        The same place, RAS mm.
    """

    kind: str
    diagnostic: Diagnostic
    remedy: str
    parameters: tuple[float, float]
    point: tuple[float, float, float]

    @property
    def message(self) -> str:
        """What is wrong, where, and what to do."""
        return f"{self.diagnostic.sentence()} {self.remedy}"


def check_surface(surface: BSplineSurface, *, require_closed: bool = True) -> tuple[Problem, ...]:
    """Find the reasons why a surface does not bound a solid.

    Parameters
    ----------
    surface : BSplineSurface
    require_closed : bool
        Whether an open surface is a problem too.

    Returns
    -------
    tuple of Problem
        Empty for a valid surface; otherwise one place of each kind, and each folded pole. A folded pole also has
        flipped normals, and a flipped normal causes intersections; so normals are checked only if no pole is folded,
        and intersections only if no normal is flipped.

    Notes
    -----
    Poles and normals are checked on samples of the exact surface, intersections on a triangulation, and confirmed on
    one that is twice as fine. Faults smaller than the spacing of the samples (about 1/50 of the circumference) may be
    missed.
    """
    problems = []
    if require_closed and not surface.closed:
        problems.append(_open_problem(surface))
    poles = [_pole_problem(surface, end) for end in (0, 1) if surface.poles[end]]
    poles = [problem for problem in poles if problem]
    folds = poles or [problem for problem in (_normal_problem(surface),) if problem]
    if not folds:
        folds = [problem for problem in (_intersection_problem(surface),) if problem]
    return tuple(problems + folds)


def check_place(surface: BSplineSurface) -> None:
    """Refuse a surface too far from the origin: it is in another unit, or its numbers are corrupt.

    Parameters
    ----------
    surface : BSplineSurface

    Raises
    ------
    ValueError
        If a control point lies farther from the origin than 100 m.
    """
    farthest = float(np.abs(surface.control_net).max())
    if farthest > _FARTHEST_MM:
        msg = (
            f"a control point has the coordinate {farthest:.3g} mm, and no body lies farther than {_FARTHEST_MM:g} mm "
            "from the origin; write the surface again, in mm."
        )
        raise ValueError(msg)


def validate(surface: BSplineSurface, *, require_closed: bool = True) -> None:
    """Raise the first problem of a surface.

    Parameters
    ----------
    surface, require_closed
        As in :func:`check_surface`.

    Raises
    ------
    ValueError
        With the message of the first problem, if there is any.
    """
    problems = check_surface(surface, require_closed=require_closed)
    if problems:
        raise ValueError(problems[0].message)


def _problem(
    surface: BSplineSurface, kind: str, code: str, u: float, v: float, remedy: str, **values: float
) -> Problem:
    """Make a problem at a place of the surface."""
    r, a, s = (float(x) for x in surface.points([u], [v])[0])
    u, v = float(u), float(v)
    diagnostic = Diagnostic(code, {"r": r, "a": a, "s": s, "u": u, "v": v, **values})
    return Problem(kind, diagnostic, remedy, (u, v), (r, a, s))


def _open_problem(surface: BSplineSurface) -> Problem:
    """Report the edge that is open, at its middle."""
    (u_low, u_high), (v_low, v_high) = surface.domain
    remedy = "A solid needs a seam and two poles, so start from a closed generic model."
    if not surface.closed_u:
        return _problem(surface, "open", "open_along", u_low, (v_low + v_high) / 2.0, remedy)
    v = v_high if surface.poles[0] else v_low
    return _problem(surface, "open", "rim", (u_low + u_high) / 2.0, v, remedy)


# ------------------------------------------------------------------ poles


def _pole_problem(surface: BSplineSurface, end: int) -> Problem | None:
    """Check that the directions in which the surface leaves a pole turn once around it, always forward."""
    v = surface.domain[1][end]
    u = surface.span_steps(0, per_span=4, least=16 * surface.control_net.shape[0])
    leaving = surface.grid(u, [v], dv=1)[:, 0] * (1.0, -1.0)[end]
    faulty = _faulty_turn(leaving)
    ring = surface.control_net[:, (1, -2)[end]] - surface.points(u[:1], [v])[0]
    if faulty is None and np.ptp(surface.control_net[:, (0, -1)[end]], axis=0).max() <= 1e-9 * surface.size:
        faulty = _faulty_turn(ring)
        u = bspline.greville_abscissae(surface.degrees[0], surface.knots_u)
    if faulty is None:
        return None
    remedy = "Move the control points next to it apart around the pole, or start again from a generic model."
    return _problem(surface, "folded pole", "folded_pole", u[faulty], v, remedy)


def _faulty_turn(offsets: np.ndarray) -> int | None:
    """Return the place of the smallest turn of offsets (n, 3) that do not turn once around; None if they do."""
    size = np.linalg.norm(offsets, axis=1)
    _, singular, axes = np.linalg.svd(offsets, full_matrices=False)
    if size.min() <= 1e-6 * size.max() or singular[1] <= 1e-6 * singular[0]:
        return int(np.argmin(size))
    x, y = offsets @ axes[0], offsets @ axes[1]
    turns = np.arctan2(x[:-1] * y[1:] - y[:-1] * x[1:], x[:-1] * x[1:] + y[:-1] * y[1:])
    turns = turns if turns.sum() >= 0.0 else -turns
    apart = np.linalg.norm(np.diff(offsets, axis=0), axis=1) > 1e-9 * size.max()
    if (turns[apart] <= 0.0).any() or abs(turns.sum() - 2.0 * np.pi) > 1e-3:
        return int(np.argmin(np.where(apart, turns, np.inf)))
    return None


# ------------------------------------------------------------------ normals


def _normal_problem(surface: BSplineSurface) -> Problem | None:
    """Look for places where S_u x S_v vanishes or flips, then for a surface that is inside out."""
    u, v = (
        surface.span_steps(axis, per_span=4, least=least, middles=True) for axis, least in enumerate(_LEAST_SAMPLES)
    )
    vectors = surface.grid_area_vectors(u, v)
    length = np.linalg.norm(vectors, axis=2)
    smallest = np.unravel_index(np.argmin(length), length.shape)
    area_scale = surface.size**2 / np.prod(np.ptp(surface.domain, axis=1))
    remedy = "Take a coarser net, or check the separated region there."
    if length[smallest] <= 1e-9 * area_scale:
        return _problem(surface, "flipped normal", "no_normal", u[smallest[0]], v[smallest[1]], remedy)
    place = _overturned(surface, u, v, vectors / length[..., None])
    if place:
        return _problem(surface, "flipped normal", "folded_over", *place, remedy)
    if surface.closed and not surface.volume() > 0.0:
        remedy = "Reverse the order of the control net's rows."
        return _problem(surface, "flipped normal", "inside_out", u[len(u) // 2], v[len(v) // 2], remedy)
    return None


def _overturned(surface: BSplineSurface, u, v, normals) -> tuple[float, float] | None:
    """Find a place where neighbouring normals point to opposite sides, also on a finer sampling."""
    suspects = []
    for axis, values in ((0, u), (1, v)):
        knots, degree = surface.knots[axis], surface.degrees[axis]
        first, second = np.moveaxis(normals, axis, 0)[:-1], np.moveaxis(normals, axis, 0)[1:]
        between = np.searchsorted(knots, values[1:]) - np.searchsorted(knots, values[:-1])
        # At a crease, where the surface is only continuous, it may be sharp, but not folded flat.
        limit = np.where(between >= degree, -0.99, 0.0)[:, None]
        turned = np.einsum("ijk,ijk->ij", first, second) < limit
        i, j = np.nonzero(turned)
        start = (u[i], v[j]) if axis == 0 else (u[j], v[i])
        stop = (u[i + 1], v[j]) if axis == 0 else (u[j], v[i + 1])
        suspects.append(np.stack([np.column_stack(start), np.column_stack(stop)], axis=1))
    suspects = np.concatenate(suspects)
    if not len(suspects):
        return None
    fractions = np.linspace(0.0, 1.0, 65)[:, None]
    fine = suspects[:, :1] * (1.0 - fractions) + suspects[:, 1:] * fractions
    dense = surface.normals(*fine.reshape(-1, 2).T).reshape(len(suspects), -1, 3)
    cosines = np.einsum("ijk,ijk->ij", dense[:, :-1], dense[:, 1:])
    worst, step = np.unravel_index(np.argmin(cosines), cosines.shape)
    return tuple(fine[worst, step]) if cosines[worst, step] < 0.0 else None


# ------------------------------------------------------------------ self-intersection


def _intersection_problem(surface: BSplineSurface) -> Problem | None:
    """Look for triangles that cross and are not neighbours."""
    resolution = _even_resolution(surface)
    mesh = triangulate(surface, resolution=resolution)
    if surface.closed and _is_star(mesh.points, mesh.triangles):
        return None
    pairs = crossing_triangles(mesh.points, mesh.triangles)
    if not len(pairs):
        return None
    corners = mesh.points[mesh.triangles[pairs]].reshape(-1, 3)
    mesh = triangulate(surface, resolution=tuple(2 * number for number in resolution))
    # Confirmed with finer triangles around the crossing ones only.
    margin = np.ptp(corners[:3], axis=0).max()
    inside = (mesh.points >= corners.min(axis=0) - margin) & (mesh.points <= corners.max(axis=0) + margin)
    triangles = mesh.triangles[inside.all(axis=1)[mesh.triangles].any(axis=1)]
    pairs = crossing_triangles(mesh.points, triangles)
    if not len(pairs):
        return None
    centers = mesh.points[triangles[pairs[:, 0]]].mean(axis=1)
    typical = np.argmin(np.linalg.norm(centers - centers.mean(axis=0), axis=1))
    first, second = mesh.parameters[triangles[pairs[typical], 0]]
    other = {"other_u": float(second[0]), "other_v": float(second[1])}
    remedy = "Separate the organ's parts more clearly, or take a coarser net."
    return _problem(surface, "self-intersection", "passes_through_itself", *first, remedy, **other)


def _even_resolution(surface: BSplineSurface) -> tuple[int, int]:
    """Choose numbers of intervals for triangles about as long as wide, at least four in every span."""
    grid = surface.grid(*(surface.span_steps(axis, per_span=4) for axis in (0, 1)))
    lengths = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).sum(axis=axis).max() for axis in (0, 1)]
    edge = np.sqrt(lengths[0] * lengths[1] / (_LEAST_SAMPLES[0] * _LEAST_SAMPLES[1]))
    return tuple(max(size - 1, int(np.ceil(length / edge))) for size, length in zip(grid.shape, lengths))


def _is_star(points: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether every ray from the centre of a closed mesh meets it once, so that no triangles cross."""
    corners = (points - points.mean(axis=0))[triangles].transpose(1, 0, 2)
    volumes = np.einsum("nk,nk->n", corners[0], np.cross(corners[1], corners[2]))
    if not volumes.min() > 1e-12 * volumes.max():
        return False
    # The solid angles (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30:125, 1983) must cover the sphere once.
    a, b, c = np.linalg.norm(corners, axis=2)
    ab, bc, ca = (np.einsum("nk,nk->n", corners[i], corners[j]) for i, j in ((0, 1), (1, 2), (2, 0)))
    angles = 2.0 * np.arctan2(volumes, a * b * c + ab * c + bc * a + ca * b)
    return bool(angles.sum() < 6.0 * np.pi)


def crossing_triangles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Find triangles that cross each other.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (t, 3) ndarray of int

    Returns
    -------
    (m, 2) ndarray of int
        Pairs of triangles without a common vertex.
    """
    corners = points[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = (low + high) / 2.0
    reach = np.linalg.norm(high - low, axis=1).max()
    pairs = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    a, b = np.ascontiguousarray(pairs.T)
    for lowest, highest in zip(np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)):
        overlap = (lowest[a] <= highest[b]) & (lowest[b] <= highest[a])
        a, b = a[overlap], b[overlap]
    shared = (triangles[a][:, :, None] == triangles[b][:, None, :]).any(axis=(1, 2))
    a, b = a[~shared], b[~shared]
    crossing = np.zeros(len(a), dtype=bool)
    # A fast test first: in nearly all pairs one triangle lies on one side of the other's plane.
    both = _straddles(corners[a], corners[b]) & _straddles(corners[b], corners[a])
    near = np.flatnonzero(both)
    crossing[near] = _edges_cross(corners[a[near]], corners[b[near]])
    crossing[near] |= _edges_cross(corners[b[near]], corners[a[near]])
    return np.column_stack([a[crossing], b[crossing]])


def _straddles(triangles: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether the corners of the other triangles lie on both sides of the triangles' planes."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    heights = np.einsum("nik,nk->ni", others - triangles[:, :1], normal)
    return (heights.min(axis=1) < 0.0) & (heights.max(axis=1) > 0.0)


def _edges_cross(triangles: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether an edge of the other triangle goes through the inside of the triangle, by signs of volumes."""
    a, b, c = triangles.transpose(1, 0, 2)
    crossing = np.zeros(len(triangles), dtype=bool)
    for k in range(3):
        p, q = others[:, k], others[:, (k + 1) % 3]
        through = _volume(p, a, b, c) * _volume(q, a, b, c) < 0.0
        sides = np.sign([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)]).sum(axis=0)
        crossing |= through & (np.abs(sides) == 3.0)
    return crossing


def _volume(a, b, c, d):
    """Six times the signed volume of tetrahedra."""
    return np.einsum("nk,nk->n", np.cross(b - a, c - a), d - a)
