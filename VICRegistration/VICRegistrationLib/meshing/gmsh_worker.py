"""Program that meshes organs with gmsh, or writes a mesh in one of its formats.

It runs as ``python -m VICRegistrationLib.meshing.gmsh_worker JOB``, because gmsh is GPL and may crash.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

import gmsh
import numpy as np

from .elements import scaled_jacobians
from .process import JobError, JobFolder, main

# gmsh's numbers of surface and volume algorithm, and a factor on the sizes: tried in turn until a mesh is good.
_WAYS = ((6, 1, 1.0), (5, 1, 1.0), (6, 1, 0.92), (5, 1, 0.85), (1, 1, 0.9))
# No further algorithm is tried after this share of the time limit.
_TIME_FOR_TRIES = 0.3
# Relative difference of volumes at which a cut has failed.
_MISCUT = 1e-3
# gmsh's numbers of elements by their number of nodes: triangles and tetrahedra, linear and second order.
KINDS = {3: 2, 6: 9, 4: 4, 10: 11}
# gmsh has the middle nodes of the last two edges of a tetrahedron in the other order.
_NODES = {10: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}
# Sizes follow from the options and the field that are set here only.
_FREE = {"Mesh.MeshSizeExtendFromBoundary": 0, "Mesh.MeshSizeFromPoints": 0}


def work(place: JobFolder) -> None:
    """Do the task of a job.

    Parameters
    ----------
    place : JobFolder
        Its job has the ``task`` "tetrahedra", "triangles" or "write".
    """
    start()
    {"tetrahedra": _fill, "triangles": _cover, "write": _write}[place.job["task"]](place)


def start() -> None:
    """Start gmsh: silent, one thread, mm."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")


def _fill(place: JobFolder) -> None:
    """Mesh the regions with tetrahedra."""
    regions, volumes = _build(place)
    found = best_mesh(place, lambda: _collected(regions))
    if found is None:
        msg = "gmsh returned no tetrahedra; choose another element size."
        raise JobError(msg)
    place.finish(found, {"volumes": volumes})


def _cover(place: JobFolder) -> None:
    """Mesh the surface of a solid with triangles of constant size."""
    _solid(place, place.job["surface"])
    gmsh.model.occ.synchronize()
    size = place.job["size"]
    _set_options({**_FREE, "Mesh.Algorithm": 6, "Mesh.MeshSizeMin": size, "Mesh.MeshSizeMax": size})
    place.progress("meshing")
    gmsh.model.mesh.generate(2)
    # Widens the smallest angle from 20 to 24 degrees on the demo's organs.
    gmsh.model.mesh.optimize("Laplace2D", niter=5)
    points, row = mesh_nodes()
    triangles = gmsh.model.mesh.getElementsByType(KINDS[3])[1]
    place.finish({"points": points, "triangles": row[triangles.astype(int)].reshape(-1, 3)}, {})


def _write(place: JobFolder) -> None:
    """Write a mesh in the format of a file's suffix; groups become physical groups."""
    arrays = np.load(place.path(place.job["mesh"]), allow_pickle=False)
    points, groups = arrays["points"], place.job["groups"]
    gmsh.model.add("organs")
    for tag, group in enumerate(groups, start=1):
        gmsh.model.addDiscreteEntity(group["dimension"], tag)
        gmsh.model.addPhysicalGroup(group["dimension"], [tag], tag, group["name"])
    # All nodes go into one entity, because a node on a surface belongs to several.
    first = next(tag for tag, group in enumerate(groups, start=1) if group["dimension"] == 3)
    gmsh.model.mesh.addNodes(3, first, np.arange(1, len(points) + 1), points.ravel())
    for tag in range(1, len(groups) + 1):
        cells = arrays[f"cells{tag}"]
        width = cells.shape[1]
        nodes = cells[:, _NODES.get(width, slice(None))] + 1
        gmsh.model.mesh.addElementsByType(tag, KINDS[width], [], nodes.ravel())
    # A .unv file gets sets of the groups' nodes, a .bdf file coordinates with 8 decimals.
    _set_options({"Mesh.SaveGroupsOfNodes": 1, "Mesh.BdfFieldFormat": 2})
    path = place.path(place.job["file"])
    gmsh.write(path)
    place.finish({"content": np.fromfile(path, dtype=np.uint8)}, {})


# ------------------------------------------------------------------ geometry


def _build(place: JobFolder) -> tuple[list[list[int]], list[dict]]:
    """Read the solids and cut off what belongs to others; solids of each region, and measured volumes."""
    place.progress("reading the solids")
    names = [region["name"] for region in place.job["regions"]]
    outers = [_solid(place, region["outer"]) for region in place.job["regions"]]
    lumens = [_solid(place, region["inner"]) for region in place.job["regions"] if region["inner"]]
    place.progress("cutting the solids")
    volumes, bodies = [], []
    for number, outer in enumerate(outers):
        others = [(name, tool) for name, tool in _cutting(names, outers, lumens, number) if _meet(outer, tool)]
        volumes.append(_measured(outer, lumens[number : number + 1], others))
        bodies.append(_minus(outer, [tool for _, tool in others]))
    used = {tag for body in bodies for tag in body} | set(lumens)
    unused = [entity for entity in gmsh.model.occ.getEntities(3) if entity[1] not in used]
    gmsh.model.occ.remove(unused, recursive=True)
    regions = _joined(bodies, lumens)
    gmsh.model.occ.synchronize()
    for name, region, measured in zip(names, regions, volumes):
        _check_cut(name, [gmsh.model.occ.getMass(3, tag) for tag in region], measured)
    return regions, volumes


def _cutting(names: Sequence[str], outers: Sequence, lumens: Sequence, number: int) -> list[tuple]:
    """Solids that are cut off a region, with their names: organs named before it, lumens of those named after it."""
    before = list(zip(names, outers[:number]))
    return before + [(f"the lumen of {name}", lumen) for name, lumen in zip(names[number + 1 :], lumens[number + 1 :])]


def _check_cut(name: str, parts: Sequence[float], measured: Mapping) -> None:
    """Refuse a region of which nothing is left, and one that Open CASCADE has cut wrongly.

    `parts` are the volumes of the region's solids, `measured` those of :func:`_measured`.
    """
    kept = measured["whole"] - sum(measured["given"].values())
    if kept <= _MISCUT * measured["whole"]:
        msg = (
            f"Nothing is left of {name}: it lies inside of the organs and lumens that were named before it. Name it "
            "before the organ that holds it, or leave it out; vic-registration gaps shows how the organs lie to each "
            "other."
        )
        raise JobError(msg)
    if min(parts, default=0.0) <= 0.0 or abs(sum(parts) - kept) > _MISCUT * measured["whole"]:
        msg = (
            f"gmsh could not cut {name} where it meets its neighbours: they or their walls overlap too much or have "
            "most of their surfaces in common. Take a thinner wall, correct the surfaces (vic-registration gaps shows "
            "how they lie), or mesh the organs one by one."
        )
        raise JobError(msg)


def _measured(outer: int, lumen: list[int], others: list[tuple[str, int]]) -> dict:
    """Volume of a solid without its lumen, and the volumes that others cut off, one after the other."""
    tools = lumen
    whole = last = _volume(_minus(outer, tools))
    given = {}
    for name, tool in others:
        # Always from the whole solid: Open CASCADE may fail to cut a solid that was cut before.
        tools = [tool, *tools]
        left = _minus(outer, tools)
        now = _volume(left)
        given[name], last = last - now, now
    return {"whole": whole, "given": given}


def _solid(place: JobFolder, name: str) -> int:
    """Read a file that holds one solid."""
    found = gmsh.model.occ.importShapes(place.path(name))
    if len(found) != 1 or found[0][0] != 3:
        msg = "gmsh found no solid in the STEP file; check the surface."
        raise JobError(msg)
    return found[0][1]


def _meet(one: int, other: int) -> bool:
    """Whether the boxes around two solids meet."""
    a, b = (np.reshape(gmsh.model.occ.getBoundingBox(3, tag), (2, 3)) for tag in (one, other))
    return bool(((a[0] <= b[1]) & (b[0] <= a[1])).all())


def _minus(solid: int, tools: list[int]) -> list[int]:
    """Cut solids off another, and keep all of them."""
    if not tools:
        return [solid]
    left, _ = gmsh.model.occ.cut([(3, solid)], [(3, tag) for tag in tools], removeObject=False, removeTool=False)
    return [tag for dim, tag in left if dim == 3]


def _volume(solids: list[int]) -> float:
    return sum(gmsh.model.occ.getMass(3, tag) for tag in solids)


def _joined(bodies: list[list[int]], lumens: list[int]) -> list[list[int]]:
    """Cut lumens out of bodies, and make touching bodies share faces; returns the solids of every region."""
    tags = [*(tag for body in bodies for tag in body), *lumens]
    if not any(_meet(a, b) for i, a in enumerate(tags) for b in tags[:i]):
        return bodies
    # In one operation: Open CASCADE makes errors when hollow solids are cut or joined again.
    _, parts = gmsh.model.occ.fragment([(3, tag) for tag in tags], [])
    parts = [{tag for dim, tag in part if dim == 3} for part in parts]
    first = len(tags) - len(lumens)
    taken = set().union(*parts[first:])
    parts, regions = iter(parts), []
    for body in bodies:
        mine = set().union(*(next(parts) for _ in body)) - taken
        taken |= mine
        regions.append(sorted(mine))
    gmsh.model.occ.remove(
        [entity for entity in gmsh.model.occ.getEntities(3) if not any(entity[1] in region for region in regions)],
        recursive=True,
    )
    return regions


# ------------------------------------------------------------------ mesh


def best_mesh(place: JobFolder, collected: Callable[[], dict | None]) -> dict[str, np.ndarray] | None:
    """Mesh with one algorithm after the other, until a mesh is good or time is short.

    Parameters
    ----------
    place : JobFolder
        Its job has ``size``, ``sizes`` and ``least_quality``.
    collected : callable
        Returns the arrays of the mesh that gmsh holds, ``points`` and ``tetrahedra`` among them; None if a solid has no
        tetrahedra.

    Returns
    -------
    dict of str to ndarray
        Arrays of the mesh with the best worst element; None if there is no mesh.
    """
    best = None
    for number, way in enumerate(_WAYS, start=1):
        place.progress(f"meshing, try {number}" if number > 1 else "meshing")
        found = collected() if _generated(place, way) else None
        if found is None:
            continue
        least = scaled_jacobians(found["points"], found["tetrahedra"]).min()
        if best is None or least > best[0]:
            best = least, found
        if best[0] >= place.job["least_quality"] or place.spent() > _TIME_FOR_TRIES:
            break
    return None if best is None else best[1]


def _generated(place: JobFolder, way: tuple[int, int, float]) -> bool:
    """Mesh with one choice of algorithms; returns whether gmsh was able to."""
    surface_program, volume_program, factor = way
    gmsh.model.mesh.clear()
    options = {
        **_FREE,
        "Mesh.Algorithm": surface_program,
        "Mesh.Algorithm3D": volume_program,
        "Mesh.MeshSizeFactor": factor,
        "Mesh.MeshSizeMax": place.job["size"],
        "Mesh.Optimize": 1,
        "Mesh.OptimizeNetgen": 1,
    }
    _set_options(options)
    _use_sizes(place)
    try:
        gmsh.model.mesh.generate(3)
    except Exception:  # noqa: BLE001 - gmsh raises bare Exception; another way may do.
        return False
    return True


def _set_options(options: Mapping[str, float]) -> None:
    for name, value in options.items():
        gmsh.option.setNumber(name, value)


def _use_sizes(place: JobFolder) -> None:
    """Read the sizes of elements from the job's file."""
    for tag in gmsh.model.mesh.field.list():
        gmsh.model.mesh.field.remove(tag)
    field = gmsh.model.mesh.field.add("Structured")
    gmsh.model.mesh.field.setString(field, "FileName", place.path(place.job["sizes"]))
    gmsh.model.mesh.field.setNumber(field, "TextFormat", 0)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)


def _collected(regions: list[list[int]]) -> dict | None:
    """Nodes and tetrahedra of all regions, with the region of each."""
    points, row = mesh_nodes()
    cells, region_of = [], []
    for number, region in enumerate(regions):
        for tag in region:
            _, nodes = gmsh.model.mesh.getElementsByType(KINDS[4], tag)
            if not len(nodes):
                return None
            cells.append(row[nodes.astype(int)].reshape(-1, 4))
            region_of.append(np.full(len(cells[-1]), number))
    return {
        "points": points,
        "tetrahedra": np.concatenate(cells),
        "regions": np.concatenate(region_of),
    }


def mesh_nodes() -> tuple[np.ndarray, np.ndarray]:
    """Return points, (n, 3) LPS mm, and their rows by gmsh's numbers."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.zeros(int(tags.max(initial=0)) + 1, dtype=int)
    row[tags.astype(int)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), row


if __name__ == "__main__":
    sys.exit(main(work))
