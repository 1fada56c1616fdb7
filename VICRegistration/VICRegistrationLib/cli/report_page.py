"""report.html and the pictures beside it, from what a run fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from ..analysis.gaps import gaps
from ..files import write_text
from ..report.contents import ReportedOrgan, Source, compared_organ
from ..report.figure import save_figure
from ..report.page import report_html
from ..report.pictures import organ_figure, overview_figure
from .console import LOG
from .model_results import MODEL, MODEL_PICTURE, MODEL_STEP, MODEL_VTP
from .organ_entries import FittedOrgan, Run
from .outputs import ORGAN_FILES, PROGRAM_VERSION
from .references import OrganReference
from .stored_results import ASSEMBLY, OVERVIEW, PAGE, REPORT

_COMMON_FILES = {
    REPORT: "the figures of this report, for programs",
    OVERVIEW: "picture of all organs",
    ASSEMBLY: "assembly of the exact solids (LPS mm)",
    MODEL: "the generic model, carried to the patient (RAS mm)",
    MODEL_STEP: "the generic model as exact faces with the names of its patches (LPS mm)",
    MODEL_VTP: "the generic model as triangles with the names of patches and parts (LPS mm)",
    MODEL_PICTURE: "the generic model from four sides",
}


def write_pictures(
    run: Run,
    organs: Sequence[FittedOrgan],
    references: Mapping[str, OrganReference],
    folder: Path,
    *,
    files: Mapping[str, Sequence[str]],
    common: Sequence[str],
) -> None:
    """Write a picture of each organ of a run, one of all organs if there are several, and report.html.

    Parameters
    ----------
    run : Run
    organs : sequence of FittedOrgan
        All organs of the page.
    references : mapping of str to OrganReference
        By the organs' names, for those that have one.
    folder : Path
    files : mapping of str to sequence of str
        Names of the files of each organ.
    common : sequence of str
        Names of the files that have all organs.

    Raises
    ------
    ValueError
        If an organ cannot be compared with its reference.
    OSError
        If a file cannot be written.
    RuntimeError
        If matplotlib or Jinja2 is not installed.
    """
    reported = [_reported(organ, references.get(organ.name)) for organ in organs]
    for organ in reported:
        if organ.name not in run.names:
            continue
        for warning in organ.compared.warnings if organ.compared is not None else ():
            LOG.warning(f"{organ.name}: warning: {warning}")
        save_figure(organ_figure(run.image, organ), folder / f"{organ.name}.png")
    several = len(organs) > 1
    if several:
        save_figure(overview_figure(run.image, reported), folder / OVERVIEW)
    valid = {organ.name: organ.fit.surface for organ in organs if not organ.fit.problems}
    keys = ("image", "image_series", "image_frame", "image_warnings")
    page = report_html(
        reported,
        run.image,
        Source(*(run.record[key] for key in keys)),
        program=PROGRAM_VERSION,
        date=datetime.now().astimezone(),
        gaps=[str(gap) for gap in gaps(valid)] if several else (),
        files=_files(files, common),
        model=None if run.model is None else run.model.reported(),
    )
    write_text(folder / PAGE, page)


def _reported(organ: FittedOrgan, reference: OrganReference | None) -> ReportedOrgan:
    warnings = [found.sentence() for found in organ.diagnostics]
    compared = None
    if reference is not None:
        compared = compared_organ(organ.name, organ.fit.surface, reference.read, reference.path)
        warnings += [f"Comparison with the reference: {warning}" for warning in compared.warnings]
    how = {"seeds": organ.request.seeds, "seconds": organ.seconds, "asked": list(organ.given)}
    return ReportedOrgan(organ.name, organ.fit, organ.verdict.word, warnings=warnings, compared=compared, **how)


def _files(files: Mapping[str, Sequence[str]], common: Sequence[str]) -> list[tuple[str, str]]:
    """Files beside the page with their descriptions, those of one kind together."""
    kinds = [
        ([name + ending for name, own in files.items() if name + ending in own], use)
        for ending, use in ORGAN_FILES.items()
    ]
    kinds += [([name], use) for name, use in _COMMON_FILES.items() if name in (REPORT, *common)]
    return [(", ".join(kind), use) for kind, use in kinds if kind]
