"""Generic models: exactness of their patches, their STEP files as Open CASCADE reads them, and their meshes.

The pelvis is measured as it ships, and after affine and smooth maps that are drawn at random.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from pathlib import Path

import numpy as np
from measuring import table

from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.meshing.quality import quality
from VICRegistrationLib.meshing.regions import MeshOptions
from VICRegistrationLib.multipatch.library import MODELS
from VICRegistrationLib.multipatch.mesh import mesh_model
from VICRegistrationLib.multipatch.model import MultiPatchModel
from VICRegistrationLib.multipatch.step import write_model_step

_SIZE_MM = 3.0
_SAMPLES = 15
# Random maps: standard deviations of the entries of the matrix, and of six pushes that fade with the distance, mm.
_MAPS, _MATRIX, _PUSH_MM, _REACH_MM = 6, 0.1, 6.0, 45.0


def report(*, quick: bool) -> str:
    """Measure the models that ship; the first only, if quick."""
    if importlib.util.find_spec("gmsh") is None:
        return "  Skipped: gmsh is not installed."
    if importlib.util.find_spec("OCP") is None:
        return "  Skipped: cadquery-ocp-novtk is not installed."
    # What measures patches is the tests', and so is what asks Open CASCADE.
    sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "Python")]
    from patch_measures import angle_along_borders, distance_from_surfaces

    models = {name: make() for name, make in list(MODELS.items())[: 1 if quick else None]}
    pelvis = next(iter(models.values()))
    models.update({f"map {seed + 1}": _carried(pelvis, seed) for seed in range(0 if quick else _MAPS)})
    patches = [["patches", "points", "off the organ's surface, mm", "angle along borders, degrees"]]
    solids = [["STEP file", "kB", "solids", "faces", "valid", "volume off, relative"]]
    meshes = [["mesh", "order", "elements", "inverted", "least Jacobian", "lowest volume %", "highest volume %"]]
    for name, model in models.items():
        points = len(model.points)
        away, angle = distance_from_surfaces(model, _SAMPLES), angle_along_borders(model, _SAMPLES)
        patches.append([name, f"{points}", f"{away:.0e}", f"{angle:.0e}"])
        solids.append([name, *_step(model)])
        for order in (1, 2):
            found = quality(mesh_model(model, MeshOptions(size=_SIZE_MM, order=order)))
            off = [100.0 * (group["volume_ratio"] - 1.0) for group in found.groups.values()]
            numbers = [f"{found.tetrahedra}", f"{found.inverted}", f"{found.scaled_jacobian_min:.3f}"]
            meshes.append([name, f"{order}", *numbers, f"{min(off):+.2f}", f"{max(off):+.2f}"])
    about = f"  Elements of {_SIZE_MM:g} mm. Jacobians are scaled: 1 is the best, 0 is flat. Volumes: difference."
    return "\n\n".join([table(patches), table(solids), about, table(meshes)])


def _carried(model: MultiPatchModel, seed: int) -> MultiPatchModel:
    """Deform a model by a random map; its organs stay closed and smooth."""
    random = np.random.default_rng(seed)
    matrix = np.eye(3) + random.normal(0.0, _MATRIX, (3, 3))
    places, pushes = random.uniform(-60.0, 60.0, (6, 3)), random.normal(0.0, _PUSH_MM, (6, 3))

    def carry(points: np.ndarray) -> np.ndarray:
        distances = np.linalg.norm(points[:, None] - places, axis=2)
        return points @ matrix.T + np.exp(-np.square(distances / _REACH_MM)) @ pushes

    parents = {}
    for organ, parent in model.parents.items():
        closed = closed_organ(parent)
        net = carry(parent.control_net.reshape(-1, 3)).reshape(parent.control_net.shape)
        parents[organ] = closed.deform(closed.fit(net))
    return model.carried(parents, carry)


def _step(model: MultiPatchModel) -> list[str]:
    """What Open CASCADE finds in the STEP file."""
    import open_cascade

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.step")
        write_model_step(model, path)
        size, shape = path.stat().st_size, open_cascade.read(path)
    solids = open_cascade.solids(shape)
    off = [
        abs(open_cascade.volume(solid) / parent.volume() - 1.0) for solid, parent in zip(solids, model.parents.values())
    ]
    counts = [f"{len(solids)}", f"{len(open_cascade.faces(shape))}"]
    return [f"{size / 1000:.0f}", *counts, "yes" if open_cascade.is_valid(shape) else "no", f"{max(off):.0e}"]
