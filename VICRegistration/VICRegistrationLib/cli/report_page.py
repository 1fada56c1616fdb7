"""report.html and the pictures beside it, from what a run fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from .. import __version__
from ..analysis.gaps import gaps
from ..files import write_text
from ..imaging.image import Image
from ..report.contents import ReportedModel, ReportedOrgan, Source, compared_organ
from ..report.figure import save_figure
from ..report.page import report_html
from ..report.pictures import organ_figure, overview_figure
from .model_results import MODEL, MODEL_PICTURE, MODEL_STEP, MODEL_VTP
from .organ_entries import FittedOrgan
from .references import OrganReference
from .stored_results import ASSEMBLY, OVERVIEW, PAGE, REPORT

_PURPOSES = {
    ".vtp": "triangles for Slicer and other programs (LPS mm), with the control net",
    ".stl": "triangles (LPS mm)",
    ".json": "the B-spline surface itself (RAS mm)",
    "_convergence.csv": "cost and largest displacement of every iteration",
    ".png": "slices, surface and convergence in one picture",
    ".step": "the exact solid for CAD and simulation (LPS mm)",
}
_COMMON_PURPOSES = {
    REPORT: "the numbers of this report, for programs",
    OVERVIEW: "picture of all organs",
    ASSEMBLY: "assembly of the exact solids (LPS mm)",
    MODEL: "the generic model, carried to the patient (RAS mm)",
    MODEL_STEP: "the same as exact faces with the names of its patches (LPS mm)",
    MODEL_VTP: "the same as triangles with the names of patches and parts (LPS mm)",
    MODEL_PICTURE: "picture of the same from four sides",
}


def reported_organs(organs: Sequence[FittedOrgan], references: Mapping[str, OrganReference]) -> list[ReportedOrgan]:
    """Compare fitted organs with their references, and find what looks wrong about them.

    Parameters
    ----------
    organs : sequence of FittedOrgan
    references : mapping of str to OrganReference
        By the organs' names; others have none.

    Returns
    -------
    list of ReportedOrgan

    Raises
    ------
    ValueError
        If an organ cannot be compared with its reference.
    """
    return [_reported(organ, references.get(organ.name)) for organ in organs]


def _reported(organ: FittedOrgan, reference: OrganReference | None) -> ReportedOrgan:
    warnings = [found.sentence() for found in organ.diagnostics]
    compared = None
    if reference is not None:
        compared = compared_organ(organ.name, organ.fit.surface, reference.read, reference.path)
        warnings += [f"Comparison with the reference: {warning}" for warning in compared.warnings]
    how = {"seeds": organ.request.seeds, "seconds": organ.seconds, "asked": list(organ.given)}
    return ReportedOrgan(organ.name, organ.fit, warnings=warnings, compared=compared, verdict=organ.verdict.word, **how)


def write_pictures(
    folder: Path,
    organs: Sequence[ReportedOrgan],
    image: Image,
    source: Source,
    *,
    names: Sequence[str],
    files: Mapping[str, Sequence[str]],
    common: Sequence[str],
    model: ReportedModel | None = None,
) -> None:
    """Write a picture of some organs, one of all of several, and report.html.

    Parameters
    ----------
    folder : Path
    organs : sequence of ReportedOrgan
        All that the page is about.
    image : Image
        The grey levels that were fitted.
    source : Source
    names : sequence of str
        Of the organs that get a picture of their own.
    files : mapping of str to sequence of str
        Names of the files of each organ.
    common : sequence of str
        Names of the files that are about all organs.
    model : ReportedModel, optional
        The generic model that they were fitted with.

    Raises
    ------
    OSError
        If a file cannot be written.
    RuntimeError
        If matplotlib or Jinja2 is not installed.
    """
    for organ in organs:
        if organ.name in names:
            save_figure(organ_figure(image, organ), folder / f"{organ.name}.png")
    several = len(organs) > 1
    if several:
        save_figure(overview_figure(image, organs), folder / OVERVIEW)
    valid = {organ.name: organ.fit.surface for organ in organs if not organ.fit.problems}
    page = report_html(
        organs,
        image,
        source,
        program=f"vic-registration {__version__}",
        date=datetime.now().astimezone(),
        gaps=[str(gap) for gap in gaps(valid)] if several else (),
        files=_files(files, common),
        model=model,
    )
    write_text(folder / PAGE, page)


def _files(files: Mapping[str, Sequence[str]], common: Sequence[str]) -> list[tuple[str, str]]:
    """Files beside the page with what they are for, those of one kind together."""
    kinds = [
        ([name + ending for name, own in files.items() if name + ending in own], use)
        for ending, use in _PURPOSES.items()
    ]
    kinds += [([name], use) for name, use in _COMMON_PURPOSES.items() if name in (REPORT, *common)]
    return [(", ".join(kind), use) for kind, use in kinds if kind]
