"""The report as one page of HTML."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from ..imaging.image import Image, patient_side
from .contents import ReportedOrgan, Source
from .html import Html, element, items, png_picture, table
from .organ_section import organ_section, percent_text, volume_text
from .style import CSS

# The page needs nothing from anywhere; browsers hold it to that.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_NOT_CLINICAL = "Not a medical device; not for clinical use."
_PLANES = ("sagittal", "coronal", "axial")
# Below it, degrees, nobody would call a stack turned.
_STRAIGHT = 0.5


def report_html(
    organs: Sequence[ReportedOrgan],
    image: Image,
    source: Source,
    *,
    program: str,
    date: datetime,
    overview: bytes | None = None,
    gaps: Sequence[str] = (),
    files: Sequence[tuple[Sequence[str], str]] = (),
) -> str:
    """Write the report of a fit: one file that needs no other, for screens and for paper.

    Parameters
    ----------
    organs : sequence of ReportedOrgan
        One or more.
    image : Image
        The grey levels that were fitted.
    source : Source
    program : str
        Name and version.
    date : datetime
        With its time zone.
    overview : bytes, optional
        Picture of all organs, a PNG file.
    gaps : sequence of str
        How the organs lie to each other, a sentence each.
    files : sequence of (names, purpose)
        Files beside the report.

    Returns
    -------
    str
        HTML 5. Names and paths are escaped; there is no script and no address in it.
    """
    names = ", ".join(organ.name for organ in organs)
    several = len(organs) > 1
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="generator", content=program),
        element("title", f"{names} - report of {program}"),
        element("style", Html(CSS)),
    )
    body = element(
        "body",
        _header(names, program, date),
        element(
            "main",
            _overview(organs, overview, gaps) if several else Html(),
            _image(image, source),
            *(organ_section(organ, _anchor(number)) for number, organ in enumerate(organs, start=1)),
            _files(files),
        ),
        element("footer", f"Written by {program}. Lengths in mm, places in RAS. {_NOT_CLINICAL}"),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _anchor(number: int) -> str:
    return f"organ-{number}"


def _header(names: str, program: str, date: datetime) -> Html:
    moment = element("time", date.isoformat(sep=" ", timespec="seconds"), datetime=date.isoformat(timespec="seconds"))
    return element(
        "header",
        element("h1", f"Fitted surfaces: {names}"),
        element("p", f"{program} · ", moment, class_="about"),
        element("p", _NOT_CLINICAL, class_="use"),
    )


def _overview(organs: Sequence[ReportedOrgan], overview: bytes | None, gaps: Sequence[str]) -> Html:
    """All organs beside each other, with links to their sections."""
    titles = ["organ", "volume", "area", "converged", "valid solid", "warnings", "follows no edge"]
    rows = [_overview_row(organ, _anchor(number)) for number, organ in enumerate(organs, start=1)]
    parts = [element("h2", "All organs"), table(titles, rows)]
    if overview is not None:
        alt = "Axial, coronal and sagittal slice with the contours of all organs, and their surfaces from two sides."
        parts.append(png_picture(overview, alt=alt, caption="Contours and surfaces of all organs."))
    if gaps:
        parts.append(element("div", element("h3", "Between the organs"), items(gaps), class_="together"))
    return element("section", *parts, class_="overview")


def _overview_row(organ: ReportedOrgan, anchor: str) -> tuple:
    fit, count = organ.fit, len(organ.warnings)
    return (
        element("a", organ.name, href=f"#{anchor}"),
        volume_text(organ),
        f"{fit.surface.area() / 100.0:.1f} cm²",
        "yes" if fit.converged else "no",
        "no" if fit.problems else "yes",
        element("strong", f"{count}, see there") if count else "none",
        percent_text(organ.confidence.unsupported_share),
    )


def _image(image: Image, source: Source) -> Html:
    rows: list[tuple] = [("File", element("code", source.path))]
    rows += [("DICOM series", element("code", source.series))] if source.series else []
    rows += [
        ("Size", " x ".join(str(count) for count in image.size) + " voxels"),
        ("Spacing", " x ".join(f"{step:.4g}" for step in image.spacing) + " mm"),
        ("Field of view", " x ".join(f"{length:.4g}" for length in image.size * image.spacing) + " mm"),
        ("Orientation", orientation_text(image)),
    ]
    return element("section", element("h2", "Image"), table((), rows), class_="together")


def orientation_text(image: Image) -> str:
    """How the volume's axes lie in the patient.

    Parameters
    ----------
    image : Image

    Returns
    -------
    str
        Such as "sagittal slices; i runs to posterior, j to inferior, k to right".
    """
    directions = image.ijk_to_ras[:3, :3] / image.spacing
    worlds = np.abs(directions).argmax(axis=0)
    runs = ", ".join(
        f"{axis} {'runs ' if axis == 'i' else ''}to {patient_side(directions[:, column])}"
        for column, axis in enumerate("ijk")
    )
    along = int(np.argmax(image.spacing - 1e-6 * image.spacing.max() * np.array([2, 1, 0])))
    cosines = np.abs(directions[worlds, range(3)])
    turned = float(np.degrees(np.arccos(np.clip(cosines.min(), 0.0, 1.0))))
    oblique = f"; turned by up to {turned:.1f}° from the patient's axes" if turned > _STRAIGHT else ""
    return f"{_PLANES[worlds[along]]} slices; {runs}{oblique}"


def _files(files: Sequence[tuple[Sequence[str], str]]) -> Html:
    if not files:
        return Html()
    rows = [(element("code", ", ".join(names)), purpose) for names, purpose in files]
    return element("section", element("h2", "Files beside this report"), table(("files", "what they are for"), rows))
