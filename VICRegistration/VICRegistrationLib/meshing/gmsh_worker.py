"""Meshes a job with gmsh; run as ``python -m VICRegistrationLib.meshing.gmsh_worker JOB``."""

from __future__ import annotations

import sys

import gmsh
import numpy as np

from .worker import JobError, Workplace, best_mesh, check_cut, check_left, claimants, main

# Programs for the surfaces and for the inside, and a factor on the sizes: tried in turn until a mesh is good.
_WAYS = ((6, 1, 1.0), (5, 1, 1.0), (6, 1, 0.92), (5, 1, 0.85), (1, 1, 0.9))
_TRIANGLE, _TETRAHEDRON = 2, 4
# Sizes come from nothing but what is set here.
_FREE = {"Mesh.MeshSizeExtendFromBoundary": 0, "Mesh.MeshSizeFromPoints": 0}


def work(place: Workplace) -> None:
    """Mesh the regions of a job, or convert a file.

    Parameters
    ----------
    place : Workplace
    """
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    if "convert" in place.job:
        _convert(place)
        return
    if "surface" in place.job:
        _cover(place)
        return
    regions, volumes = _build(place)
    best = best_mesh(place, _WAYS, lambda way: _mesh(place, regions, way))
    if best is None:
        msg = "gmsh returned no tetrahedra; choose another element size or --tool netgen."
        raise JobError(msg)
    place.finish(best, {"volumes": volumes})


def _convert(place: Workplace) -> None:
    """Write a file of the job in another format, by its suffix."""
    source, target = place.job["convert"]
    gmsh.option.setNumber("Mesh.SaveAll", 0)
    gmsh.open(place.path(source))
    gmsh.write(place.path(target))
    place.finish({"content": np.fromfile(place.path(target), dtype=np.uint8)}, {})


def _cover(place: Workplace) -> None:
    """Mesh the surface of a solid with triangles of one size."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    solid = _solid(place, place.job["surface"])
    gmsh.model.occ.synchronize()
    faces = gmsh.model.getBoundary([(3, solid)], oriented=False)
    _set_options({**_FREE, "Mesh.Algorithm": 6, "Mesh.MeshSizeMin": place.job["size"]}, place.job["size"])
    place.progress("meshing")
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.optimize("Relocate2D")
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.zeros(int(tags.max()) + 1, dtype=int)
    row[tags.astype(int)] = np.arange(len(tags))
    nodes = [gmsh.model.mesh.getElementsByType(_TRIANGLE, tag)[1] for _, tag in faces]
    place.finish(
        {"points": coordinates.reshape(-1, 3), "triangles": row[np.concatenate(nodes).astype(int)].reshape(-1, 3)}, {}
    )


# ------------------------------------------------------------------ geometry


def _build(place: Workplace) -> tuple[list[list[int]], list[dict]]:
    """Read the solids and cut them against each other; what each gave up to whom."""
    place.progress("reading the solids")
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    names = [region["name"] for region in place.job["regions"]]
    outers = [_solid(place, region["outer"]) for region in place.job["regions"]]
    lumens = [_solid(place, region["inner"]) for region in place.job["regions"] if region["inner"]]
    place.progress("cutting the solids")
    volumes, bodies = [], []
    for number, outer in enumerate(outers):
        others = [(name, tool) for name, tool in claimants(names, outers, lumens, number) if _meet(outer, tool)]
        volumes.append(_claims(outer, lumens[number : number + 1], others))
        bodies.append(_minus(outer, [tool for _, tool in others]))
    used = {tag for body in bodies for tag in body} | set(lumens)
    unused = [entity for entity in gmsh.model.occ.getEntities(3) if entity[1] not in used]
    gmsh.model.occ.remove(unused, recursive=True)
    regions = _joined(bodies, lumens)
    gmsh.model.occ.synchronize()
    for name, region, told in zip(names, regions, volumes):
        check_left(name, told["whole"] - sum(told["given"].values()), told["whole"])
        check_cut("gmsh", name, [gmsh.model.occ.getMass(3, tag) for tag in region], told)
    return regions, volumes


def _claims(outer: int, lumen: list[int], others: list[tuple[str, int]]) -> dict:
    """Volume of a solid without its lumen, and what of it others take, one after the other."""
    tools = lumen
    whole = last = _volume(_minus(outer, tools))
    given = {}
    for name, tool in others:
        # From the whole solid every time: what has been cut once is not safe to cut again.
        tools = [tool, *tools]
        left = _minus(outer, tools)
        now = _volume(left)
        given[name], last = last - now, now
    return {"whole": whole, "given": given}


def _solid(place: Workplace, name: str) -> int:
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
    """Cut solids off another; all of them stay."""
    if not tools:
        return [solid]
    left, _ = gmsh.model.occ.cut([(3, solid)], [(3, tag) for tag in tools], removeObject=False, removeTool=False)
    return [tag for dim, tag in left if dim == 3]


def _volume(solids: list[int]) -> float:
    return sum(gmsh.model.occ.getMass(3, tag) for tag in solids)


def _joined(bodies: list[list[int]], lumens: list[int]) -> list[list[int]]:
    """Take lumens out of bodies, and let those that touch share their faces; the solids of every region."""
    tags = [*(tag for body in bodies for tag in body), *lumens]
    if not any(_meet(a, b) for i, a in enumerate(tags) for b in tags[:i]):
        return bodies
    # In one go: Open CASCADE errs when solids that have become hollow are cut or joined again.
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


def _mesh(place: Workplace, regions: list[list[int]], way: tuple[int, int, float]) -> dict | None:
    """Mesh in one way; None if there are no tetrahedra."""
    surface_program, volume_program, factor = way
    job, mesh = place.job, gmsh.model.mesh
    mesh.clear()
    options = {
        **_FREE,
        "Mesh.Algorithm": surface_program,
        "Mesh.Algorithm3D": volume_program,
        "Mesh.MeshSizeFactor": factor,
        "Mesh.Optimize": 1,
        "Mesh.OptimizeNetgen": 1,
    }
    _set_options(options, job["size"])
    _use_sizes(place)
    try:
        mesh.generate(3)
    except Exception:  # noqa: BLE001 - gmsh raises bare Exception; another way may do.
        return None
    return _collected(regions)


def _set_options(options: dict[str, float], size: float) -> None:
    for name, value in {**options, "Mesh.MeshSizeMax": size}.items():
        gmsh.option.setNumber(name, value)


def _use_sizes(place: Workplace) -> None:
    for tag in gmsh.model.mesh.field.list():
        gmsh.model.mesh.field.remove(tag)
    field = gmsh.model.mesh.field.add("Structured")
    gmsh.model.mesh.field.setString(field, "FileName", place.path(place.job["sizes"]))
    gmsh.model.mesh.field.setNumber(field, "TextFormat", 0)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)


def _collected(regions: list[list[int]]) -> dict | None:
    """Nodes and tetrahedra of all regions, with the region of each."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.zeros(int(tags.max()) + 1 if len(tags) else 1, dtype=int)
    row[tags.astype(int)] = np.arange(len(tags))
    cells, region_of = [], []
    for number, region in enumerate(regions):
        for tag in region:
            _, nodes = gmsh.model.mesh.getElementsByType(_TETRAHEDRON, tag)
            if not len(nodes):
                return None
            cells.append(row[nodes.astype(int)].reshape(-1, 4))
            region_of.append(np.full(len(cells[-1]), number))
    return {
        "points": coordinates.reshape(-1, 3),
        "tetrahedra": np.concatenate(cells),
        "regions": np.concatenate(region_of),
    }


if __name__ == "__main__":
    sys.exit(main(work, name="gmsh"))
