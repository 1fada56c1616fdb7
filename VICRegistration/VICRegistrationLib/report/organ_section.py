"""The section of one organ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..messages import sentences
from ..registration.boundary import boundary_deviations
from ..registration.nets import net_text
from .contents import Compared, ReportedOrgan
from .html import Html, element, items, joined, png_picture, table

_ENDS = {
    "displacement": "at rest: no control point moved any more",
    "parameters": "at rest: no parameter changed any more",
    "cost": "at rest: the cost settled",
    "no better point": "no further step lowered the cost",
    "iterations": "as many iterations as allowed",
}


def organ_section(organ: ReportedOrgan, anchor: str) -> Html:
    """Write everything about one organ.

    Parameters
    ----------
    organ : ReportedOrgan
    anchor : str
        For links to the section.

    Returns
    -------
    Html
    """
    parts = (_warnings(organ), _result(organ), _slices(organ), _sides(organ), _confidence(organ))
    parts += (_deviation(organ.compared, organ), _convergence(organ), _inputs(organ), _choices(organ))
    return element("section", element("h2", organ.name, id=anchor), *parts, class_="organ", aria_labelledby=anchor)


def volume_text(organ: ReportedOrgan) -> str:
    """Volume with its error bar.

    Parameters
    ----------
    organ : ReportedOrgan

    Returns
    -------
    str
    """
    volume = organ.fit.surface.volume() / 1000.0
    deviation = float(organ.confidence.volume_sd_ml)
    # As many digits as the error bar has a use for.
    digits = 1 if deviation >= 0.1 else 2
    return f"{volume:.{digits}f} ± {deviation:.{digits}f} ml"


def percent_text(share: float) -> str:
    """Share in per cent.

    Parameters
    ----------
    share : float
        From 0 to 1.

    Returns
    -------
    str
    """
    percent = 100.0 * share
    return f"{percent:.0f} %" if percent == 0.0 or percent >= 9.95 else f"{percent:.1f} %"


def points_text(points: Sequence[Sequence[float]]) -> Html:
    """Places, one on each line.

    Parameters
    ----------
    points : sequence of (r, a, s)
        RAS mm.

    Returns
    -------
    Html
    """
    lines = (element("div", "R {:.1f}, A {:.1f}, S {:.1f}".format(*point)) for point in points)
    return joined(*lines)


def _warnings(organ: ReportedOrgan) -> Html:
    if not organ.warnings:
        return Html()
    title = "Look at this first" if len(organ.warnings) == 1 else f"Look at these {len(organ.warnings)} points first"
    return element("div", element("h3", title), items(organ.warnings), class_="warnings")


def _result(organ: ReportedOrgan) -> Html:
    fit = organ.fit
    rows = [("Volume", f"{volume_text(organ)} (one standard deviation)")]
    rows += [] if fit.region is None else [("Separated region", f"{fit.region.volume_ml:.1f} ml")]
    rows += [
        ("Area", f"{fit.surface.area() / 100.0:.1f} cm²"),
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
    rows.insert(3, ("Follows no edge", f"on {percent_text(organ.confidence.unsupported_share)} of the area"))
    return joined(element("h3", "Result"), table((), rows))


def _slices(organ: ReportedOrgan) -> Html:
    alt = f"Axial, coronal and sagittal slice through {organ.name} with the contour of the fitted surface."
    lines = ["solid line: the fitted surface"]
    lines += ["dashed line: the reference"] if organ.compared is not None else []
    lines += ["dotted white line: the separated region"] if organ.fit.region is not None else []
    caption = f"Radiological convention, the patient's right is on the left; {', '.join(lines)}."
    picture = png_picture(organ.figures.slices, alt=alt, caption=caption)
    return _together("Slices in three planes", picture)


def _sides(organ: ReportedOrgan) -> Html:
    alt = f"The fitted surface of {organ.name} in 3D, from the left and front and from the right and back."
    caption = "From the patient's left and front, and from the right and back; L left, A anterior, S superior."
    return _together("The surface", png_picture(organ.figures.sides, alt=alt, caption=caption))


def _confidence(organ: ReportedOrgan) -> Html:
    if organ.figures.confidence is None:
        return Html()
    told = [(_percentile_word(percent), f"{value:.2f} mm") for percent, value in organ.percentiles]
    alt = f"{organ.name} from four sides, coloured by the standard deviation of the surface; the table has the numbers."
    picture = png_picture(
        organ.figures.confidence,
        alt=alt,
        caption="How sure the fitted surface is of its place: the standard deviation along its normal. Yellow places "
        "are the least sure; compare the contour with the image there.",
    )
    titles = ("", *(word for word, _ in told), "follows no edge")
    unsupported = f"{percent_text(organ.confidence.unsupported_share)} of the area"
    row = ("standard deviation", *(value for _, value in told), unsupported)
    return _together("Confidence", picture, table(titles, [row]))


def _percentile_word(percent: float) -> str:
    return {50.0: "median", 100.0: "largest"}.get(percent, f"{percent:g} % below")


def _deviation(compared: Compared | None, organ: ReportedOrgan) -> Html:
    if compared is None or organ.figures.deviation is None:
        return Html()
    found = compared.comparison
    alt = (
        f"{organ.name} from four sides, coloured by its distance from the reference; mean "
        f"{found.to_reference.mean:.2f} mm, largest {found.to_reference.maximum:.2f} mm."
    )
    caption = (
        "Red lies outside of the reference, blue inside. The last bars hold all that lies beyond the colours. Dice of "
        "both areas within a tolerance, Dice of both volumes, the largest distance, and the volumes are below."
    )
    picture = png_picture(organ.figures.deviation, alt=alt, caption=caption)
    against = element("p", "Reference: ", element("code", compared.against))
    heading = element("h3", "Deviation from the reference")
    return element("div", heading, against, picture, *_deviation_tables(compared), class_="together")


def _deviation_tables(compared: Compared) -> tuple[Html, Html]:
    found = compared.comparison
    ways = (("reference to surface", found.to_surface), ("surface to reference", found.to_reference))
    titles = ("mm", "mean", "standard deviation", "RMS", "median", "95 %", "largest", "mean with sign")
    keys = ("mean", "std", "rms", "median", "p95", "maximum")
    rows = [(way, *(f"{getattr(each, key):.2f}" for key in keys), f"{each.mean_signed:+.2f}") for way, each in ways]
    others = [f"Dice {tolerance:g} mm" for tolerance, _ in found.surface_dice]
    others += ["volume Dice", "Hausdorff", "reference", "fitted", "difference"]
    shares = [f"{share:.3f}" for _, share in (*found.surface_dice, ("", found.volume_dice))]
    volumes = (
        *(f"{volume:.1f} ml" for volume in (found.reference_ml, found.volume_ml)),
        f"{found.volume_difference_ml:+.1f} ml",
    )
    row = ("both ways", *shares, f"{found.hausdorff:.2f} mm", *volumes)
    return table(titles, rows), table(("", *others), [row])


def _convergence(organ: ReportedOrgan) -> Html:
    history = organ.fit.history
    rows = []
    for stage in dict.fromkeys(step.stage for step in history):
        steps = [step for step in history if step.stage == stage]
        end = _ENDS.get(steps[-1].stopped_by, steps[-1].stopped_by)
        rows.append((stage, len(steps), f"{steps[0].cost:.3g}", f"{steps[-1].cost:.3g}", end))
    alt = f"Cost against iteration for the {len(rows)} stages of the fit of {organ.name}; the table has the numbers."
    caption = "Cost of every iteration; those of different stages are not to be compared with one another."
    picture = png_picture(organ.figures.convergence, alt=alt, caption=caption)
    titles = ("stage", "iterations", "cost, first", "cost, last", "how it ended")
    return _together("Convergence", picture, table(titles, rows))


def _inputs(organ: ReportedOrgan) -> Html:
    fit, region = organ.fit, organ.fit.region
    options = fit.options

    def origin(option: str) -> str:
        return "as given" if option in organ.asked else "automatic"

    rows: list[tuple] = [("Seeds, RAS mm", points_text(organ.seeds), "as given")] if len(organ.seeds) else []
    if options.threshold is not None:
        low, high = options.threshold
        rows.append(("Grey levels of the organ", f"{low:.4g} to {high:.4g}", origin("threshold")))
    erosion = options.erosion if region is None or region.erosion is None else region.erosion
    if erosion is not None:
        rows.append(("Erosion", f"{erosion:.3g} mm", origin("erosion")))
    dilation = erosion if options.dilation is None else options.dilation
    if dilation is not None:
        rows.append(("Dilation", f"{dilation:.3g} mm", origin("dilation")))
    if options.tau is not None:
        rows.append(("Width of the edge (tau)", f"{options.tau:.3g} mm", origin("tau")))
    rows.append(("Solver", options.solver, origin("solver")))
    if len(fit.boundary_points):
        far = np.abs(boundary_deviations(fit.surface, fit.boundary_points)).max()
        told = joined(points_text(fit.boundary_points), element("div", f"met within {far:.2f} mm"))
        rows.append(("Points on the wall, RAS mm", told, "as given"))
    return _together("Inputs", table(("input", "value", "from"), rows))


def _choices(organ: ReportedOrgan) -> Html:
    if not organ.choices:
        return Html()
    rows = [(choice.option, choice.value, sentences(choice.reasons)) for choice in organ.choices]
    return _together("What was chosen and why", table(("option", "value", "reason"), rows))


def _together(title: str, *content: Html) -> Html:
    """Heading and content that stay on one page."""
    return element("div", element("h3", title), *content, class_="together")
