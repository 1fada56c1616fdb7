"""Files about fitted organs."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .. import __version__
from ..export.mesh_files import write_stl, write_vtp
from ..files import replacing
from ..geometry.surface_file import write_surface
from ..geometry.triangulation import triangulate
from ..imaging.image import Image
from ..registration.doubts import border_sides, warnings_about
from ..registration.organ import OrganFit
from ..registration.stages import Step

REPORT, OVERVIEW = "report.json", "overview.png"
REPORT_SCHEMA, REPORT_VERSION = "vic-registration/report", 1


@dataclass(frozen=True, eq=False)
class FittedOrgan:
    """A fitted organ and what it took.

    Parameters
    ----------
    name : str
    fit : OrganFit
    seeds : tuple of (r, a, s)
        RAS mm.
    seconds : float
        From the seeds to the surface.
    seconds_separation : float
        The part of it before the fit.
    """

    name: str
    fit: OrganFit
    seeds: tuple[tuple[float, float, float], ...]
    seconds: float
    seconds_separation: float


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
    write_surface(surface, folder / f"{name}.json", name=name, net=_net_text(options.net), closure=options.closure)
    write_vtp(mesh, surface, folder / f"{name}.vtp", name=name)
    write_stl(mesh, folder / f"{name}.stl", name=name)
    write_convergence(organ.fit.history, folder / f"{name}_convergence.csv")


def write_convergence(history: Sequence[Step], path: Path) -> None:
    """Write a table of all iterations.

    Parameters
    ----------
    history : sequence of Step
    path : Path
        CSV file with the columns iteration (of all), stage, stage_iteration, cost, displacement_mm and converged.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["iteration", "stage", "stage_iteration", "cost", "displacement_mm", "converged"])
    for number, step in enumerate(history, start=1):
        numbers = (repr(float(step.cost)), repr(float(step.displacement)))
        writer.writerow([number, step.stage, step.iteration, *numbers, str(bool(step.converged)).lower()])
    with replacing(path) as draft:
        draft.write_text(table.getvalue(), encoding="utf-8")


def write_report(
    folder: Path,
    organs: Sequence[FittedOrgan],
    image: Image,
    *,
    image_path: str,
    seconds_load: float,
    pictures: bool,
) -> None:
    """Write report.json.

    Parameters
    ----------
    folder : Path
    organs : sequence of FittedOrgan
    image : Image
    image_path : str
        As the user gave it.
    seconds_load : float
        Time to read the image.
    pictures : bool
        Whether pictures were drawn.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    content = {
        "schema": REPORT_SCHEMA,
        "version": REPORT_VERSION,
        "program": f"vic-registration {__version__}",
        "image": image_path,
        "image_size": image.size.tolist(),
        "image_spacing_mm": image.spacing.tolist(),
        "frame": "RAS",
        "mesh_frame": "LPS",
        "unit": "mm",
        "seconds_load": seconds_load,
        "organs": {
            organ.name: {
                **_entry(organ, image),
                "seconds_load": seconds_load,
                "files": organ_files(organ.name, pictures=pictures),
            }
            for organ in organs
        },
    }
    with replacing(folder / REPORT) as draft:
        text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
        draft.write_text(text + "\n", encoding="utf-8")


def _entry(organ: FittedOrgan, image: Image) -> dict:
    """Everything about one organ, as JSON keeps it."""
    fit = organ.fit
    options = {key: value for key, value in dataclasses.asdict(fit.options).items() if key not in ("net", "threshold")}
    return {
        "volume_ml": fit.surface.volume() / 1000.0,
        "area_mm2": fit.surface.area(),
        "separated_volume_ml": float(fit.region.volume_ml),
        "iterations": fit.iterations,
        "converged": bool(fit.converged),
        "stopped_by": fit.history[-1].stopped_by,
        "cost_initial": float(fit.cost_initial),
        "cost_final": float(fit.cost_final),
        "seconds": organ.seconds,
        "seconds_separation": organ.seconds_separation,
        "threshold": [float(level) for level in fit.options.threshold],
        "net": _net_text(fit.options.net),
        "seed": [list(point) for point in organ.seeds],
        "erosion": None if fit.region.erosion is None else float(fit.region.erosion),
        "options": {key: value for key, value in options.items() if key != "erosion"},
        "touches_border": border_sides(image, fit.region),
        "valid": not fit.problems,
        "warnings": warnings_about(image, organ.fit),
    }


def organ_files(name: str, *, pictures: bool) -> list[str]:
    """Names of the files of one organ.

    Parameters
    ----------
    name : str
    pictures : bool
        Whether pictures are drawn.

    Returns
    -------
    list of str
    """
    endings = [".vtp", ".stl", ".json", "_convergence.csv", *([".png"] if pictures else [])]
    return [name + ending for ending in endings]


def _net_text(net: tuple[int, int]) -> str:
    return f"{net[0]}x{net[1]}"
