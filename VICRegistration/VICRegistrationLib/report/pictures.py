"""Whole pictures: an organ, all organs, a surface coloured by scalars, a mesh, the convergence. Need matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..meshing.elements import TetrahedralMesh, faces_of, flat_triangles
from ..meshing.quality import quality
from ..organ_colours import organ_colours, rgb
from ..registration.nets import net_text
from ..registration.organ_fit import OrganFit
from ..registration.stacks import StackUse
from .contents import ComparedOrgan, ReportedOrgan, fine_mesh
from .figure import axes_at, blank_figure, finish_axes, write_heading
from .scene import CONFIDENCE, DEVIATION, FRONT, OPPOSITE, USUAL, Shape, draw_scalars, draw_scene
from .slices import Contour, Marks, draw_slices
from .views import views_in_own_plane

# Unlike the colours of the usual organs, and visible on bright and on dark grey levels.
REFERENCE_COLOUR = "#3d6cff"
# A filled seed must look different from a hollow one on a bright lumen, too.
_SEED_STYLE, _BOUNDARY_STYLE = ("seed", "#19e3ff", "o"), ("boundary point", "#ff4df0", "D")
# Prefix of the stages of a second fit, after boundary points have contradicted the first one.
_AGAIN = "through the points, "
# Height for the names of all stages, in points of 1/72 inch.
_NAMES_HEIGHT = 215.0
# Characters of 8.5 points that fit into the width beside the plot.
_NAME_LETTERS = 36
# One for each stage that a fit can have: of three nets, of a coarser net that is kept, of boundary points.
_STAGE_COLOURS = (
    *("#8a93a3", "#4d7fb8", "#2a9d8f", "#d1495b", "#7d5ba6"),
    *("#e09f3e", "#7f5539", "#1d3557", "#7a8b2e", "#c77dba", "#3a3f47", "#e56b6f"),
)


def organ_figure(image: Image, organ: ReportedOrgan):
    """Draw one organ for a file: slices in three planes, the surface, and the convergence.

    Parameters
    ----------
    image : Image
        The grey levels that were fitted.
    organ : ReportedOrgan

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure(13.0, 9.5)
    write_heading(figure, organ.name, _summary(organ), alarm=alarm(organ))
    shapes = _draw_organs(figure, 8.35, image, [organ])
    draw_scene(axes_at(figure, 0.1, 0.05, 4.6, 3.5), shapes, USUAL)
    draw_convergence(axes_at(figure, 5.6, 0.65, 4.6, 2.65), organ.fit)
    return figure


def overview_figure(image: Image, organs: Sequence[ReportedOrgan], *, heading: bool = True):
    """Draw several organs: slices in three planes, and the surfaces from two sides.

    Parameters
    ----------
    image : Image
        The grey levels that were fitted.
    organs : sequence of ReportedOrgan
        One or more.
    heading : bool
        Whether there is a title with the volumes; the page has its own.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure(13.0, 9.5 if heading else 8.6)
    if heading:
        volumes = ", ".join(f"{organ.name} {organ.fit.surface.volume() / 1000.0:.1f} ml" for organ in organs)
        write_heading(figure, "Fitted organs", [volumes])
    _draw_pair(figure, 8.35 if heading else 8.5, image, organs, (USUAL, FRONT))
    return figure


def page_figures(image: Image, organ: ReportedOrgan) -> dict:
    """Draw one organ for the page.

    Parameters
    ----------
    image : Image
        The grey levels that were fitted.
    organ : ReportedOrgan

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        "organ", "confidence", "deviation" where there is a reference, and "convergence".
    """
    names = ["organ", "confidence", *([] if organ.compared is None else ["deviation"])]
    figures = {name: blank_figure(11.0, 7.6 if name == "organ" else 5.3) for name in names}
    _draw_pair(figures["organ"], 7.55, image, [organ], (USUAL, OPPOSITE))
    mesh, confidence = fine_mesh(organ.fit.surface), organ.fit.confidence
    draw_scalars(figures["confidence"], mesh, confidence.standard_deviation(mesh.parameters), CONFIDENCE)
    if organ.compared is not None:
        _draw_deviation(figures["deviation"], organ.compared)
    figures["convergence"] = blank_figure(11.0, 3.4)
    draw_convergence(axes_at(figures["convergence"], 0.9, 0.6, 7.0, 2.4), organ.fit)
    return figures


def stack_figure(organ: ReportedOrgan, stack: StackUse):
    """Draw the contour in a further stack, in the plane of its slices, at its position in that stack.

    Parameters
    ----------
    organ : ReportedOrgan
    stack : StackUse

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = blank_figure(11.0, 4.1)
    mesh = fine_mesh(organ.fit.surface.transformed(stack.motion))
    contour = Contour(mesh, organ_colours([organ.name])[organ.name], "fitted surface")
    draw_slices(figure, 4.05, stack.image, [contour], views=views_in_own_plane(stack.image, mesh))
    return figure


def deviation_figure(compared: ComparedOrgan):
    """Draw a comparison for a file: the surface coloured by its deviation (figure 18 of the paper), and the figures.

    Parameters
    ----------
    compared : ComparedOrgan

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    found = compared.comparison
    dice = ", ".join(f"{share:.3f} at {tolerance:g} mm" for tolerance, share in found.surface_dice)
    lines = [
        f"compared with {compared.against}: volume {found.volume_ml:.1f} ml, reference {found.reference_ml:.1f} ml",
        f"reference to surface: {found.to_surface.sentence()}",
        f"surface to reference: {found.to_reference.sentence()}",
        f"volume Dice {found.volume_dice:.3f}; surface Dice {dice}",
    ]
    figure = blank_figure(13.0, 7.1)
    write_heading(figure, compared.name, lines)
    _draw_deviation(figure, compared)
    return figure


def mesh_figure(mesh: TetrahedralMesh, name: str):
    """Draw a mesh for a file: its surfaces, and the half of it behind a cut through its middle.

    Parameters
    ----------
    mesh : TetrahedralMesh
    name : str
        Title.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    found = quality(mesh)
    line = (
        f"{len(mesh.tetrahedra)} {('linear', 'second-order')[mesh.order - 1]} tetrahedra   \u00b7   "
        f"{len(mesh.points)} nodes   \u00b7   {found.inverted} inverted   \u00b7   "
        f"scaled Jacobian: min {found.scaled_jacobian_min:.2f}, mean {found.scaled_jacobian_mean:.2f}   \u00b7   "
        f"volume {100.0 * (found.volume_ratio - 1.0):+.2f} % against the exact solids"
    )
    figure = blank_figure(12.0, 7.0)
    write_heading(figure, name, [line])
    colours = _colours_of_groups(mesh)
    middles = mesh.points[mesh.tetrahedra[:, :4]].mean(axis=1)
    # The patient's right half.
    half = np.flatnonzero(middles[:, 0] >= np.median(middles[:, 0]))
    for left, chosen in ((0.1, np.arange(len(mesh.tetrahedra))), (6.1, half)):
        faces, first, second = faces_of(mesh.tetrahedra[chosen])
        outside = second < 0
        triangles = flat_triangles(faces[outside])
        each = np.repeat(colours[chosen[first[outside]]], len(triangles) // max(int(outside.sum()), 1), axis=0)
        draw_scene(axes_at(figure, left, 0.1, 5.8, 5.9), [Shape(mesh.points, triangles, each)], USUAL)
    return figure


def _colours_of_groups(mesh: TetrahedralMesh) -> np.ndarray:
    """Colour of every tetrahedron: that of its organ, (m, 3)."""
    organs = {group: group[: -len("_wall")] if group.endswith("_wall") else group for group in mesh.tetrahedron_groups}
    of_organ = organ_colours(list(organs.values()))
    colours = np.zeros((len(mesh.tetrahedra), 3))
    for group, rows in mesh.tetrahedron_groups.items():
        colours[rows] = rgb(of_organ[organs[group]])
    return colours


def _draw_deviation(figure, compared: ComparedOrgan) -> None:
    draw_scalars(figure, compared.mesh, compared.distances, DEVIATION, other=compared.comparison.signed_to_surface)


def _draw_pair(figure, top: float, image: Image, organs: Sequence[ReportedOrgan], viewpoints) -> None:
    """Slices, and the surfaces from two sides below them."""
    shapes = _draw_organs(figure, top, image, organs)
    width = figure.get_size_inches()[0] / 2.0
    height = top - (2.0 * width - 0.4) / 3.0 - 0.5
    for number, viewpoint in enumerate(viewpoints):
        draw_scene(axes_at(figure, number * width, 0.05, width, height), shapes, viewpoint)


def _draw_organs(figure, top: float, image: Image, organs: Sequence[ReportedOrgan]) -> list[Shape]:
    """Slices with the contours of organs, their references and points; returns the surfaces to draw in 3D."""
    colours = organ_colours([organ.name for organ in organs])
    contours, shapes = [], []
    for organ in organs:
        mesh, colour = fine_mesh(organ.fit.surface), colours[organ.name]
        contours.append(Contour(mesh, colour, "fitted surface" if len(organs) == 1 else organ.name))
        shapes.append(Shape(mesh.points, mesh.triangles, np.array(rgb(colour)), mesh.normals))
    references = [organ.compared.read.reference for organ in organs if organ.compared is not None]
    for number, reference in enumerate(references):
        mesh = fine_mesh(reference) if isinstance(reference, BSplineSurface) else reference
        contours.append(Contour(mesh, REFERENCE_COLOUR, "" if number else "reference", thin=True))
    marks = [
        Marks([point for points in kind for point in points], *style)
        for kind, style in (
            ([organ.seeds for organ in organs], _SEED_STYLE),
            ([organ.fit.boundary_points for organ in organs], _BOUNDARY_STYLE),
        )
    ]
    # A surface that was fitted again may have no region.
    region = organs[0].fit.region if len(organs) == 1 else None
    draw_slices(figure, top, image, contours, marks=marks, region=None if region is None else region.image)
    return shapes


def draw_convergence(axes, fit: OrganFit) -> None:
    """Plot the cost against the iteration, with the names of the stages beside the plot.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        With room for the names, 2.6 inches, on its right.
    fit : OrganFit
    """
    stages = list(dict.fromkeys(step.stage for step in fit.history))
    first, names = 1, []
    for number, stage in enumerate(stages):
        costs = np.array([step.cost for step in fit.history if step.stage == stage])
        iterations = np.arange(first, first + len(costs))
        first += len(costs)
        style = {"color": _STAGE_COLOURS[number % len(_STAGE_COLOURS)], "linewidth": 1.8, "marker": "o"}
        (curve,) = axes.semilogy(iterations, costs, markersize=3.2, **style)
        names.append((curve, f"{stage} ({len(costs)})"))
        if number:
            axes.axvline(iterations[0] - 0.5, color="#c9ced6", linewidth=0.9, zorder=0)
    axes.margins(x=0.02)
    axes.xaxis.get_major_locator().set_params(integer=True)
    title = "Convergence (the costs of two stages cannot be compared)"
    finish_axes(axes, x="iteration", y="cost (mean squared residual / contrast²)", title=title)
    _draw_stages(axes, names)


def _draw_stages(axes, names: list) -> None:
    """Write the names of the stages beside the plot, in a smaller font if there are many."""
    from matplotlib.lines import Line2D

    entries, title = [], _AGAIN.strip(" ,") + ":"
    for curve, name in names:
        _, again, rest = name.partition(_AGAIN)
        if again and all(text != title for _, text in entries):
            entries.append((Line2D([], [], alpha=0.0), title))
        entries.append((curve, textwrap.fill(rest or name, _NAME_LETTERS)))
    lines = sum(1 + text.count("\n") for _, text in entries)
    size = min(8.5, _NAMES_HEIGHT / (1.45 * (lines + 1)))
    style = {"title": "stage (iterations)", "fontsize": size, "title_fontsize": size, "labelspacing": 0.35}
    place = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.02), "borderaxespad": 0.0, "frameon": False}
    axes.legend(*zip(*entries), **style, **place)


def alarm(organ: ReportedOrgan) -> str:
    """Most important warnings about a surface in a few words; empty if there are none."""
    fit, count = organ.fit, len(organ.warnings)
    parts = [] if organ.verdict == "good" else [f"verdict: {organ.verdict}"]
    parts += [] if fit.converged else ["not converged"]
    parts += [f"invalid surface ({problem.kind})" for problem in fit.problems[:1]]
    whole = fit.whole_region or fit.region
    parts += ["reaches the border of the image"] if whole is not None and whole.touches_border else []
    parts += [f"{count} warning{'s' if count > 1 else ''} in the report"] if count else []
    return "   \u00b7   ".join(parts)


def _summary(organ: ReportedOrgan) -> list[str]:
    """Describe the result in one or two lines."""
    fit = organ.fit
    separated = "" if fit.region is None else f" (separated {fit.region.volume_ml:.1f} ml)"
    parts = [
        f"volume {fit.surface.volume() / 1000.0:.1f} ml{separated}",
        f"area {fit.surface.area() / 100.0:.1f} cm²",
        f"net {net_text(fit.options.net)} {fit.options.closure}",
        f"{fit.iterations} iterations" + (", converged" if fit.converged else ""),
        f"fitted in {fit.seconds:.2f} s",
    ]
    lines = ["   \u00b7   ".join(parts)]
    if organ.compared is not None:
        lines.append(f"deviation from the reference: {organ.compared.comparison.to_surface.sentence()}")
    return lines
