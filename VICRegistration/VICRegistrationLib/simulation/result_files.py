"""Files of a simulation: displacement, strain and stress as VTU, and a report."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from .. import __version__
from ..export.frames import RAS_TO_LPS
from ..export.vtk_xml import xml_text
from ..files import replacing
from ..meshing.formats import vtu_grid
from .problems import SelfWeight
from .solution import Solution

SCHEMA, VERSION = "vic-registration/simulation", 1
# Signs of the components XX, YY, ZZ, XY, YZ, XZ of a tensor in LPS.
_TENSOR_SIGNS = np.concatenate([np.ones(3), RAS_TO_LPS[[0, 1, 0]] * RAS_TO_LPS[[1, 2, 2]]])


def write_vtu(solution: Solution, path: str | os.PathLike) -> None:
    """Write a solution as a VTU file, LPS mm.

    Parameters
    ----------
    solution : Solution
    path : path
        File to write. Of its points: ``displacement`` (mm). Of its cells, means over each: ``strain``, ``stress`` (kPa;
        XX, YY, ZZ, XY, YZ, XZ), ``equivalent_stress`` (kPa, von Mises), and ``group`` as in the
        mesh's own file.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    mesh = solution.mesh
    no_triangles = np.zeros((0, mesh.triangles.shape[1]), dtype=int)
    grid = vtu_grid(dataclasses.replace(mesh, triangles=no_triangles, triangle_groups={}))
    grid.GetPointData().SetVectors(_array("displacement", np.nan_to_num(solution.displacement) * RAS_TO_LPS))
    for name, values in (
        ("strain", solution.strain * _TENSOR_SIGNS),
        ("stress", solution.stress * _TENSOR_SIGNS),
        ("equivalent_stress", solution.equivalent_stress),
    ):
        array = _array(name, values)
        if values.ndim == 2:
            for number, component in enumerate(("XX", "YY", "ZZ", "XY", "YZ", "XZ")):
                array.SetComponentName(number, component)
        grid.GetCellData().AddArray(array)
    text = xml_text(vtkXMLUnstructuredGridWriter(), grid)
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_report(solution: Solution, path: str | os.PathLike, *, mesh: str, files: list[str]) -> None:
    """Write problem and result as a JSON file.

    Parameters
    ----------
    solution : Solution
    path : path
        File to write. Vectors are RAS.
    mesh : str
        Name of the mesh's file.
    files : list of str
        What else was written.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    problem = dataclasses.asdict(solution.problem)
    length = np.linalg.norm(solution.displacement, axis=1)
    largest = int(np.nanargmax(length))
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "program": f"vic-registration {__version__}",
        "mesh": mesh,
        "case": "self-weight" if isinstance(solution.problem, SelfWeight) else "pressure",
        "units": {"length": "mm", "stress": "kPa", "force": "mN", "energy": "uJ", "density": "kg/m3"},
        "problem": problem,
        "material": dataclasses.asdict(solution.material),
        "nodes": int(np.isfinite(length).sum()),
        "elements": len(solution.mesh.tetrahedra),
        "order": solution.mesh.order,
        "largest_displacement": float(length[largest]),
        "largest_displacement_at": solution.mesh.points[largest].tolist(),
        "largest_equivalent_stress": float(solution.equivalent_stress.max()),
        "energy": solution.energy,
        "foundation_energy": solution.foundation_energy,
        "force": list(solution.force),
        "iterations": solution.iterations,
        "residual": solution.residual,
        "notes": list(solution.notes),
        "files": files,
    }
    with replacing(path) as draft:
        Path(draft).write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _array(name: str, values: np.ndarray):
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    return array
