"""``vic-registration mesh``: surfaces as meshes of tetrahedra or of triangles of one size."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ..export.mesh_files import MESH_SUFFIXES, write_triangles
from ..export.step import Solid
from ..file_names import folder_name
from ..files import keep_inputs, replacing_folder, write_json
from ..meshing.formats import mesh_format
from ..meshing.regions import MeshOptions
from ..multipatch.file import is_model_file, read_model
from ..multipatch.model import MultiPatchModel
from . import validators
from .console import LOG, add_command, argument
from .solids import read_solids

SCHEMA, VERSION = "vic-registration/mesh-quality", 1
_DEFAULT = MeshOptions()

_EPILOG = f"""\
SURFACE is a file NAME.json or NAME.vtp of `vic-registration fit`, or one model.json. FILE is LPS mm; its ending chooses
the format:
  .msh   gmsh 4.1             .med   Salome, Code_Aster
  .vtu   VTK, ParaView        .unv   I-deas, Salome
  .vtk   VTK's legacy format  .bdf   Nastran (triangles are elements too)
  .inp   Abaqus, CalculiX (solid elements; shells for sheets of models)
with groups for loads and contacts: NAME (or NAME_wall) of tetrahedra; NAME_surface (or NAME_inside and NAME_outside)
and NAME_OTHER_interface of triangles; --patches 4x3 divides surfaces into NAME_surface_I_J, four around the organ and
three from pole to pole. The report that is printed is also written, to FILE.quality.json.

--wall makes organs hollow: the surface is that of the lumen, and the wall lies outside of it. Several organs are one
mesh with common nodes where they touch; an overlap belongs to the organ that is named first, and walls do not enter
lumens.
Elements are smaller than --size where the surface is strongly curved, so that the mesh keeps the organ's volume.
A model of several organs (vic-registration model) has a group for each of its parts and patches; its sheets are
triangles, in .inp files shell elements with their thickness.
--surface makes only triangles, of one organ, in a file {", ".join(MESH_SUFFIXES)}.

examples:
  vic-registration mesh bladder.json --size 3 --output bladder.msh
  vic-registration mesh bladder.json vagina.json rectum.json --wall 1.5 --order 2 --output pelvis.inp
  vic-registration mesh organs/model.json --output pelvis.inp
  vic-registration mesh bladder.json --surface --size 2 --output bladder_2mm.stl
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "mesh", "fill surfaces with tetrahedra for simulation", run, epilog=_EPILOG)
    parser.add_argument(
        "surfaces", metavar="SURFACE", nargs="+", help="surface file of fit, NAME.json or NAME.vtp; or one model.json"
    )
    parser.add_argument("--output", metavar="FILE", required=True, help="file to write")
    parser.add_argument(
        "--size",
        metavar="MM",
        type=argument(validators.number),
        default=_DEFAULT.size,
        help="edge length of the elements (default: 3)",
    )
    parser.add_argument("--surface", action="store_true", help="triangles of one size instead of tetrahedra")
    inside = parser.add_argument_group("tetrahedra")
    inside.add_argument("--order", type=int, choices=(1, 2), help="linear (default) or second-order elements")
    inside.add_argument(
        "--wall", metavar="MM", type=argument(validators.number), help="make hollow organs with a wall this thick"
    )
    inside.add_argument(
        "--patches",
        metavar="4x3",
        type=argument(_patches),
        help="divide the group of each surface into so many patches around the organ and from pole to pole",
    )
    inside.add_argument(
        "--volume-error",
        metavar="FRACTION",
        type=argument(validators.number),
        help="largest difference from the exact volume (default: 0.005 at 3 mm, proportional to the square of --size)",
    )
    parser.add_argument(
        "--time-limit",
        metavar="S",
        type=argument(validators.number),
        default=_DEFAULT.time_limit,
        help="seconds after which gmsh is ended (default: 600)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr, only the report")


def run(options: argparse.Namespace) -> None:
    """Mesh surfaces and write the mesh and its quality."""
    target = Path(folder_name(options.output))
    chosen = {
        word: getattr(options, word)
        for word in ("order", "wall", "patches", "volume_error")
        if getattr(options, word) is not None
    }
    _check_target(target, options, chosen)
    settings = MeshOptions(size=options.size, time_limit=options.time_limit, **chosen)
    model = _model(options)
    solids = model or read_solids(options.surfaces)
    with replacing_folder(target.parent) as drafts:
        make = _triangles if options.surface else _tetrahedra
        lines, report = make(solids, settings, drafts / target.name)
        content = {"schema": SCHEMA, "version": VERSION, "file": target.name, "frame": "LPS", "unit": "mm"}
        write_json(drafts / f"{target.name}.quality.json", {**content, **report})
    print("\n".join(lines))
    LOG.info(f"written to {target}")


def _model(options: argparse.Namespace) -> MultiPatchModel | None:
    """Read the model, if one is to be meshed."""
    if len(options.surfaces) > 1 or not is_model_file(options.surfaces[0]):
        return None
    if options.surface:
        msg = "--surface was given with a model; it is for the surface of one organ. Leave it out."
        raise ValueError(msg)
    return read_model(options.surfaces[0])


def _check_target(target: Path, options: argparse.Namespace, chosen: dict) -> None:
    """Refuse a target that cannot be written, before anything is computed."""
    if not options.surface:
        mesh_format(target)
    else:
        if target.suffix.lower() not in MESH_SUFFIXES:
            msg = f"{target.name} was asked for; triangles need a name that ends in {', '.join(MESH_SUFFIXES)}."
            raise ValueError(msg)
        if len(options.surfaces) > 1:
            msg = f"{len(options.surfaces)} surfaces were given; with --surface, give them one at a time."
            raise ValueError(msg)
        if chosen:
            msg = f"--{next(iter(chosen)).replace('_', '-')} was given, which is for tetrahedra; leave out --surface."
            raise ValueError(msg)
    keep_inputs((target, target.with_name(f"{target.name}.quality.json")), options.surfaces)


def _tetrahedra(what: Sequence[Solid] | MultiPatchModel, settings: MeshOptions, draft: Path) -> tuple[list[str], dict]:
    """Write the mesh; returns the report as lines to print and for the JSON file."""
    from ..meshing.formats import write_tetrahedra
    from ..meshing.organ_meshes import mesh_organs
    from ..meshing.quality import quality
    from ..multipatch.mesh import mesh_model

    make = mesh_model if isinstance(what, MultiPatchModel) else mesh_organs
    mesh = make(what, settings, on_progress=LOG.info)
    report = quality(mesh)
    LOG.info("writing")
    names = write_tetrahedra(mesh, draft)
    used = {"size": settings.size, "order": settings.order, "wall": settings.wall, "names_in_file": names}
    # A model has about a hundred groups of triangles, too many to print.
    lines = report.lines(surfaces=isinstance(what, Sequence)) + [f"note: {note.sentence()}" for note in mesh.notes]
    if mesh.shells or mesh.node_groups:
        used["shells"] = dict(mesh.shells)
        used["fixed_nodes"] = {place: len(nodes) for place, nodes in mesh.node_groups.items()}
    return lines, {**used, **report.as_json(), "notes": [note.record() for note in mesh.notes]}


def _triangles(solids: Sequence[Solid], settings: MeshOptions, draft: Path) -> tuple[list[str], dict]:
    from dataclasses import asdict

    from ..meshing.organ_meshes import mesh_surface
    from ..meshing.quality import triangle_quality

    (solid,) = solids
    mesh = mesh_surface(solid, settings, on_progress=LOG.info)
    write_triangles(mesh, solid.surface, draft, name=solid.name)
    report = triangle_quality(mesh.points, mesh.triangles)
    return report.lines(), {"size": settings.size, **asdict(report)}


def _patches(text: str) -> tuple[int, int]:
    """Read two numbers such as 4x3."""
    around, cross, along = text.partition("x")
    if not (cross and around.isdecimal() and along.isdecimal()):
        msg = f"{text!r} was given; patches are two whole numbers such as 4x3"
        raise ValueError(msg)
    return int(around), int(along)
