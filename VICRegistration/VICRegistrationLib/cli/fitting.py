"""From an image on disk and requests to a folder of results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..files import keep_inputs, replacing_folder
from ..imaging.image import Image
from ..imaging.reading import read_image
from ..registration.diagnostics import fit_diagnostics
from ..registration.organ import finish, fit_region
from ..registration.stages import Step
from ..report.canvas import require_matplotlib
from ..report.contents import Source
from ..report.pictures import organ_picture, overview_picture
from ..segmentation.separation import separate
from .configuration import OrganRequest
from .outputs import ASSEMBLY, OVERVIEW, PAGE, REPORT, FittedOrgan, organ_files, write_organ, write_report, write_solids
from .process import silenced_stderr
from .references import OrganReference
from .report_page import compared_organs, write_page


def fit_to_folder(
    image_path: str | os.PathLike,
    requests: Sequence[OrganRequest],
    folder: str | os.PathLike,
    *,
    series: str | None = None,
    pictures: bool = True,
    step: bool = False,
    references: Mapping[str, OrganReference] | None = None,
    inputs: Sequence[str | os.PathLike] = (),
    say: Callable[[str], None] = lambda line: None,
    warn: Callable[[str], None] = lambda line: None,
) -> tuple[FittedOrgan, ...]:
    """Fit organs and write their files and the report: all of them, or nothing.

    Parameters
    ----------
    image_path : path
        File or folder of DICOM slices.
    requests : sequence of OrganRequest
    folder : path
        Is made if there is none; its other files stay.
    series : str, optional
        DICOM series of the folder.
    pictures : bool
        Whether to draw pictures, which needs matplotlib.
    step : bool
        Whether to write the exact solids as STEP files. A surface that is no valid solid gets none, and a warning.
    references : mapping of str to OrganReference, optional
        What the surfaces are compared with in pictures and report.html, by the organs' names.
    inputs : sequence of path
        Files besides the image that must not be replaced, such as the configuration.
    say, warn : callable
        Get a line of progress after every stage, and every warning.

    Returns
    -------
    tuple of FittedOrgan

    Raises
    ------
    ValueError
        If the image or a request cannot be used, or a result would replace the image or one of the inputs.
    OSError
        If a file cannot be read or written.
    RuntimeError
        If pictures are wanted and matplotlib is missing.
    """
    if pictures:
        require_matplotlib()
    _check_inputs([image_path, *inputs], requests, Path(folder), pictures=pictures, step=step)
    with replacing_folder(folder, outdated=_outdated(requests, Path(folder), pictures=pictures)) as drafts:
        start = time.perf_counter()
        with silenced_stderr():
            image = read_image(image_path, series=series)
        seconds_load = time.perf_counter() - start
        say(f"{image_path}: {_described(image)}, {seconds_load:.2f} s")
        organs = tuple(_fitted(image, request, say) for request in requests)
        for organ in organs:
            write_organ(organ, drafts)
            _tell_warnings(organ, image, warn, step=step)
        solids = write_solids(organs, drafts) if step else ()
        if pictures:
            source = Source(str(image_path), series or "")
            _write_pictures(organs, drafts, image, source, references=references or {}, solids=solids, warn=warn)
        write_report(
            drafts,
            organs,
            image,
            image_path=str(image_path),
            seconds_load=seconds_load,
            pictures=pictures,
            solids=solids,
        )
    say(f"written to {Path(folder)}: {', '.join(organ.name for organ in organs)}")
    return organs


def _tell_warnings(organ: FittedOrgan, image: Image, warn: Callable[[str], None], *, step: bool) -> None:
    for diagnostic in fit_diagnostics(image, organ.fit):
        warn(f"{organ.name}: warning: {diagnostic.sentence()}")
    if step and organ.fit.problems:
        warn(f"{organ.name}: warning: there is no {organ.name}.step, as the surface is no valid solid")


def _write_pictures(
    organs: Sequence[FittedOrgan],
    drafts: Path,
    image: Image,
    source: Source,
    *,
    references: Mapping[str, OrganReference],
    solids: Sequence[str],
    warn: Callable[[str], None],
) -> None:
    """Write a picture of each organ, one of all of several, and the page that people read."""
    compared = compared_organs(organs, references)
    shapes = {name: found.read.reference for name, found in compared.items()}
    for organ in organs:
        count = len(fit_diagnostics(image, organ.fit))
        path = drafts / f"{organ.name}.png"
        organ_picture(path, image, organ.fit, organ.name, reference=shapes.get(organ.name), n_warnings=count)
    if len(organs) > 1:
        fits = {organ.name: organ.fit for organ in organs}
        overview_picture(drafts / OVERVIEW, image, fits, references=shapes)
    for name, found in compared.items():
        for warning in found.warnings:
            warn(f"{name}: warning: {warning}")
    write_page(drafts, organs, image, source, compared=compared, solids=solids)


def _check_inputs(inputs, requests: Sequence[OrganRequest], folder: Path, *, pictures: bool, step: bool) -> None:
    """Refuse to replace what is read."""
    names = [name for request in requests for name in organ_files(request.name, pictures=pictures, solid=step)]
    names += [PAGE] if pictures else []
    if len(requests) > 1:
        names += [*([OVERVIEW] if pictures else []), *([ASSEMBLY] if step else [])]
    keep_inputs((folder / name for name in [*names, REPORT]), inputs)


def _outdated(requests: Sequence[OrganRequest], folder: Path, *, pictures: bool) -> list[str]:
    """Pictures and solids of an earlier fit in the folder that would not show the new surfaces."""
    if not (folder / REPORT).is_file():
        return []
    # What is written now is not removed.
    solids = [ASSEMBLY, *(f"{request.name}.step" for request in requests)]
    overview = [] if pictures and len(requests) > 1 else [OVERVIEW]
    drawings = [] if pictures else [PAGE, *(f"{request.name}.png" for request in requests)]
    return [*overview, *drawings, *solids]


def _fitted(image: Image, request: OrganRequest, say: Callable[[str], None]) -> FittedOrgan:
    """Separate and fit one organ; complaints name it."""
    options = request.options
    start = time.perf_counter()
    try:
        region = separate(
            image,
            request.seeds,
            threshold=options.threshold,
            erosion=options.erosion,
            dilation=options.dilation,
        )
        seconds_separation = time.perf_counter() - start
        low, high = region.threshold
        say(
            f"{request.name}: separation, {region.volume_ml:.1f} ml, threshold {low:.4g} to {high:.4g}, "
            f"{seconds_separation:.2f} s"
        )
        lines = _StageLines(request.name, say)
        fit = finish(fit_region(image, region, options, boundary_points=request.boundary), on_step=lines)
        lines.end()
    except ValueError as error:
        msg = f"{request.name}: {error}"
        raise ValueError(msg) from error
    seconds = time.perf_counter() - start
    return FittedOrgan(request.name, fit, request.seeds, seconds, seconds_separation, request.boundary, options)


class _StageLines:
    """Tells a line for every stage: called with each step, and once more at the end."""

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        self._name, self._say = name, say
        self._steps: list[Step] = []
        self._start = self._now = time.perf_counter()

    def __call__(self, step: Step) -> None:
        if self._steps and step.stage != self._steps[0].stage:
            self.end()
        self._steps.append(step)
        self._now = time.perf_counter()

    def end(self) -> None:
        """Tell the line of the stage so far."""
        first, last = self._steps[0], self._steps[-1]
        state = "" if last.converged else ", not converged"
        count = f"{len(self._steps)} iteration{'s' if len(self._steps) > 1 else ''}"
        self._say(
            f"{self._name}: {last.stage}, {count}, cost {first.cost:.4g} -> {last.cost:.4g}, "
            f"{self._now - self._start:.2f} s{state}"
        )
        self._steps, self._start = [], self._now


def _described(image: Image) -> str:
    size = " x ".join(str(count) for count in image.size)
    spacing = " x ".join(f"{step:.4g}" for step in image.spacing)
    return f"{size} voxels of {spacing} mm"
