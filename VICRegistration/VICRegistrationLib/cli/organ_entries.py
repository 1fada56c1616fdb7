"""Entries of organs in ``report.json``, from which the page can be made again without a fit."""

from __future__ import annotations

import base64
import csv
import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..files import reason
from ..geometry.surface import BSplineSurface
from ..geometry.surface_file import read_surface
from ..imaging.image import Image, beginning_at
from ..imaging.region import Region, region_from_crop
from ..messages import Diagnostic
from ..registration.boundary_points import boundary_deviations
from ..registration.choices import Choice
from ..registration.diagnostics import border_sides, fit_diagnostics
from ..registration.nets import net_text
from ..registration.options import FitOptions
from ..registration.organ_fit import OrganFit
from ..registration.stages import Step
from ..registration.verdict import Verdict, verdict_of
from .configuration import OrganRequest
from .model_results import ModelResults
from .references import OrganReference
from .stack_entries import restored_stack, stack_entry

CONVERGENCE = ("iteration", "stage", "stage_iteration", "cost", "displacement_mm", "converged", "stopped_by")


@dataclass(frozen=True, eq=False)
class FittedOrgan:
    """A fitted organ, its request, and its times.

    Parameters
    ----------
    request : OrganRequest
        What was asked for.
    fit : OrganFit
    seconds : float
        From the seeds to the surface.
    seconds_separation : float
        The part of it before the fit.
    """

    request: OrganRequest
    fit: OrganFit
    seconds: float
    seconds_separation: float

    @property
    def name(self) -> str:
        """Name of the organ and of its files."""
        return self.request.name

    @property
    def given(self) -> dict[str, object]:
        """Options that differ from their defaults."""
        usual = FitOptions()
        options = dataclasses.asdict(self.request.options)
        return {key: value for key, value in options.items() if value != getattr(usual, key)}

    @cached_property
    def diagnostics(self) -> list[Diagnostic]:
        """Warnings about the surface."""
        return fit_diagnostics(self.fit.image, self.fit)

    @cached_property
    def verdict(self) -> Verdict:
        """How far the surface can be trusted."""
        return verdict_of(self.fit, self.diagnostics)


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a run of ``fit``.

    Parameters
    ----------
    organs : sequence of FittedOrgan
    image : Image
    record : mapping
        Description of the image, from :func:`.stored_results.image_record`.
    seconds_load : float
        Time to read the image.
    pictures : bool
        Whether to draw pictures.
    step : bool
        Whether to write the exact solids.
    references : mapping of str to OrganReference
        By the organs' names.
    failed : mapping of str to str
        Organs that could not be fitted, with the error messages.
    model : ModelResults, optional
        The generic model that the organs were fitted with.
    """

    organs: Sequence[FittedOrgan]
    image: Image
    record: Mapping[str, object]
    seconds_load: float
    pictures: bool
    step: bool
    references: Mapping[str, OrganReference] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    model: ModelResults | None = None

    @property
    def names(self) -> list[str]:
        """Names of the organs."""
        return [organ.name for organ in self.organs]


def organ_entry(organ: FittedOrgan) -> dict[str, object]:
    """Make the entry of one organ for JSON.

    Parameters
    ----------
    organ : FittedOrgan

    Returns
    -------
    dict
        Lengths in mm, places in RAS.
    """
    fit = organ.fit
    region, threshold = fit.region, fit.options.threshold
    whole = fit.whole_region or region
    return {
        "verdict": organ.verdict.word,
        "verdict_reasons": [diagnostic.record() for diagnostic in organ.verdict.reasons],
        "volume_ml": fit.surface.volume() / 1000.0,
        "volume_sd_ml": fit.confidence.volume_sd_ml,
        "follows_no_edge": fit.confidence.unsupported_share,
        "area_mm2": fit.surface.area(),
        "separated_volume_ml": None if whole is None else float(whole.volume_ml),
        "iterations": fit.iterations,
        "converged": bool(fit.converged),
        "stopped_by": fit.history[-1].stopped_by,
        "cost_initial": float(fit.cost_initial),
        "cost_final": float(fit.cost_final),
        "seconds": organ.seconds,
        "seconds_separation": organ.seconds_separation,
        "seconds_fit": fit.seconds,
        "threshold": None if threshold is None else [float(level) for level in threshold],
        "net": net_text(fit.options.net),
        "seed": [list(point) for point in organ.request.seeds],
        **_boundary_entry(organ),
        "erosion": None if region is None or region.erosion is None else float(region.erosion),
        "options": dataclasses.asdict(fit.options),
        "options_given": organ.given,
        "choices": [
            {"option": each.option, "value": each.value, "reasons": [reason.record() for reason in each.reasons]}
            for each in fit.choices
        ],
        "touches_border": [] if whole is None else border_sides(fit.image, whole),
        "valid": not fit.problems,
        "warnings": [diagnostic.record() for diagnostic in organ.diagnostics],
        "region": None if region is None else _region_entry(region),
        **_stacks_entry(fit),
    }


def restored_organ(name: str, entry: Mapping[str, object], folder: Path, image: Image) -> FittedOrgan:
    """Restore an organ of an earlier run from its entry and files.

    Parameters
    ----------
    name : str
    entry : mapping
        From `organ_entry`.
    folder : Path
        Holds NAME.json and NAME_convergence.csv.
    image : Image
        The grey levels that were fitted.

    Returns
    -------
    FittedOrgan

    Raises
    ------
    ValueError
        If the entry or a file is missing or damaged.
    """
    try:
        surface = read_surface(folder / f"{name}.json")
        fit = _restored_fit(entry, surface, _read_history(folder / f"{name}_convergence.csv", surface), image)
        seeds, boundary = (tuple(map(tuple, points)) for points in (entry["seed"], entry.get("boundary", ())))
        request = OrganRequest(name, seeds, _options(entry["options_given"]), boundary)
        return FittedOrgan(request, fit, entry["seconds"], entry["seconds_separation"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zlib.error) as error:
        msg = (
            f"The organ {name} of an earlier run in {folder} cannot be read again ({reason(error)}); fit it again too, "
            f"or remove {folder / name}.json to leave it out of the report."
        )
        raise ValueError(msg) from error


def _restored_fit(
    entry: Mapping[str, object], surface: BSplineSurface, history: tuple[Step, ...], image: Image
) -> OrganFit:
    options = _options(entry["options"])
    points = np.array(entry.get("boundary", ()), dtype=float).reshape(-1, 3)
    return OrganFit(
        surface=surface,
        region=None if entry["region"] is None else _restored_region(entry, options, image),
        history=history,
        converged=entry["converged"],
        cost_initial=entry["cost_initial"],
        cost_final=entry["cost_final"],
        seconds=entry["seconds_fit"],
        options=options,
        boundary_points=points if options.boundary_weight > 0.0 else points[:0],
        uncorrected=surface,
        choices=tuple(
            Choice(each["option"], each["value"], tuple(map(Diagnostic.restored, each["reasons"])))
            for each in entry["choices"]
        ),
        image=image,
        stacks=tuple(restored_stack(stack) for stack in entry.get("stacks", ())),
        whole_region=_restored_whole(entry, options, image),
    )


def _stacks_entry(fit: OrganFit) -> dict[str, object]:
    """Further stacks, and the region that was completed from them, if there are any."""
    if not fit.stacks:
        return {}
    entry: dict[str, object] = {"stacks": [stack_entry(stack) for stack in fit.stacks]}
    if fit.whole_region is not None:
        entry["whole_region"] = {**_region_entry(fit.whole_region), "touches": list(fit.whole_region.touches_border)}
    return entry


def _restored_whole(entry: Mapping[str, object], options: FitOptions, image: Image) -> Region | None:
    """Restore a completed region, which may extend beyond the image."""
    found = entry.get("whole_region")
    if found is None:
        return None
    matrix = beginning_at(image.ijk_to_ras, np.array(found["offset_kji"][::-1], dtype=float))
    diagnostics = tuple(map(Diagnostic.restored, found["diagnostics"]))
    return Region(
        _mask(found),
        tuple(found["offset_kji"]),
        matrix,
        options.threshold,
        tuple(found["touches"]),
        entry["erosion"],
        diagnostics,
    )


def _region_entry(region: Region) -> dict[str, object]:
    """Voxels of the separated region, a bit for each, i fastest; and its diagnostics."""
    return {
        "offset_kji": list(region.offset),
        "shape_kji": list(region.mask.shape),
        "voxels": base64.b64encode(zlib.compress(np.packbits(region.mask).tobytes(), 9)).decode("ascii"),
        "diagnostics": [diagnostic.record() for diagnostic in region.diagnostics],
    }


def _restored_region(entry: Mapping[str, object], options: FitOptions, image: Image) -> Region:
    found = entry["region"]
    own = {"threshold": options.threshold, "erosion": entry["erosion"]}
    region = region_from_crop(image, _mask(found), np.array(found["offset_kji"]), fill=False, **own)
    return replace(region, diagnostics=tuple(map(Diagnostic.restored, found["diagnostics"])))


def _mask(found: Mapping[str, object]) -> np.ndarray:
    """Voxels of a stored region."""
    shape = tuple(found["shape_kji"])
    bits = np.frombuffer(zlib.decompress(base64.b64decode(found["voxels"])), dtype=np.uint8)
    return np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).astype(bool)


def _options(entry: Mapping[str, object]) -> FitOptions:
    return FitOptions(**{key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()})


def _boundary_entry(organ: FittedOrgan) -> dict[str, object]:
    """Boundary points and their distances from the surface, if there are any."""
    points = organ.request.boundary
    if not points:
        return {}
    deviations = boundary_deviations(organ.fit.surface, points)
    return {"boundary": [list(point) for point in points], "boundary_deviation_mm": deviations.tolist()}


def _read_history(path: Path, surface: BSplineSurface) -> tuple[Step, ...]:
    """Read the steps from a table of convergence; their surfaces were not stored, so the last one stands for all."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        msg = f"{path} holds no iterations"
        raise ValueError(msg)
    return tuple(
        Step(
            row["stage"],
            int(row["stage_iteration"]),
            float(row["cost"]),
            float(row["displacement_mm"]),
            surface,
            row["stopped_by"],
        )
        for row in rows
    )
