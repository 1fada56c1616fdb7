"""The report as one page of HTML, from the template page.html."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from ..imaging.image import Image, patient_side
from ..messages import sentences
from ..registration.boundary_points import boundary_deviations
from ..registration.confidence import Confidence
from ..registration.nets import net_text
from ..registration.organ_fit import OrganFit
from .contents import ComparedOrgan, ReportedModel, ReportedOrgan, Source
from .figure import jpeg_bytes, require_packages
from .pictures import overview_figure, page_figures, stack_figure
from .views import STRAIGHT

_NOT_CLINICAL = "Not a medical device; not for clinical use."
_PLANES = ("sagittal", "coronal", "axial")
# Characters that HTML does not allow, and lone surrogates, which names of files may contain and UTF-8 may not.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")
_ENDS = {
    "displacement": "converged: no control point moved any more",
    "parameters": "converged: no parameter changed any more",
    "cost": "converged: the cost settled",
    "no better point": "no further step lowered the cost",
    "iterations": "the iteration limit was reached",
}
_VERDICTS = {
    "good": "expected to lie within 1.5 mm of the organ, as far as the fit and the image can tell",
    "check": "look at the contour before you use the surface",
    "poor": "not to be used",
}


def report_html(
    organs: Sequence[ReportedOrgan],
    image: Image,
    source: Source,
    *,
    program: str,
    date: datetime,
    gaps: Sequence[str] = (),
    files: Sequence[tuple[str, str]] = (),
    model: ReportedModel | None = None,
) -> str:
    """Write the report of a fit: one self-contained file, for screens and for paper.

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
    gaps : sequence of str
        Gaps and overlaps between the organs, a sentence each.
    files : sequence of (names, content)
        Files beside the report.
    model : ReportedModel, optional
        The generic model that the organs were fitted with.

    Returns
    -------
    str
        HTML 5. Names and paths are escaped; the page has no script and loads nothing.

    Raises
    ------
    RuntimeError
        If matplotlib or Jinja2 is not installed.
    """
    require_packages("matplotlib", "jinja2", otherwise="")
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent)
    how = {"autoescape": True, "undefined": StrictUndefined, "finalize": _printable}
    template = Environment(loader=loader, trim_blocks=True, lstrip_blocks=True, **how).get_template("page.html")
    return template.render(
        organs=[_organ(organ, image) for organ in organs],
        overview=_base64(overview_figure(image, organs, heading=False)) if len(organs) > 1 else "",
        image_rows=_image_rows(image),
        source=source,
        program=program,
        date=date,
        gaps=gaps,
        files=files,
        model=model,
        model_picture=_base64(model.figure) if model is not None else "",
        not_clinical=_NOT_CLINICAL,
    )


def _printable(value: object) -> object:
    """Replace characters that a page must not contain; markup is left as it is."""
    return _UNPRINTABLE.sub("\ufffd", value) if type(value) is str else value


def _base64(figure) -> str:
    return base64.b64encode(jpeg_bytes(figure)).decode("ascii")


def _organ(organ: ReportedOrgan, image: Image) -> dict:
    """Texts and table rows of one organ for the template."""
    fit, compared = organ.fit, organ.compared
    count = len(organ.warnings)
    return {
        "name": organ.name,
        "warnings": organ.warnings,
        "verdict": organ.verdict,
        "verdict_words": _VERDICTS[organ.verdict],
        "overview": (
            organ.verdict,
            volume_text(organ.fit.surface.volume() / 1000.0, fit.confidence),
            f"{fit.surface.area() / 100.0:.1f} cm²",
            "yes" if fit.converged else "no",
            "no" if fit.problems else "yes",
            f"{count}, see below" if count else "none",
            percent_text(fit.confidence.unsupported_share),
        ),
        "result": _result(organ),
        "has_region": fit.region is not None,
        "pictures": {name: _base64(figure) for name, figure in page_figures(image, organ).items()},
        "confidence": _confidence(fit.confidence),
        "compared": "" if compared is None else compared.against,
        "distances": () if compared is None else compared.distance_rows,
        "dice": () if compared is None else _dice(compared),
        "inputs": _inputs(organ),
        "choices": [(choice.option, str(choice.value), sentences(choice.reasons)) for choice in fit.choices],
        "stages": _stages(organ),
        "stacks": _stacks(fit),
        "stack_pictures": [(use.name, _base64(stack_figure(organ, use))) for use in fit.stacks if use.used],
    }


def volume_text(volume: float, confidence: Confidence) -> str:
    """Volume in ml, with its standard deviation if that is calibrated.

    Parameters
    ----------
    volume : float
        ml.
    confidence : Confidence

    Returns
    -------
    str
        Without a standard deviation if more than 4 % of the area follow no edge.
    """
    if not confidence.volume_calibrated:
        return f"{volume:.1f} ml"
    deviation = float(confidence.volume_sd_ml)
    # One or two digits, by the size of the standard deviation.
    digits = 1 if deviation >= 0.1 else 2
    return f"{volume:.{digits}f} ± {deviation:.{digits}f} ml"


def percent_text(share: float) -> str:
    """Share, from 0 to 1, in per cent."""
    percent = 100.0 * share
    if 0.0 < percent < 0.05:
        return "under 0.1 %"
    return f"{percent:.0f} %" if percent == 0.0 or percent >= 9.95 else f"{percent:.1f} %"


def _result(organ: ReportedOrgan) -> list[tuple[str, str]]:
    fit, confidence = organ.fit, organ.fit.confidence
    volume = volume_text(fit.surface.volume() / 1000.0, confidence)
    about = (
        "one standard deviation, calibrated on phantoms"
        if confidence.volume_calibrated
        else "without a standard deviation, because much of the surface follows no edge"
    )
    rows = [("Volume", f"{volume} ({about})")]
    rows += [] if fit.region is None else [("Separated region", f"{fit.region.volume_ml:.1f} ml")]
    return [
        *rows,
        ("Area", f"{fit.surface.area() / 100.0:.1f} cm²"),
        ("Follows no edge", f"on {percent_text(confidence.unsupported_share)} of the area"),
        ("Valid solid", "yes" if not fit.problems else f"no: {fit.problems[0].diagnostic.sentence()}"),
        ("Converged", f"{'yes' if fit.converged else 'no'}, after {fit.iterations} iterations"),
        (
            "Cost",
            f"{fit.cost_final:.3g}; {fit.cost_initial:.3g} for the generic model as placed (mean squared difference "
            "between virtual and real image, in units of the contrast)",
        ),
        ("Time", f"{organ.seconds:.2f} s from the seeds to the surface, {fit.seconds:.2f} s from the region"),
        ("Control net", f"{net_text(fit.options.net)}, {fit.options.closure} closure"),
    ]


def _confidence(confidence: Confidence) -> list[str]:
    """Row of a table: standard deviations that 50, 90, 95 and 100 % of the area stay below."""
    values, areas = confidence.deviations.ravel(), confidence.areas.ravel()
    order = np.argsort(values)
    shares = np.cumsum(areas[order]) / areas.sum()
    below = values[order][np.searchsorted(shares, (0.5, 0.9, 0.95, 1.0 - 1e-9))]
    numbers = [f"{value:.2f} mm" for value in below]
    return ["standard deviation", *numbers, f"{percent_text(confidence.unsupported_share)} of the area"]


def _dice(compared: ComparedOrgan) -> list[list[str]]:
    """Titles and the row of figures that hold for both ways."""
    found = compared.comparison
    dice = [(f"Dice {tolerance:g} mm", f"{share:.3f}") for tolerance, share in found.surface_dice]
    columns = [
        ("", "both ways"),
        *dice,
        ("volume Dice", f"{found.volume_dice:.3f}"),
        ("Hausdorff", f"{found.hausdorff:.2f} mm"),
        ("reference", f"{found.reference_ml:.1f} ml"),
        ("fitted", f"{found.volume_ml:.1f} ml"),
        ("difference", f"{found.volume_difference_ml:+.1f} ml"),
    ]
    return [list(row) for row in zip(*columns)]


def _stacks(fit: OrganFit) -> list[tuple[str, ...]]:
    """Rows about further stacks: file, motion, share of the area, cost, and whether it was used."""
    rows = []
    for use in fit.stacks:
        shift = ", ".join(f"{value:+.1f}" for value in use.translation_mm)
        cost = f"{use.cost:.3g}" if np.isfinite(use.cost) else "none"
        turn, seen = f"{use.rotation_degrees:.1f}°", percent_text(use.seen)
        if np.isfinite(use.translation_sd_mm):
            shift, turn = f"{shift} ± {use.translation_sd_mm:.1g}", f"{turn} ± {use.rotation_sd_degrees:.1g}°"
        rows.append((use.name, shift, turn, seen, cost, "yes" if use.reason is None else use.reason.sentence()))
    return rows


def _inputs(organ: ReportedOrgan) -> list[tuple]:
    fit, region = organ.fit, organ.fit.region
    options = fit.options

    def origin(option: str) -> str:
        return "as given" if option in organ.asked else "automatic"

    rows: list[tuple] = [("Seeds, RAS mm", _places(organ.seeds), "as given")] if len(organ.seeds) else []
    if options.threshold is not None:
        low, high = options.threshold
        rows.append(("Grey levels of the organ", f"{low:.5g} to {high:.5g}", origin("threshold")))
    erosion = options.erosion if region is None or region.erosion is None else region.erosion
    dilation = erosion if options.dilation is None else options.dilation
    lengths = (("Erosion", "erosion", erosion), ("Dilation", "dilation", dilation))
    lengths += (("Width of the edge (tau)", "tau", options.tau),)
    rows += [(title, f"{value:.3g} mm", origin(name)) for title, name, value in lengths if value is not None]
    rows.append(("Solver", options.solver, "as given" if "solver" in organ.asked else "default"))
    if len(fit.boundary_points):
        far = np.abs(boundary_deviations(fit.surface, fit.boundary_points)).max()
        places = [*_places(fit.boundary_points), f"met within {far:.2f} mm"]
        rows.append(("Boundary points, RAS mm", places, "as given"))
    return rows


def _places(points: Sequence[Sequence[float]]) -> list[str]:
    return ["R {:.1f}, A {:.1f}, S {:.1f}".format(*point) for point in points]


def _stages(organ: ReportedOrgan) -> list[tuple[str, ...]]:
    history, rows = organ.fit.history, []
    for stage in dict.fromkeys(step.stage for step in history):
        steps = [step for step in history if step.stage == stage]
        end = _ENDS.get(steps[-1].stopped_by, steps[-1].stopped_by)
        rows.append((stage, str(len(steps)), f"{steps[0].cost:.3g}", f"{steps[-1].cost:.3g}", end))
    return rows


def _image_rows(image: Image) -> list[tuple[str, str]]:
    return [
        ("Size", " x ".join(str(count) for count in image.size) + " voxels"),
        ("Spacing", " x ".join(f"{step:.4g}" for step in image.spacing) + " mm"),
        ("Field of view", " x ".join(f"{length:.4g}" for length in image.size * image.spacing) + " mm"),
        ("Orientation", orientation_text(image)),
    ]


def orientation_text(image: Image) -> str:
    """Directions of the volume's axes in the patient.

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
    oblique = f"; turned by up to {turned:.1f}° from the patient's axes" if turned > STRAIGHT else ""
    return f"{_PLANES[worlds[along]]} slices; {runs}{oblique}"
