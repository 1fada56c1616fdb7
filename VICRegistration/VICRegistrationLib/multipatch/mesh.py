"""Meshes of models by gmsh: tetrahedra of organs and cords, triangles of sheets, with common nodes where they meet.

All patches are faces of one shell that share their edges, so that parts have common nodes without cutting. Parts that
pass through each other are not cut either; a note reports them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..export.step import Solid, validate_solids
from ..frames import RAS_TO_LPS
from ..geometry import bspline
from ..meshing.elements import TRIANGLE_EDGES, TetrahedralMesh, poor_element, volumes
from ..meshing.organ_meshes import keeping_volumes, refuse_inverted
from ..meshing.process import PATCH_WORKER, require_gmsh, run_worker
from ..meshing.regions import MeshOptions, field_file
from ..meshing.sizes import size_field
from ..messages import Diagnostic
from .check import require_meshable, through_cords, through_organs
from .model import MultiPatchModel, Part
from .second_order import with_middles
from .step import faces_step_text
from .topology import Side, shell, sides

# Below this scaled Jacobian other algorithms are tried; if none is better, a note names the part.
LEAST_QUALITY = 0.1


def mesh_model(
    model: MultiPatchModel,
    options: MeshOptions | None = None,
    *,
    on_progress: Callable[[str], None] | None = None,
) -> TetrahedralMesh:
    """Mesh a model.

    Parameters
    ----------
    model : MultiPatchModel
    options : MeshOptions, optional
        Without a wall and without a number of patches.
    on_progress : callable, optional
        Called with one line on what is being done. If it raises, gmsh is ended.

    Returns
    -------
    TetrahedralMesh
        A group of tetrahedra for each organ and cord, of triangles for each patch; ``shells`` has the thickness of
        sheets, ``node_groups`` what is fixed to bone.

    Raises
    ------
    ValueError
        If the model is not in mm, a part is not attached, an organ is no valid solid, or an option does not apply.
    MeshingError
        If gmsh is not installed, crashes, takes too long, or returns nothing or a wrong mesh.
    """
    options, say = options or MeshOptions(), on_progress or (lambda line: None)
    if options.wall is not None or tuple(options.patches) != (1, 1):
        msg = "A wall or a number of patches was asked for; a model has patches of its own and is meshed without walls."
        raise ValueError(msg)
    require_gmsh()
    say("checking the model")
    require_meshable(model)
    validate_solids([Solid(organ, parent) for organ, parent in model.parents.items()])
    solids = [part for part in model.parts if part.kind != "sheet"]
    exact = {part.labelled(): solid_volume(model, part) for part in solids}
    end = time.monotonic() + options.time_limit

    def meshed(scale: float) -> tuple[TetrahedralMesh, dict[str, float]]:
        arrays = _run(model, solids, options, scale, end, say)
        mesh = _assembled(model, solids, arrays, exact, options.order)
        found = {
            name: volumes(mesh.points, mesh.tetrahedra[rows]).sum() for name, rows in mesh.tetrahedron_groups.items()
        }
        return mesh, {name: float(volume / exact[name]) - 1.0 for name, volume in found.items()}

    mesh = keeping_volumes(meshed, options.volume_error)
    return replace(mesh, notes=(*through_organs(model), *through_cords(model), *mesh.notes))


def solid_volume(model: MultiPatchModel, part: Part) -> float:
    """Volume of an organ or a cord, mm^3, by the divergence theorem over its patches."""
    if part.name in model.parents:
        return model.parents[part.name].volume()
    origin, total = model.points[model.patch(part.foot).indices].mean(axis=(0, 1)), 0.0
    for patch, turned in shell(model, part):
        total += (-1.0 if turned else 1.0) * patch.surface(model.points).cone_volume(origin)
    return total


def _run(
    model: MultiPatchModel, solids: list[Part], options: MeshOptions, scale: float, end: float, say
) -> Mapping[str, np.ndarray]:
    """Run gmsh; returns its arrays, in LPS."""
    say("choosing the sizes of the elements")
    error = options.volume_error * scale**2
    parents = list(model.parents.values())
    sizes = size_field(parents, options.size, order=options.order, volume_error=error)
    number = {patch.name: place for place, patch in enumerate(model.patches)}
    surfaces = [patch.surface(model.points) for patch in model.patches]
    middles = [surface.points(*surface.midpoints(1, 1))[0] for surface in surfaces]
    job = {
        "surface": "model.step",
        "faces": (np.array(middles) * RAS_TO_LPS).tolist(),
        "solids": [[number[patch.name] for patch, _ in shell(model, part)] for part in solids],
        "curves": [(_middle_of(model, side) * RAS_TO_LPS).tolist() for side, _ in fixed_sides(model)],
        "size": options.size,
        "sizes": "sizes.bin",
        "least_quality": LEAST_QUALITY,
    }
    files = {"model.step": faces_step_text(model), "sizes.bin": field_file(sizes)}
    left = max(end - time.monotonic(), 0.0)
    return run_worker(PATCH_WORKER, job, files, time_limit=left, on_progress=say).arrays


def fixed_sides(model: MultiPatchModel) -> list[tuple[Side, str]]:
    """Borders of patches whose points are all fixed to bone, with the name of the place."""
    found = {}
    for place, group in model.fixed.items():
        for patch in model.patches:
            for side in sides(patch):
                if np.isin(side.edge, group).all():
                    found.setdefault((side.edge, place), (side, place))
    return list(found.values())


def _middle_of(model: MultiPatchModel, side: Side) -> np.ndarray:
    """Point of a border at the middle of its parameters, (3,)."""
    degree, knots = side.patch.degrees[side.axis], side.patch.knots[side.axis]
    row = side.patch.borders()[side.name]
    return (bspline.collocation(degree, knots, [(knots[0] + knots[-1]) / 2.0]) @ model.points[row])[0]


def _assembled(
    model: MultiPatchModel, solids: list[Part], arrays: Mapping[str, np.ndarray], exact: Mapping[str, float], order: int
) -> TetrahedralMesh:
    """Make a mesh with groups of the arrays from gmsh."""
    # gmsh orients triangles by the normals of their faces, which point out of the part that the patch belongs to.
    points, tetrahedra, triangles = arrays["points"] * RAS_TO_LPS, arrays["tetrahedra"], arrays["triangles"]
    notes = []
    if order == 2:
        points, tetrahedra, triangles, flattened = with_middles(
            model, points, tetrahedra, triangles, arrays["faces"], least_quality=LEAST_QUALITY
        )
        notes += [Diagnostic("edges_straightened", {"count": flattened})] if flattened else []
    refuse_inverted(points, tetrahedra)
    groups = {part.labelled(): np.flatnonzero(arrays["regions"] == number) for number, part in enumerate(solids)}
    notes += _poor(points, tetrahedra, groups)
    patch_groups, shells = {}, {}
    for number, patch in enumerate(model.patches):
        part = model.part(patch.part)
        name = part.labelled(patch.name)
        name = f"{name} surface" if name in groups else name
        patch_groups[name] = np.flatnonzero(arrays["faces"] == number)
        if part.kind == "sheet":
            shells[name] = part.thickness
    return TetrahedralMesh(
        points,
        tetrahedra,
        groups,
        triangles,
        patch_groups,
        exact,
        tuple(notes),
        shells=shells,
        node_groups=_fixed_nodes(model, arrays, triangles),
    )


def _fixed_nodes(
    model: MultiPatchModel, arrays: Mapping[str, np.ndarray], triangles: np.ndarray
) -> dict[str, np.ndarray]:
    """Nodes on patches and borders whose points are all fixed to bone, by the name of the place."""
    found: dict[str, list[np.ndarray]] = {place: [] for place in model.fixed}
    numbers = {patch.name: number for number, patch in enumerate(model.patches)}
    for number, (side, place) in enumerate(fixed_sides(model)):
        ends = arrays[f"curve{number}"]
        found[place] += [ends, _middles_between(ends, triangles[arrays["faces"] == numbers[side.patch.name]])]
    for place, group in model.fixed.items():
        for number, patch in enumerate(model.patches):
            if np.isin(patch.indices, group).all():
                found[place].append(triangles[arrays["faces"] == number].ravel())
    return {place: np.unique(np.concatenate(nodes)) for place, nodes in found.items() if nodes}


def _middles_between(ends: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Middle nodes of a patch's outer edges between given nodes; none for linear triangles."""
    edges = triangles[:, TRIANGLE_EDGES].reshape(-1, 2)
    middles = triangles[:, 3:].ravel()
    _, inverse, counts = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    outer = (counts[inverse.ravel()] == 1) & np.isin(edges, ends).all(axis=1)
    return middles[outer] if len(middles) else middles


def _poor(points, tetrahedra, groups: Mapping[str, np.ndarray]) -> list[Diagnostic]:
    """Report the worst element of each part that has one below the least quality."""
    worst = {name: poor_element(points, tetrahedra[rows], LEAST_QUALITY) for name, rows in groups.items()}
    return [Diagnostic("poor_element_of_part", {"part": name, **found}) for name, found in worst.items() if found]
