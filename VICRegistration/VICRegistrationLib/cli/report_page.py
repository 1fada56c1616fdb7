"""report.html: the page that people read, from what a run fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from .. import __version__
from ..analysis.gaps import gaps
from ..files import replacing
from ..imaging.image import Image
from ..registration.diagnostics import fit_diagnostics
from ..registration.options import FitOptions
from ..report.canvas import indexed_png, read_pixels
from ..report.contents import Compared, ReportedOrgan, Source
from ..report.figures import confidence_percentiles, organ_figures
from ..report.page import report_html
from .comparison_files import ComparedOrgan, compared_organ
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
}


def compared_organs(
    organs: Sequence[FittedOrgan], references: Mapping[str, OrganReference]
) -> dict[str, ComparedOrgan]:
    """Compare fitted organs with their references.

    Parameters
    ----------
    organs : sequence of FittedOrgan
    references : mapping of str to OrganReference
        By the organs' names; those of organs without one are left out.

    Returns
    -------
    dict of str to ComparedOrgan

    Raises
    ------
    ValueError
        If an organ cannot be compared with its reference.
    """
    known = [organ for organ in organs if organ.name in references]
    return {organ.name: compared_organ(organ.name, organ.fit.surface, references[organ.name]) for organ in known}


def write_page(
    folder: Path,
    organs: Sequence[FittedOrgan],
    image: Image,
    source: Source,
    *,
    compared: Mapping[str, ComparedOrgan],
    files: Mapping[str, Sequence[str]],
    common: Sequence[str],
) -> None:
    """Write report.html.

    Parameters
    ----------
    folder : Path
        Holds overview.png if there are several organs.
    organs : sequence of FittedOrgan
    image : Image
    source : Source
    compared : mapping of str to ComparedOrgan
        From `compared_organs`.
    files : mapping of str to sequence of str
        Names of the files of each organ.
    common : sequence of str
        Names of the files that are about all organs.

    Raises
    ------
    OSError
        If the file cannot be written.
    RuntimeError
        If matplotlib is not installed.
    """
    several = len(organs) > 1
    page = report_html(
        [_reported(organ, image, compared.get(organ.name)) for organ in organs],
        image,
        source,
        program=f"vic-registration {__version__}",
        date=datetime.now().astimezone(),
        overview=indexed_png(read_pixels(folder / OVERVIEW)) if several else None,
        gaps=_gaps(organs) if several else (),
        files=_files(files, common),
    )
    with replacing(folder / PAGE) as draft:
        draft.write_text(page, encoding="utf-8")


def _reported(organ: FittedOrgan, image: Image, found: ComparedOrgan | None) -> ReportedOrgan:
    fit = organ.fit
    compared = reference = None
    if found is not None:
        compared = Compared(found.against, found.comparison, found.mesh, found.distances)
        reference = found.read.reference
    about_reference = (
        [] if found is None else [f"Comparison with the reference: {warning}." for warning in found.warnings]
    )
    return ReportedOrgan(
        name=organ.name,
        fit=fit,
        figures=organ_figures(image, fit, organ.name, reference=reference, compared=compared),
        seeds=organ.seeds,
        asked=_asked(organ.asked),
        seconds=organ.seconds,
        warnings=[*(found.sentence() for found in fit_diagnostics(image, fit)), *about_reference],
        percentiles=confidence_percentiles(fit),
        compared=compared,
    )


def _files(files: Mapping[str, Sequence[str]], common: Sequence[str]) -> list[tuple[list[str], str]]:
    """Files beside the page with what they are for, those of one kind together."""
    kinds = [
        ([name + ending for name, own in files.items() if name + ending in own], use)
        for ending, use in _PURPOSES.items()
    ]
    others = [([name], use) for name, use in _COMMON_PURPOSES.items() if name in (REPORT, *common)]
    return [(kind, use) for kind, use in [*kinds, *others] if kind]


def _asked(options: FitOptions | None) -> list[str]:
    """Names of the options that differ from what is taken without a word."""
    if options is None:
        return []
    usual = FitOptions()
    return [key for key, value in vars(options).items() if value != getattr(usual, key)]


def _gaps(organs: Sequence[FittedOrgan]) -> list[str]:
    """How valid organs lie to each other, a sentence each."""
    return [str(gap) for gap in gaps({organ.name: organ.fit.surface for organ in organs if not organ.fit.problems})]
