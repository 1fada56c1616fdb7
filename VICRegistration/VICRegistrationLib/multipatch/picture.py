"""A picture of a model from four sides: patches by colour, translucent if the image does not show them."""

from __future__ import annotations

import os

from ..geometry.triangulation import triangulate
from ..organ_colours import rgb
from ..report.figure import TEXT_COLOUR, axes_at, blank_figure, literal, save_figure, write_heading
from ..report.scene import SIDES, Shape, draw_scene
from .colours import part_colours, patch_colours
from .model import MultiPatchModel

# Opacity of estimated parts: organs stay visible through three sheets.
_OPACITY = 0.5
_CHORD_ERROR = 0.05
_VIEW, _TOP = 5.4, 1.0


def draw_model(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Draw a model as a PNG file.

    Parameters
    ----------
    model : MultiPatchModel
    path : path
        File to write; its folder must exist.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    save_figure(model_figure(model), path)


def model_figure(model: MultiPatchModel):
    """Draw a model.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure(2.0 * _VIEW + 3.6, 2.0 * _VIEW + _TOP)
    words = f"{len(model.parts)} parts, {len(model.patches)} patches, {len(model.points)} control points"
    translucent = "Translucent: estimated, the image does not show it."
    write_heading(figure, model.name or "model", [words, translucent])
    shapes = model_shapes(model)
    for number, viewpoint in enumerate(SIDES):
        row, column = divmod(number, 2)
        axes = axes_at(figure, column * _VIEW + 0.05, (1 - row) * _VIEW + 0.05, _VIEW - 0.1, _VIEW - 0.3)
        draw_scene(axes, shapes, viewpoint)
    _draw_names(figure, model)
    return figure


def model_shapes(model: MultiPatchModel) -> list[Shape]:
    """Make a shape of each patch, in its colour; patches of sheets have two visible sides.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    list of Shape
    """
    colours, shapes = patch_colours(model), []
    for patch in model.patches:
        part = model.part(patch.part)
        mesh = triangulate(patch.surface(model.points), chord_error=_CHORD_ERROR)
        look = {"opacity": _OPACITY if part.estimated else 1.0, "two_sided": part.kind == "sheet"}
        shapes.append(Shape(mesh.points, mesh.triangles, colours[patch.name], mesh.normals, **look))
    return shapes


def _draw_names(figure, model: MultiPatchModel) -> None:
    """List the parts in their colours."""
    from matplotlib.patches import Patch

    colours = part_colours(model)
    handles = {
        literal(part.labelled()): Patch(color=rgb(colours[part.name]), alpha=_OPACITY if part.estimated else 1.0)
        for part in model.parts
    }
    figure.legend(
        list(handles.values()), list(handles), loc="center right", fontsize=10, frameon=False, labelcolor=TEXT_COLOUR
    )
