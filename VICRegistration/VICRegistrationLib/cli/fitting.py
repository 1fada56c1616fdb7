"""From an image on disk and requests to a folder of results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..files import check_writable, keep_inputs
from ..imaging.image import Image
from ..imaging.labels import read_label
from ..imaging.region import Region, region_from_label
from ..registration.boundary_points import boundary_deviations
from ..registration.organ import fit_region
from ..registration.stacks import Stack, StackUse
from ..registration.stages import Step
from ..registration.steps import finish
from ..registration.verdict import GOOD
from ..report.figure import require_packages
from ..segmentation.separation import separate
from ..transactions import recover
from .configuration import OrganRequest
from .console import LOG
from .images import described, further_stacks, read_with_warnings
from .model_results import ModelResults
from .organ_entries import FittedOrgan, Run
from .process import silenced_stderr
from .references import OrganReference
from .request_checks import check_request
from .results_folder import restored_organs, target_files, write_results
from .stack_entries import motion_text
from .stored_results import StoredResults, image_record, read_results

# The request for an organ, its region, and the time of the separation, s.
Separated = tuple[OrganRequest, Region, float]
# Fits all organs together, by a generic model, to an image and further stacks.
FitModel = Callable[[Image, Sequence[Separated], Mapping[str, Stack]], tuple[Sequence[FittedOrgan], ModelResults]]
# Files that a user may take for a label image.
_SURFACES = (".json", ".stl", ".ply", ".obj", ".vtp")


def fit_to_folder(
    image_path: str | os.PathLike,
    requests: Sequence[OrganRequest],
    folder: str | os.PathLike,
    *,
    series: str | None = None,
    frame: int | None = None,
    pictures: bool = True,
    step: bool = False,
    references: Mapping[str, OrganReference] | None = None,
    inputs: Sequence[str | os.PathLike] = (),
    keep_going: bool = False,
    fit_model: FitModel | None = None,
) -> Run:
    """Fit organs, and write their files and the report of all organs of the folder: all files or none.

    Parameters
    ----------
    image_path : path
        File or folder of DICOM slices.
    requests : sequence of OrganRequest
        All of them are checked before the first is fitted.
    folder : path
        Folder of results of this image, see :mod:`.stored_results`; made if it does not exist.
    series : str, optional
        DICOM series of the folder.
    frame : int, optional
        Number of the volume, from 1, if the image has several.
    pictures : bool
        Whether to draw pictures, which needs matplotlib.
    step : bool
        Whether to write the exact solids as STEP files. A surface that is no valid solid gets none, and a warning.
    references : mapping of str to OrganReference, optional
        References of the organs for the pictures and report.html, by the organs' names.
    inputs : sequence of path
        Files besides the image that must not be replaced, such as the configuration.
    keep_going : bool
        If an organ cannot be fitted, fit the others. Without it, and if no organ can be fitted, that is an error.
    fit_model : callable, optional
        Fits the organs together, by a generic model, instead of one after the other.

    Returns
    -------
    Run
        The fitted organs, and those that could not be fitted.

    Raises
    ------
    ValueError
        If the image or a request cannot be used, the folder belongs to another image, or a file that is no result
        would be replaced.
    OSError
        If a file cannot be read or written.
    RuntimeError
        If pictures are wanted and matplotlib is missing.
    """
    if pictures:
        require_packages("matplotlib", "jinja2")
    folder = Path(folder)
    names = [request.name for request in requests]
    targets = target_files(names, pictures=pictures, step=step, model=fit_model is not None)
    stored = _checked_folder(folder, [image_path, *inputs], names, targets)
    image, record, seconds_load = _loaded_image(image_path, series, frame, stored)
    if pictures or step:
        restored_organs(stored, names, image)
    stacks = further_stacks(each for request in requests for each in request.also)
    failed: dict[str, str] = {}
    separated = _separated_organs(image, requests, failed)
    if failed and not (keep_going and separated):
        raise ValueError(_all_of(failed))
    if fit_model is not None:
        organs, model = fit_model(image, separated, stacks)
    else:
        organs, model = _fitted_organs(image, separated, stacks, failed, keep_going=keep_going), None
    for organ in organs:
        _print_outcome(organ, step=step)
    for diagnostic in model.fit.diagnostics if model is not None else ():
        LOG.warning(f"model: {diagnostic.sentence()}")
    for name, sentence in failed.items():
        LOG.warning(f"{name}: error: {sentence}")
    run = Run(organs, image, record, seconds_load, pictures, step, references or {}, failed, model)
    write_results(run, folder)
    return run


def _checked_folder(folder: Path, inputs: Sequence, names: Sequence[str], targets: Sequence[str]) -> StoredResults:
    """Read a folder of results; refuse one that cannot be written to, or in which files would be lost."""
    check_writable(folder)
    recover(folder)
    stored = read_results(folder)
    stored.check_names(names)
    keep_inputs((folder / target for target in targets), inputs)
    stored.check_targets(targets)
    return stored


def _loaded_image(
    path: str | os.PathLike, series: str | None, frame: int | None, stored: StoredResults
) -> tuple[Image, dict[str, object], float]:
    """Read the image, which must be that of the folder's results; returns it, its record, and the time, s."""
    start = time.perf_counter()
    image, notes = read_with_warnings(path, series=series, frame=frame)
    seconds = time.perf_counter() - start
    LOG.info(f"{path}: {described(image)}, {seconds:.2f} s")
    record = image_record(image, str(path), series, frame, notes)
    stored.check_image(record)
    return image, record, seconds


def _print_outcome(organ: FittedOrgan, *, step: bool) -> None:
    """Print volume, verdict and warnings of an organ."""
    word = organ.verdict.word
    if points := organ.request.boundary:
        away = max(map(abs, boundary_deviations(organ.fit.surface, points)))
        count = f"{len(points)} boundary point{'s' if len(points) > 1 else ''}"
        LOG.info(f"{organ.name}: {count}, up to {away:.2f} mm from the surface")
    LOG.info(f"{organ.name}: {organ.fit.surface.volume() / 1000.0:.1f} ml, verdict {word}")
    for diagnostic in organ.diagnostics:
        LOG.warning(f"{organ.name}: warning: {diagnostic.sentence()}")
    if word != GOOD:
        LOG.warning(f"{organ.name}: warning: the verdict on the surface is {word}")
    if step and organ.fit.problems:
        LOG.warning(f"{organ.name}: warning: {organ.name}.step was not written, because the surface is no valid solid")


def _fitted_organs(
    image: Image,
    separated: Sequence[Separated],
    stacks: Mapping[str, Stack],
    failed: dict[str, str],
    *,
    keep_going: bool,
) -> list[FittedOrgan]:
    """Fit organs one after the other; errors are raised, or added to `failed` with `keep_going`."""
    organs = []
    for request, region, seconds in separated:
        try:
            organs.append(_fitted(image, request, region, [stacks[path] for path in request.also], seconds))
        except ValueError as error:
            failed[request.name] = str(error)
            if not keep_going:
                raise ValueError(_all_of(failed)) from error
    if not organs:
        raise ValueError(_all_of(failed))
    return organs


def _all_of(failed: Mapping[str, str]) -> str:
    """Join the error messages of several organs, each with the organ's name."""
    return " ".join(f"{name}: {sentence}" for name, sentence in failed.items())


def _separated_organs(
    image: Image,
    requests: Sequence[OrganRequest],
    failed: dict[str, str],
) -> list[Separated]:
    """Separate all organs; errors are added to `failed`."""
    separated = []
    for request in requests:
        try:
            separated.append((request, *_separated(image, request)))
        except ValueError as error:
            failed[request.name] = str(error)
    return separated


def _separated(image: Image, request: OrganRequest) -> tuple[Region, float]:
    """Separate one organ, or take it from a label image; returns the region and the time, s."""
    options = request.options
    start = time.perf_counter()
    check_request(image, request)
    if request.region is not None:
        return _from_label(image, request)
    region = separate(
        image, request.seeds, threshold=options.threshold, erosion=options.erosion, dilation=options.dilation
    )
    seconds = time.perf_counter() - start
    low, high = region.threshold
    found = f"{region.volume_ml:.1f} ml, threshold {low:.5g} to {high:.5g}"
    LOG.info(f"{request.name}: separation, {found}, {seconds:.2f} s")
    return region, seconds


def _from_label(image: Image, request: OrganRequest) -> tuple[Region, float]:
    """Take one organ from a label image; returns the region and the time, s."""
    start = time.perf_counter()
    if Path(request.region).suffix.lower() in _SURFACES:
        msg = (
            f"{request.region} is a mesh or a surface, but a region is a label image. Give a label image, such as a "
            "segmentation of 3D Slicer (.seg.nrrd), or seeds."
        )
        raise ValueError(msg)
    notes: list[str] = []
    # Readers written in C print errors, which they also raise.
    with silenced_stderr():
        label, segment = read_label(request.region, request.label, organ=request.name, warn=notes.append)
    for note in notes:
        LOG.warning(f"{request.name}: warning: {note}")
    try:
        region = region_from_label(image, label)
    except ValueError as error:
        msg = f"{request.region}, label {segment}: {error}"
        raise ValueError(msg) from error
    seconds = time.perf_counter() - start
    LOG.info(f"{request.name}: region of {request.region}, label {segment}, {region.volume_ml:.1f} ml, {seconds:.2f} s")
    return region, seconds


def _fitted(
    image: Image,
    request: OrganRequest,
    region: Region,
    stacks: Sequence[Stack],
    seconds_separation: float,
) -> FittedOrgan:
    """Fit one organ to its region."""
    start = time.perf_counter()
    steps = fit_region(image, region, request.options, boundary_points=request.boundary, further=stacks)
    fit = finish(steps, on_step=stage_lines(request.name))
    print_motions(request.name, fit.stacks)
    seconds = seconds_separation + time.perf_counter() - start
    return FittedOrgan(request, fit, seconds, seconds_separation)


def print_motions(name: str, stacks: Sequence[StackUse]) -> None:
    """Print the motion of an organ in each stack that was used."""
    for stack in stacks:
        if stack.used:
            LOG.info(f"{name}: {stack.name}, moved by {motion_text(stack)}, cost {stack.cost:.4g}")


def stage_lines(name: str) -> Callable[[Step], None]:
    """Make a function that is called with every step, and prints a line at the end of each stage."""
    steps: list[Step] = []
    start = time.perf_counter()

    def on_step(step: Step) -> None:
        nonlocal start
        steps.append(step)
        if not step.stopped_by:
            return
        now = time.perf_counter()
        state = "" if step.converged else ", not converged"
        count = f"{len(steps)} iteration{'s' if len(steps) > 1 else ''}"
        cost = f"cost {steps[0].cost:.4g} -> {step.cost:.4g}"
        LOG.info(f"{name}: {step.stage}, {count}, {cost}, {now - start:.2f} s{state}")
        steps.clear()
        start = now

    return on_step
