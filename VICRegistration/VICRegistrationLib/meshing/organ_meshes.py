"""Meshes of organs by gmsh: tetrahedra of solid or hollow organs, with common nodes where they touch, or triangles."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..export.step import Solid, step_text, validate_solids
from ..frames import RAS_TO_LPS
from ..geometry.projection import closest_points
from ..geometry.triangles import enclosed_volume
from ..geometry.triangulation import TriangleMesh
from ..messages import Diagnostic
from .elements import TRIANGLE_EDGES, TetrahedralMesh, poor_element, scaled_jacobians, volumes
from .groups import patch_groups, second_order, surface_groups
from .process import GMSH_WORKER, MesherCrashed, MeshingError, Result, require_gmsh, run_worker
from .regions import MeshOptions, Region, claimed_twice, exact_volumes, job_files, regions_of, surfaces_of

_Mesh = TypeVar("_Mesh")

# Below this scaled Jacobian other algorithms of gmsh are tried.
LEAST_QUALITY = 0.15
# Faces of every solid, and share of the remaining time: gmsh hangs on some strongly curved surfaces with a seam, which
# are then tried as two faces.
_LAYOUTS = ((1, 0.4), (2, 1.0))
# Most meshes that are made, each with smaller elements, until one keeps the volume.
_TRIES = 3
# More than this takes gigabytes of memory and hours.
MOST_TETRAHEDRA = 10_000_000


def mesh_organs(
    solids: Sequence[Solid], options: MeshOptions | None = None, *, on_progress: Callable[[str], None] | None = None
) -> TetrahedralMesh:
    """Mesh one or several organs.

    Parameters
    ----------
    solids : sequence of Solid
        With different names. Where two overlap, the common volume belongs to the first one; where they touch, the mesh
        has common nodes.
    options : MeshOptions, optional
    on_progress : callable, optional
        Called with one line on what is being done. If it raises, gmsh is ended.

    Returns
    -------
    TetrahedralMesh

    Raises
    ------
    ValueError
        If a surface is no valid solid, or the wall would pass through itself; the message has the place.
    MeshingError
        If gmsh is not installed, crashes, takes too long, or returns nothing or a wrong mesh.
    """
    options = options or MeshOptions()
    say = on_progress or (lambda line: None)
    require_gmsh()
    say("checking the surfaces")
    regions = regions_of(solids, options)
    _refuse_too_many(regions, options)
    attempts = _Attempts(regions, options, time.monotonic() + options.time_limit, say)
    return _assembled(keeping_volumes(attempts.mesh, options.volume_error), regions, options.patches)


def keeping_volumes(mesh: Callable[[float], tuple[_Mesh, Mapping[str, float]]], volume_error: float) -> _Mesh:
    """Mesh with smaller elements until all parts keep their volumes.

    Parameters
    ----------
    mesh : callable
        Takes a factor on the sizes at curved surfaces; returns a mesh, and the relative difference of each part's
        volume.
    volume_error : float
        Largest relative difference that is allowed.

    Returns
    -------
    The mesh.

    Raises
    ------
    MeshingError
        If the volumes are not kept after three meshes.
    """
    scale = 1.0
    for _ in range(_TRIES):
        made, off = mesh(scale)
        worst = max(off, key=lambda part: abs(off[part]))
        if abs(off[worst]) <= volume_error:
            return made
        # The difference is proportional to the square of the size.
        scale *= max(np.sqrt(0.8 * volume_error / abs(off[worst])), 0.5)
    msg = (
        f"gmsh returned a mesh of {worst} whose volume is {100.0 * off[worst]:+.2f} % off, more than the "
        f"{100.0 * volume_error:g} % allowed; choose smaller elements, second order, or allow more."
    )
    raise MeshingError(msg)


def mesh_surface(
    solid: Solid, options: MeshOptions | None = None, *, on_progress: Callable[[str], None] | None = None
) -> TriangleMesh:
    """Cover the surface of an organ with triangles of one size.

    Parameters
    ----------
    solid : Solid
    options : MeshOptions, optional
        Only size and time limit are used.
    on_progress : callable, optional
        As in :func:`mesh_organs`.

    Returns
    -------
    TriangleMesh
        With nodes, normals and parameters of the exact surface.

    Raises
    ------
    ValueError
        If the surface is no valid solid.
    MeshingError
        If gmsh is not installed, crashes, takes too long or returns no closed surface.
    """
    options, surface = options or MeshOptions(), solid.surface
    require_gmsh()
    validate_solids([solid])
    job = {"task": "triangles", "surface": "surface.step", "size": float(options.size)}
    files = {"surface.step": step_text([solid])}
    result = run_worker(GMSH_WORKER, job, files, time_limit=options.time_limit, on_progress=on_progress)
    points, triangles = (result.arrays.get(key, np.zeros((0, 3), dtype=int)) for key in ("points", "triangles"))
    edges = np.sort(triangles[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    if not len(triangles) or (np.unique(edges, axis=0, return_counts=True)[1] != 2).any():
        msg = "gmsh returned triangles that do not close the surface; choose another element size."
        raise MeshingError(msg)
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    parameters = closest_points(surface, points[used] * RAS_TO_LPS).parameters
    points = surface.points(*parameters.T)
    if enclosed_volume(points, triangles) < 0.0:
        triangles = triangles[:, [0, 2, 1]]
    return TriangleMesh(points, triangles, surface.normals(*parameters.T), parameters)


@dataclass(frozen=True, eq=False)
class _Draft:
    """A checked mesh from gmsh, without groups.

    ``region`` is the index of each tetrahedron's region, ``exact`` has the volumes of the exact solids by group, mm^3.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    region: np.ndarray
    exact: Mapping[str, float]
    notes: tuple[Diagnostic, ...]


@dataclass(frozen=True)
class _Attempts:
    """Runs of gmsh with one time limit for all; ``end`` is on the clock of `time.monotonic`."""

    regions: Sequence[Region]
    options: MeshOptions
    end: float
    say: Callable[[str], None]

    def mesh(self, scale: float) -> tuple[_Draft, dict[str, float]]:
        """Mesh with a factor on the sizes at curved surfaces; returns the relative difference of each volume too."""
        regions = self.regions
        result = self._run(scale)
        self.say("checking the mesh")
        points, tetrahedra, region = _checked_arrays(result.arrays, len(regions))
        notes = claimed_twice(regions, result.notes["volumes"])
        if self.options.order == 2:
            surfaces = list(surfaces_of(regions).values())
            points, tetrahedra, flattened = second_order(
                points, tetrahedra, region, surfaces, least_quality=LEAST_QUALITY
            )
            refuse_inverted(points, tetrahedra)
            if flattened:
                notes.append(Diagnostic("edges_straightened", {"count": int(flattened)}))
        exact = exact_volumes(regions, result.notes["volumes"])
        off = _volume_errors(points, tetrahedra, region, exact)
        return _Draft(points, tetrahedra, region, exact, tuple(notes)), off

    def _run(self, scale: float) -> Result:
        """Run gmsh; if it crashes or hangs, once more with two faces for each surface."""
        self.say("choosing the sizes of the elements")
        for faces, share in _LAYOUTS:
            job, files = job_files(self.regions, self.options, scale=scale, faces=faces, least_quality=LEAST_QUALITY)
            left = max(self.end - time.monotonic(), 0.0)
            try:
                return run_worker(GMSH_WORKER, job, files, time_limit=share * left, on_progress=self.say)
            except MesherCrashed as error:
                broken = error
        if time.monotonic() >= self.end:
            msg = (
                f"gmsh was not done after {self.options.time_limit:g} s and was ended; choose larger elements or a "
                "longer time limit."
            )
            raise MeshingError(msg) from broken
        raise broken


def _refuse_too_many(regions: Sequence[Region], options: MeshOptions) -> None:
    """Refuse a mesh that would not fit into memory, before gmsh is run."""
    # A wall is at least one element thick; the volume of a regular tetrahedron is 0.118 of its edge's cube.
    size = min(options.size, options.wall or np.inf)
    number = sum(region.volume for region in regions) / (0.118 * size**3)
    if number > MOST_TETRAHEDRA:
        msg = (
            f"Elements of {size:g} mm would be about {number:.2g} tetrahedra, more than the {MOST_TETRAHEDRA:.0e} that "
            "can be handled; choose larger elements" + (", or a thicker wall." if options.wall is not None else ".")
        )
        raise ValueError(msg)


def _checked_arrays(arrays: Mapping[str, np.ndarray], n_regions: int):
    """Return points in RAS, tetrahedra and their regions, without unused points; refuse what is no valid mesh."""
    remedy = "choose another element size"
    try:
        points, cells, region = (np.asarray(arrays[key]) for key in ("points", "tetrahedra", "regions"))
    except KeyError as error:
        msg = f"gmsh returned no mesh; {remedy}."
        raise MeshingError(msg) from error
    if not len(cells) or len(np.unique(region)) < n_regions:
        msg = f"gmsh returned no tetrahedra{' for one of the organs' if len(cells) else ''}; {remedy}."
        raise MeshingError(msg)
    whole = cells.ndim == 2 and cells.shape[1] == 4 and cells.min() >= 0 and cells.max() < len(points)
    if not whole or not np.isfinite(points).all() or points.shape[1:] != (3,) or len(region) != len(cells):
        msg = f"gmsh returned a mesh that does not hold together; {remedy}."
        raise MeshingError(msg)
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used] * RAS_TO_LPS, cells.reshape(-1, 4)
    refuse_inverted(points, cells)
    return points, cells, region


def refuse_inverted(points: np.ndarray, cells: np.ndarray) -> None:
    """Refuse a mesh with inverted elements."""
    inverted = int(np.count_nonzero(scaled_jacobians(points, cells) <= 0.0))
    if inverted:
        msg = f"gmsh returned {inverted} inverted elements among {len(cells)}; choose another element size."
        raise MeshingError(msg)


def _volume_errors(points, tetrahedra, region, exact: Mapping[str, float]) -> dict[str, float]:
    found = np.bincount(region, weights=volumes(points, tetrahedra), minlength=len(exact))
    return {part: float(volume / exact[part]) - 1.0 for part, volume in zip(exact, found)}


def _assembled(draft: _Draft, regions: Sequence[Region], patches: tuple[int, int]) -> TetrahedralMesh:
    """Sort tetrahedra by region, and find the groups of triangles."""
    order = np.argsort(draft.region, kind="stable")
    points, tetrahedra, region = draft.points, draft.tetrahedra[order], draft.region[order]
    groups = {item.group: np.flatnonzero(region == number) for number, item in enumerate(regions)}
    names = [item.name for item in regions]
    surfaces = surfaces_of(regions)
    triangles, triangle_groups = surface_groups(points, tetrahedra, groups, surfaces, names=names)
    triangle_groups = patch_groups(points, triangles, triangle_groups, surfaces, patches)
    worst, notes = poor_element(points, tetrahedra, LEAST_QUALITY), draft.notes
    if worst:
        notes += (Diagnostic("poor_element", worst),)
    return TetrahedralMesh(points, tetrahedra, groups, triangles, triangle_groups, draft.exact, notes)
