"""Writing the files of fitted organs."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from pathlib import Path

from .. import __version__
from ..export.mesh_files import write_stl, write_vtp
from ..export.step import step_text
from ..files import write_json, write_text
from ..geometry.surface_file import write_surface
from ..geometry.triangulation import triangulate
from ..registration.nets import net_text
from ..registration.stages import Step
from .organ_entries import CONVERGENCE, FittedOrgan, Run, organ_entry
from .solids import colored_solids
from .stored_results import ASSEMBLY, REPORT, SCHEMA, VERSION, file_digest, with_digest

PROGRAM_VERSION = f"vic-registration {__version__}"
# Endings of the files of an organ, with descriptions for report.html.
ORGAN_FILES = {
    ".vtp": "triangles for Slicer and other programs (LPS mm), with the control net",
    ".stl": "triangles (LPS mm)",
    ".json": "the B-spline surface itself (RAS mm)",
    "_convergence.csv": "cost and largest displacement of every iteration",
    ".png": "slices, surface and convergence in one picture",
    ".step": "the exact solid for CAD and simulation (LPS mm)",
}


def write_organ(organ: FittedOrgan, folder: Path) -> None:
    """Write the surface, its triangles and the convergence.

    Parameters
    ----------
    organ : FittedOrgan
    folder : Path
        Gets NAME.json, NAME.vtp, NAME.stl and NAME_convergence.csv.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    surface, name, options = organ.fit.surface, organ.name, organ.fit.options
    mesh = triangulate(surface)
    write_surface(surface, folder / f"{name}.json", name=name, net=net_text(options.net), closure=options.closure)
    write_vtp(mesh, surface, folder / f"{name}.vtp", name=name)
    write_stl(mesh, folder / f"{name}.stl", name=name)
    write_convergence(organ.fit.history, folder / f"{name}_convergence.csv")


def write_solids(organs: Sequence[FittedOrgan], folder: Path, *, names: Collection[str]) -> list[str]:
    """Write exact surfaces as STEP solids, and several organs also as an assembly.

    Parameters
    ----------
    organs : sequence of FittedOrgan
        All organs of the folder of results.
    folder : Path
        Gets NAME.step for each organ of `names` whose surface is valid, and organs.step if there are several organs,
        all of them valid.
    names : collection of str
        Of the organs of this run.

    Returns
    -------
    list of str
        Names of the files.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    valid = [organ.name for organ in organs if not organ.fit.problems]
    solids = colored_solids({organ.name: organ.fit.surface for organ in organs})
    texts = {
        f"{solid.name}.step": step_text([solid]) for solid in solids if solid.name in names and solid.name in valid
    }
    if 1 < len(organs) == len(valid):
        texts[ASSEMBLY] = step_text(solids)
    for name, text in texts.items():
        write_text(folder / name, text)
    return list(texts)


def write_convergence(history: Sequence[Step], path: Path) -> None:
    """Write a table of all iterations.

    Parameters
    ----------
    history : sequence of Step
    path : Path
        CSV file with the columns iteration (of all), stage, stage_iteration, cost, displacement_mm, converged and
        stopped_by (empty before the end of a stage).

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(CONVERGENCE)
    for number, step in enumerate(history, start=1):
        numbers = (repr(float(step.cost)), repr(float(step.displacement)))
        end = (str(bool(step.converged)).lower(), step.stopped_by)
        writer.writerow([number, step.stage, step.iteration, *numbers, *end])
    write_text(path, table.getvalue())


def write_report(run: Run, organs: Mapping[str, Mapping[str, object]], folder: Path, *, files: Sequence[str]) -> None:
    """Write report.json.

    Parameters
    ----------
    run : Run
    organs : mapping of str to mapping
        Entries of all organs of the folder, those of earlier runs too.
    folder : Path
    files : sequence of str
        Names of the files that have all organs.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "program": PROGRAM_VERSION,
        **run.record,
        "frame": "RAS",
        "mesh_frame": "LPS",
        "unit": "mm",
        "seconds_load": run.seconds_load,
        "files": {name: file_digest(folder / name) for name in files},
        "organs": organs,
        **({} if run.model is None else {"model": run.model.entry()}),
        "failed": run.failed,
    }
    write_json(folder / REPORT, with_digest(content))


def run_entry(run: Run, organ: FittedOrgan, folder: Path, *, files: Sequence[str]) -> dict[str, object]:
    """Make the entry of an organ of a run for report.json.

    Parameters
    ----------
    run : Run
    organ : FittedOrgan
        One of its organs.
    folder : Path
        Holds the files.
    files : sequence of str
        Names of the organ's files.

    Returns
    -------
    dict
        The entry of `organ_entry`, with the program, the time, the files and the reference.
    """
    reference = run.references.get(organ.name)
    return {
        "program": PROGRAM_VERSION,
        "written": datetime.now().astimezone().isoformat(timespec="seconds"),
        **organ_entry(organ),
        "reference": None if reference is None else reference.record(),
        "files": {name: file_digest(folder / name) for name in files},
        "seconds_load": run.seconds_load,
    }


def organ_files(name: str, *, pictures: bool, solid: bool = False) -> list[str]:
    """Names of the files of one organ.

    Parameters
    ----------
    name : str
    pictures : bool
        Whether pictures are drawn.
    solid : bool
        Whether its STEP file is written.

    Returns
    -------
    list of str
    """
    left_out = {".png": not pictures, ".step": not solid}
    return [name + ending for ending in ORGAN_FILES if not left_out.get(ending)]
