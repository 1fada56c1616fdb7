"""Pictures of fitted organs: slices with contours, a 3D view and the convergence. Needs matplotlib."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from ..analysis.distances import Reference, deviation
from ..imaging.image import Image
from ..organ_colours import organ_colours
from ..registration.nets import net_text
from ..registration.organ import OrganFit
from .canvas import TEXT_COLOUR, blank_figure, literal, save_figure
from .panels import Shown, draw_convergence, draw_scene, draw_slices, fine_mesh

REFERENCE_COLOUR = "#49d6ff"
_ALARM_COLOUR = "#c4161c"
# Seen from the patient's left, from the front and from above: organs of the pelvis do not hide one another.
VIEWERS = ((-0.80, 0.52, 0.30), (0.30, 0.90, 0.30))
_ROW = (0.475, 0.40)


def organ_picture(
    path: str | os.PathLike,
    image: Image,
    fit: OrganFit,
    name: str,
    *,
    reference: Reference | None = None,
    n_warnings: int = 0,
) -> None:
    """Draw three slices with the contour, a 3D view and the convergence of one organ.

    Parameters
    ----------
    path : path
        PNG file to write.
    image : Image
        The grey levels that were fitted.
    fit : OrganFit
    name : str
        Name of the organ.
    reference : BSplineSurface, TriangleMesh or ReferenceMesh, optional
        Its contour is drawn too, and the deviation from it told.
    n_warnings : int
        How many warnings the report holds about the organ; told in the header.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    colour = organ_colours([name])[name]
    surfaces, contours = shown_organ(fit, colour, reference)
    figure = _figure(name, _summary(fit, reference), alarm=alarm(fit, n_warnings=n_warnings))
    # A surface that was fitted again may have no region.
    region = None if fit.region is None else fit.region.image
    draw_slices(figure, _ROW, image, surfaces, contours, region=region)
    draw_scene(figure.add_axes((0.02, 0.01, 0.33, 0.445)), surfaces, VIEWERS[0])
    draw_convergence(figure.add_axes((0.42, 0.095, 0.55, 0.315)), fit)
    save_figure(figure, path)


def overview_picture(
    path: str | os.PathLike,
    image: Image,
    fits: Mapping[str, OrganFit],
    *,
    references: Mapping[str, Reference] | None = None,
) -> None:
    """Draw all organs in three slices and in 3D.

    Parameters
    ----------
    path : path
        PNG file to write.
    image : Image
        The grey levels that were fitted.
    fits : mapping of str to OrganFit
        By the organs' names.
    references : mapping of str to BSplineSurface, TriangleMesh or ReferenceMesh, optional
        By the organs' names; their contours are drawn too.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    ValueError
        If there are no organs.
    """
    if not fits:
        msg = "No organ was given; an overview needs at least one."
        raise ValueError(msg)
    colours = organ_colours(list(fits))
    surfaces = [Shown(fine_mesh(fit.surface), colours[name], name) for name, fit in fits.items()]
    contours = list(surfaces)
    for number, reference in enumerate((references or {}).values()):
        contours.append(Shown(fine_mesh(reference), REFERENCE_COLOUR, "" if number else "reference", dashed=True))
    volumes = ", ".join(f"{name} {fit.surface.volume() / 1000.0:.1f} ml" for name, fit in fits.items())
    figure = _figure("Fitted organs", [volumes])
    draw_slices(figure, _ROW, image, surfaces, contours)
    for number, viewer in enumerate(VIEWERS):
        draw_scene(figure.add_axes((0.02 + 0.49 * number, 0.01, 0.47, 0.445)), surfaces, viewer)
    save_figure(figure, path)


def shown_organ(fit: OrganFit, colour: str, reference: Reference | None) -> tuple[list[Shown], list[Shown]]:
    """Surface of an organ, and the contours that slices of it show.

    Parameters
    ----------
    fit : OrganFit
    colour : str
        As "#rrggbb".
    reference : BSplineSurface, TriangleMesh or ReferenceMesh, optional

    Returns
    -------
    surfaces, contours : list of Shown
    """
    surfaces = [Shown(fine_mesh(fit.surface), colour, "fitted surface")]
    if reference is None:
        return surfaces, surfaces
    return surfaces, [*surfaces, Shown(fine_mesh(reference), REFERENCE_COLOUR, "reference", dashed=True)]


def _figure(title: str, lines: Sequence[str], *, alarm: str = ""):
    figure = blank_figure((13.0, 9.6))
    figure.text(0.02, 0.972, literal(title), size=19, weight="bold", color=TEXT_COLOUR, va="top")
    figure.text(0.02, 0.937, literal("\n".join(lines)), size=10.5, color=TEXT_COLOUR, va="top", linespacing=1.45)
    figure.text(0.98, 0.968, alarm, size=13, weight="bold", color=_ALARM_COLOUR, va="top", ha="right")
    return figure


def alarm(fit: OrganFit, *, n_warnings: int = 0) -> str:
    """Tell in a few words what to look at before trusting a surface.

    Parameters
    ----------
    fit : OrganFit
    n_warnings : int
        How many warnings the report holds.

    Returns
    -------
    str
        Empty if nothing is known to be wrong.
    """
    parts = [] if fit.converged else ["not converged"]
    parts += [f"invalid surface ({problem.kind})" for problem in fit.problems[:1]]
    parts += ["reaches the border of the image"] if fit.region is not None and fit.region.touches_border else []
    parts += [f"{n_warnings} warning{'s' if n_warnings > 1 else ''} in the report"] if n_warnings else []
    return "   ·   ".join(parts)


def _summary(fit: OrganFit, reference: Reference | None) -> list[str]:
    """Tell the result in one line or two."""
    separated = "" if fit.region is None else f" (separated {fit.region.volume_ml:.1f} ml)"
    parts = [
        f"volume {fit.surface.volume() / 1000.0:.1f} ml{separated}",
        f"area {fit.surface.area() / 100.0:.1f} cm²",
        f"net {net_text(fit.options.net)} {fit.options.closure}",
        f"{fit.iterations} iterations" + (", converged" if fit.converged else ""),
        f"fitted in {fit.seconds:.2f} s",
    ]
    lines = ["   ·   ".join(parts)]
    if reference is not None:
        found = deviation(fit.surface, reference)
        lines.append(
            f"deviation from the reference: mean {found.mean:.2f} mm, signed {found.mean_signed:+.2f} mm, "
            f"95 % below {found.p95:.2f} mm, largest {found.maximum:.2f} mm"
        )
    return lines
