"""Tetrahedral meshes of organs: solid, hollow with a wall, or several in one mesh with common nodes."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..export.frames import RAS_TO_LPS
from ..export.step import Solid
from .conforming import Region, claimed_twice, exact_volumes, job_files, regions_of, surfaces_of
from .elements import scaled_jacobians, volumes
from .groups import patch_groups, surface_groups
from .options import MeshOptions
from .process import MesherBroke, MeshingError, Result, run_worker
from .second_order import second_order

# Below this scaled Jacobian another way of meshing is tried.
LEAST_QUALITY = 0.15
_WORKERS = {
    "gmsh": ("gmsh", "VICRegistrationLib.meshing.gmsh_worker"),
    "netgen": ("Netgen", "VICRegistrationLib.meshing.netgen_worker"),
}
# Faces of every solid, and the fraction of the time that is left: gmsh hangs on some sharply bent surfaces with a seam.
_LAYOUTS = ((1, 0.4), (2, 1.0))
# How often a mesh is made, each time with smaller elements, until it keeps the volume.
_TRIES = 3
# More than this takes gigabytes of memory and hours.
MOST_TETRAHEDRA = 10_000_000


@dataclass(frozen=True, eq=False)
class TetrahedralMesh:
    """Tetrahedra of one or several organs, and the triangles of their surfaces.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
        Corners, with second order also the middles of the edges 01, 12, 20, 03, 13 and 23 (as VTK and Abaqus count).
    tetrahedron_groups : dict of str to ndarray of int
        Rows of `tetrahedra`: NAME of a solid organ, or NAME_wall. Every tetrahedron is in one group.
    triangles : (t, 3 or 6) ndarray of int
        Counter-clockwise seen from outside; with second order also the middles of the edges 01, 12 and 20.
    triangle_groups : dict of str to ndarray of int
        Rows of `triangles`: NAME_surface, or NAME_inside and NAME_outside of a wall, or NAME_surface_I_J of their
        patches; and A_B_interface where two groups of tetrahedra meet. Every triangle is in one group.
    exact_volumes : dict of str to float
        Volumes of the exact solids by group of tetrahedra, mm^3.
    notes : tuple of str
        What the user should know: overlaps that were resolved, elements of poor shape.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    tetrahedron_groups: dict[str, np.ndarray]
    triangles: np.ndarray
    triangle_groups: dict[str, np.ndarray]
    exact_volumes: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def order(self) -> int:
        """1 for four nodes, 2 for ten."""
        return 1 if self.tetrahedra.shape[1] == 4 else 2


def mesh_organs(
    solids: Sequence[Solid],
    options: MeshOptions | None = None,
    *,
    on_progress: Callable[[str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> TetrahedralMesh:
    """Mesh one or several organs.

    Parameters
    ----------
    solids : sequence of Solid
        With different names. Where two overlap, the place belongs to the one that is named first; where they touch,
        the mesh has common nodes.
    options : MeshOptions, optional
    on_progress : callable, optional
        Told in one line what is being done.
    cancelled : callable, optional
        Asked some times a second whether to stop.

    Returns
    -------
    TetrahedralMesh

    Raises
    ------
    ValueError
        If a surface is no valid solid, with the place; or the wall would pass through itself.
    MeshingError
        With one sentence, if the mesher is not installed, crashes, takes too long, or returns nothing or a mesh that
        is wrong. :class:`.process.MeshingCancelled` if it was cancelled.
    """
    options = options or MeshOptions()
    say = on_progress or (lambda line: None)
    module = require_mesher(options.tool)
    say("checking the surfaces")
    regions = regions_of(solids, options)
    _refuse_too_many(regions, options)
    attempts = _Attempts(module, regions, options, time.monotonic() + options.time_limit, say, cancelled)
    scale = 1.0
    for last in (False,) * (_TRIES - 1) + (True,):
        draft = attempts.mesh(scale)
        worst = np.abs(draft.off).max()
        if worst <= options.volume_error:
            break
        if last:
            _refuse_volume(draft.off, regions, options)
        # The difference goes with the square of the size.
        scale *= max(np.sqrt(0.8 * options.volume_error / worst), 0.5)
    return _assembled(draft, regions, options.patches)


@dataclass(frozen=True, eq=False)
class _Draft:
    """What has come back from the mesher, checked.

    ``region`` is that of each tetrahedron, ``exact`` the volume of the exact solids by group, ``off`` the relative
    difference from it.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    region: np.ndarray
    exact: Mapping[str, float]
    off: np.ndarray
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Attempts:
    """Runs of a mesher before a common end of time."""

    module: str
    regions: Sequence[Region]
    options: MeshOptions
    end: float
    say: Callable[[str], None]
    cancelled: Callable[[], bool] | None

    def mesh(self, scale: float) -> _Draft:
        """Mesh with so much smaller elements where the surface is curved."""
        name, order, regions = mesher_name(self.options.tool), self.options.order, self.regions
        result = self._run(scale, name)
        self.say("checking the mesh")
        points, tetrahedra, region = _checked_arrays(result.arrays, len(regions), name)
        notes = claimed_twice(regions, result.notes["volumes"])
        if order == 2:
            surfaces = list(surfaces_of(regions).values())
            points, tetrahedra, flattened = second_order(
                points, tetrahedra, region, surfaces, least_quality=LEAST_QUALITY
            )
            _refuse_inverted(points, tetrahedra, name)
            if flattened:
                notes.append(f"{flattened} edges were curved less than the surface, for the shape of their elements.")
        exact = exact_volumes(regions, result.notes["volumes"], name)
        off = _volume_errors(points, tetrahedra, region, exact)
        return _Draft(points, tetrahedra, region, exact, off, tuple(notes))

    def _run(self, scale: float, name: str) -> Result:
        """Run the mesher; if it crashes or hangs, once more on surfaces that are cut otherwise."""
        self.say("choosing the sizes of the elements")
        for faces, share in _LAYOUTS:
            job, files = job_files(self.regions, self.options, scale=scale, faces=faces, least_quality=LEAST_QUALITY)
            left = max(self.end - time.monotonic(), 0.0)
            try:
                return run_worker(
                    self.module,
                    job,
                    files,
                    name=name,
                    time_limit=share * left,
                    on_progress=self.say,
                    cancelled=self.cancelled,
                )
            except MesherBroke as error:
                broken = error
        if time.monotonic() >= self.end:
            msg = (
                f"{name} was not done after {self.options.time_limit:g} s and was ended; choose larger elements or a "
                "longer time limit."
            )
            raise MeshingError(msg) from broken
        raise broken


def _refuse_too_many(regions: Sequence[Region], options: MeshOptions) -> None:
    """Refuse a mesh that would fill the memory before it is begun."""
    # A wall is as thick as one element or more; a regular tetrahedron has 0.118 of its edge's cube.
    size = min(options.size, options.wall or np.inf)
    number = sum(region.volume for region in regions) / (0.118 * size**3)
    if number > MOST_TETRAHEDRA:
        msg = (
            f"Elements of {size:g} mm would be about {number:.2g} tetrahedra, more than the {MOST_TETRAHEDRA:.0e} that "
            "can be handled; choose larger elements" + (", or a thicker wall." if options.wall is not None else ".")
        )
        raise ValueError(msg)


def mesher_name(tool: str) -> str:
    """Name of a mesher for people."""
    return _WORKERS[tool][0]


def require_mesher(tool: str) -> str:
    """Find the module of a mesher's worker.

    Parameters
    ----------
    tool : {"gmsh", "netgen"}

    Returns
    -------
    str

    Raises
    ------
    MeshingError
        If the mesher is not installed.
    """
    name, module = _WORKERS[tool]
    if importlib.util.find_spec(tool) is None:
        msg = f"{name} is not installed; install it with: pip install 'vicregistration[mesh]'."
        raise MeshingError(msg)
    return module


def _checked_arrays(arrays: Mapping[str, np.ndarray], n_regions: int, name: str):
    """Points in RAS, tetrahedra and their regions, without unused points; refuse what is no mesh."""
    remedy = "choose another element size or the other mesher"
    try:
        points, cells, region = (np.asarray(arrays[key]) for key in ("points", "tetrahedra", "regions"))
    except KeyError as error:
        msg = f"{name} returned no mesh; {remedy}."
        raise MeshingError(msg) from error
    if not len(cells) or len(np.unique(region)) < n_regions:
        msg = f"{name} returned no tetrahedra{' for one of the organs' if len(cells) else ''}; {remedy}."
        raise MeshingError(msg)
    whole = cells.ndim == 2 and cells.shape[1] == 4 and cells.min() >= 0 and cells.max() < len(points)
    if not whole or not np.isfinite(points).all() or points.shape[1:] != (3,) or len(region) != len(cells):
        msg = f"{name} returned a mesh that does not hold together; {remedy}."
        raise MeshingError(msg)
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used] * RAS_TO_LPS, cells.reshape(-1, 4)
    _refuse_inverted(points, cells, name)
    return points, cells, region


def _refuse_inverted(points, cells, name: str) -> None:
    inverted = int(np.count_nonzero(scaled_jacobians(points, cells) <= 0.0))
    if inverted:
        msg = (
            f"{name} returned {inverted} inverted elements among {len(cells)}; choose another element size or the "
            "other mesher."
        )
        raise MeshingError(msg)


def _volume_errors(points, tetrahedra, region, exact: Mapping[str, float]) -> np.ndarray:
    found = np.bincount(region, weights=volumes(points, tetrahedra), minlength=len(exact))
    return found / np.array(list(exact.values())) - 1.0


def _refuse_volume(off: np.ndarray, regions: Sequence[Region], options: MeshOptions) -> None:
    worst = int(np.argmax(np.abs(off)))
    msg = (
        f"{mesher_name(options.tool)} returned a mesh of {regions[worst].group} whose volume is "
        f"{100.0 * off[worst]:+.2f} % off, more than the {100.0 * options.volume_error:g} % allowed; choose smaller "
        "elements, second order, or allow more."
    )
    raise MeshingError(msg)


def _assembled(draft: _Draft, regions: Sequence[Region], patches: tuple[int, int]) -> TetrahedralMesh:
    """Put cells in the order of their regions and find the groups of triangles."""
    order = np.argsort(draft.region, kind="stable")
    points, tetrahedra, region = draft.points, draft.tetrahedra[order], draft.region[order]
    groups = {item.group: np.flatnonzero(region == number) for number, item in enumerate(regions)}
    names = [item.name for item in regions]
    surfaces = surfaces_of(regions)
    triangles, triangle_groups = surface_groups(points, tetrahedra, groups, surfaces, names=names)
    triangle_groups = patch_groups(points, triangles, triangle_groups, surfaces, patches)
    jacobian, notes = scaled_jacobians(points, tetrahedra), draft.notes
    worst = int(np.argmin(jacobian))
    if jacobian[worst] < LEAST_QUALITY:
        place = "R {:.1f}, A {:.1f}, S {:.1f} mm".format(*points[tetrahedra[worst, :4]].mean(axis=0))
        notes += (
            f"The worst element, at {place}, has a scaled Jacobian of {jacobian[worst]:.3f}; {LEAST_QUALITY:g} or more "
            "is good. Look for a crease of the surface there, or choose another element size.",
        )
    return TetrahedralMesh(points, tetrahedra, groups, triangles, triangle_groups, draft.exact, notes)
