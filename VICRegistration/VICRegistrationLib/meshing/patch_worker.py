"""Program that meshes faces of a STEP file and solids that they bound with gmsh, with common nodes on shared edges.

It runs as ``python -m VICRegistrationLib.meshing.patch_worker JOB``. The job has ``surface``, a file with one shell of
all faces; ``faces``, the point of each at the middle of its parameters; ``solids``, the numbers of the faces of each
solid; ``curves``, the middle points of edges whose nodes are wanted; ``size``, ``sizes`` and ``least_quality``.
"""

from __future__ import annotations

import sys

import gmsh
import numpy as np

from .gmsh_worker import KINDS, best_mesh, mesh_nodes, start
from .process import JobError, JobFolder, main

# Largest distance between the middle of a face or edge in the job and in gmsh, mm.
_SAME_PLACE = 1e-4


def work(place: JobFolder) -> None:
    """Mesh the faces and solids of a job."""
    start()
    place.progress("reading the patches")
    gmsh.model.occ.importShapes(place.path(place.job["surface"]))
    gmsh.model.occ.synchronize()
    faces = _matched(2, place.job["faces"])
    curves = _matched(1, place.job["curves"])
    loops = [gmsh.model.occ.addSurfaceLoop([faces[number] for number in solid]) for solid in place.job["solids"]]
    solids = [gmsh.model.occ.addVolume([loop]) for loop in loops]
    gmsh.model.occ.synchronize()
    found = best_mesh(place, lambda: _collected(faces, solids, curves))
    if found is None:
        msg = "gmsh returned no tetrahedra for one of the parts; choose another element size, and check the model."
        raise JobError(msg)
    place.finish(found, {})


def _matched(dimension: int, middles: list) -> list[int]:
    """Find gmsh's numbers of the faces or edges with the given middle points."""
    tags, places = [], []
    for _, tag in gmsh.model.getEntities(dimension):
        low, high = gmsh.model.getParametrizationBounds(dimension, tag)
        middle = (np.array(low) + np.array(high)) / 2.0
        tags.append(tag)
        places.append(gmsh.model.getValue(dimension, tag, middle.tolist()))
    found = []
    for middle in middles:
        distances = np.linalg.norm(np.array(places) - middle, axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] > _SAME_PLACE:
            msg = "gmsh did not find all patches of the model in its file; check the model."
            raise JobError(msg)
        found.append(tags[nearest])
    return found


def _collected(faces: list[int], solids: list[int], curves: list[int]) -> dict | None:
    """Nodes, tetrahedra of the solids and triangles of the faces, with the number of each; nodes of the curves.

    None if one of them has no element.
    """
    points, row = mesh_nodes()
    found = {"points": points}
    for key, owner, tags, width in (
        ("tetrahedra", "regions", solids, 4),
        ("triangles", "faces", faces, 3),
    ):
        cells, owners = [np.zeros((0, width), dtype=int)], [np.zeros(0, dtype=int)]
        for number, tag in enumerate(tags):
            nodes = gmsh.model.mesh.getElementsByType(KINDS[width], tag)[1]
            if not len(nodes):
                return None
            cells.append(row[nodes.astype(int)].reshape(-1, width))
            owners.append(np.full(len(cells[-1]), number))
        found[key], found[owner] = np.concatenate(cells), np.concatenate(owners)
    for number, tag in enumerate(curves):
        nodes = gmsh.model.mesh.getNodes(1, tag, includeBoundary=True)[0]
        found[f"curve{number}"] = row[nodes.astype(int)]
    return found


if __name__ == "__main__":
    sys.exit(main(work))
