"""Meshes a job with Netgen; run as ``python -m VICRegistrationLib.meshing.netgen_worker JOB``."""

from __future__ import annotations

import sys

import numpy as np
from netgen import occ
from netgen.meshing import MeshingParameters

from .worker import JobError, Workplace, best_mesh, check_cut, check_left, claimants, main

# Factor on the sizes and rounds of improvement: tried in turn until a mesh is good.
_WAYS = ((1.0, 3), (0.95, 6), (0.88, 6))
# Netgen numbers the corners of tetrahedra the other way round.
_TURNED = [0, 2, 1, 3]
# Points that the sizes are prescribed at: more do not help, and every one costs.
_MOST_POINTS = 8000


def work(place: Workplace) -> None:
    """Mesh the regions of a job.

    Parameters
    ----------
    place : Workplace
    """
    shape, numbers, volumes = _build(place)
    best = best_mesh(place, _WAYS, lambda way: _mesh(place, shape, numbers, *way))
    if best is None:
        msg = "Netgen returned no tetrahedra; choose another element size or --tool gmsh."
        raise JobError(msg)
    place.finish(best, {"volumes": volumes})


def _build(place: Workplace):
    """Read the solids and cut them against each other.

    Returns the shape, the region of each of its solids, and what each region gave up to whom.
    """
    place.progress("reading the solids")
    names = [region["name"] for region in place.job["regions"]]
    outers = [_solid(place, region["outer"]) for region in place.job["regions"]]
    lumens = [_solid(place, region["inner"]) for region in place.job["regions"] if region["inner"]]
    place.progress("cutting the solids")
    pieces, volumes = [], []
    for number, outer in enumerate(outers):
        left = outer - lumens[number] if lumens else outer
        whole, given = _volume(left), {}
        # What is cut off are whole organs, as Open CASCADE errs with hollow ones; the sum is the same.
        for name, tool in claimants(names, outers, lumens, number):
            if _meet(outer, tool):
                before = _volume(left)
                left = left - tool
                given[name] = before - _volume(left)
        check_left(names[number], _volume(left), whole)
        kept = list(left.solids)
        for solid in kept:
            solid.name = f"region{number}"
        pieces += kept
        volumes.append({"whole": whole, "given": given})
    shape = occ.Glue(pieces) if len(pieces) > 1 else pieces[0]
    numbers = [int(solid.name[len("region") :]) for solid in shape.solids]
    for number, told in enumerate(volumes):
        parts = [solid.mass for solid, mine in zip(shape.solids, numbers) if mine == number]
        check_cut("Netgen", names[number], parts, told)
    return shape, numbers, volumes


def _solid(place: Workplace, name: str):
    """Read a file that holds one solid."""
    solids = list(occ.OCCGeometry(place.path(name)).shape.solids)
    if len(solids) != 1:
        msg = "Netgen found no solid in the STEP file; check the surface."
        raise JobError(msg)
    return solids[0]


def _volume(shape) -> float:
    return sum(solid.mass for solid in shape.solids)


def _meet(one, other) -> bool:
    """Whether the boxes around two shapes meet."""
    (low, high), (other_low, other_high) = (
        [np.array([point.x, point.y, point.z]) for point in shape.bounding_box] for shape in (one, other)
    )
    return bool(((low <= other_high) & (other_low <= high)).all())


def _mesh(place: Workplace, shape, numbers: list[int], factor: float, rounds: int) -> dict | None:
    """Mesh in one way; None if there are no tetrahedra."""
    parameters = MeshingParameters(
        maxh=place.job["size"] * factor, grading=0.35, curvaturesafety=0.1, segmentsperedge=0.1, optsteps3d=rounds
    )
    for x, y, z, size in _sizes(place):
        parameters.RestrictH(x, y, z, size * factor)
    try:
        mesh = occ.OCCGeometry(shape).GenerateMesh(parameters)
    except Exception:  # noqa: BLE001 - Netgen raises its own exceptions; another way may do.
        return None
    cells = mesh.Elements3D().NumPy()
    if not len(cells):
        return None
    return {
        "points": np.array(mesh.Coordinates()),
        "tetrahedra": cells["nodes"].astype(int)[:, _TURNED] - 1,
        "regions": np.array(numbers)[cells["index"].astype(int) - 1],
    }


def _sizes(place: Workplace) -> np.ndarray:
    """Rows of x, y, z and size where the surface wants small elements, the smallest first."""
    rows = np.load(place.path(place.job["points"]))
    rows = rows[rows[:, 3] < 0.999 * place.job["size"]]
    step = -(-len(rows) // _MOST_POINTS) if len(rows) else 1
    return rows[::step].tolist()


if __name__ == "__main__":
    sys.exit(main(work, name="Netgen"))
