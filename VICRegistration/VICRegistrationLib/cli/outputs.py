"""Files about fitted organs."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from .. import __version__
from ..export.mesh_files import write_stl, write_vtp
from ..export.step import step_text
from ..files import replacing
from ..geometry.surface_file import write_surface
from ..geometry.triangulation import triangulate
from ..imaging.image import Image
from ..registration.boundary import boundary_deviations
from ..registration.choosing import Choice
from ..registration.diagnostics import border_sides, fit_diagnostics
from ..registration.nets import net_text
from ..registration.options import FitOptions
from ..registration.organ import OrganFit
from ..registration.stages import Step
from .solids import colored_solids

REPORT, PAGE, OVERVIEW, ASSEMBLY = "report.json", "report.html", "overview.png", "organs.step"
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
    boundary : tuple of (r, a, s)
        Boundary points that were given, RAS mm.
    asked : FitOptions, optional
        Options as they were given, with none for automatic choices.
    """

    name: str
    fit: OrganFit
    seeds: tuple[tuple[float, float, float], ...]
    seconds: float
    seconds_separation: float
    boundary: tuple[tuple[float, float, float], ...] = ()
    asked: FitOptions | None = None


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


def write_solids(organs: Sequence[FittedOrgan], folder: Path) -> tuple[str, ...]:
    """Write the exact surfaces as STEP solids, and several organs as an assembly too.

    Parameters
    ----------
    organs : sequence of FittedOrgan
    folder : Path
        Gets NAME.step for each organ whose surface is valid, and organs.step if all of several are.

    Returns
    -------
    tuple of str
        Names of the files.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    solids = colored_solids({organ.name: organ.fit.surface for organ in organs})
    texts = {f"{solid.name}.step": step_text([solid]) for organ, solid in zip(organs, solids) if not organ.fit.problems}
    if 1 < len(organs) == len(texts):
        texts[ASSEMBLY] = step_text(solids)
    for name, text in texts.items():
        with replacing(folder / name) as draft:
            draft.write_text(text, encoding="ascii")
    return tuple(texts)


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
    solids: Collection[str] = (),
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
    solids : collection of str
        Names of the STEP files.

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
                "files": organ_files(organ.name, pictures=pictures, solid=f"{organ.name}.step" in solids),
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
    region, threshold = fit.region, fit.options.threshold
    return {
        "volume_ml": fit.surface.volume() / 1000.0,
        "volume_sd_ml": fit.confidence.volume_sd_ml,
        "follows_no_edge": fit.confidence.unsupported_share,
        "area_mm2": fit.surface.area(),
        "separated_volume_ml": None if region is None else float(region.volume_ml),
        "iterations": fit.iterations,
        "converged": bool(fit.converged),
        "stopped_by": fit.history[-1].stopped_by,
        "cost_initial": float(fit.cost_initial),
        "cost_final": float(fit.cost_final),
        "seconds": organ.seconds,
        "seconds_separation": organ.seconds_separation,
        "threshold": None if threshold is None else [float(level) for level in threshold],
        "net": net_text(fit.options.net),
        "seed": [list(point) for point in organ.seeds],
        **_boundary_entry(organ),
        "erosion": None if region is None or region.erosion is None else float(region.erosion),
        "options": {key: value for key, value in options.items() if key != "erosion"},
        "choices": [_choice_entry(choice) for choice in fit.choices],
        "touches_border": [] if region is None else border_sides(image, region),
        "valid": not fit.problems,
        "warnings": [diagnostic.record() for diagnostic in fit_diagnostics(image, fit)],
    }


def _choice_entry(choice: Choice) -> dict:
    """Put a choice as JSON keeps it."""
    reasons = [reason.record() for reason in choice.reasons]
    return {"option": choice.option, "value": choice.value, "reasons": reasons}


def _boundary_entry(organ: FittedOrgan) -> dict:
    """Boundary points and how far from the surface they are, if there are any."""
    if not organ.boundary:
        return {}
    deviations = boundary_deviations(organ.fit.surface, organ.boundary)
    return {"boundary": [list(point) for point in organ.boundary], "boundary_deviation_mm": deviations.tolist()}


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
    endings = [
        ".vtp",
        ".stl",
        ".json",
        "_convergence.csv",
        *([".png"] if pictures else []),
        *([".step"] if solid else []),
    ]
    return [name + ending for ending in endings]
