"""Figures of matplotlib without its global state, written as PNG files or as JPEG files in memory."""

from __future__ import annotations

import importlib
import io
import os
import warnings
from collections.abc import Sequence

from ..files import replacing

TEXT_COLOUR, ALARM_COLOUR = "#2b2f36", "#c4161c"
# Pixels per inch; matplotlib's own setting savefig.dpi overrides it.
_DPI = 130


def require_packages(
    *packages: str, otherwise: str = ", or leave the pictures and the page out with --no-pictures"
) -> None:
    """Raise an error if packages that draw pictures or make the page are missing.

    Parameters
    ----------
    *packages : str
        Such as "matplotlib" and "jinja2".
    otherwise : str
        What the user can do instead of installing them; may be empty.

    Raises
    ------
    RuntimeError
        If one is not installed.
    """
    for package in packages:
        try:
            importlib.import_module(package)
        except ImportError as error:
            msg = f"Pictures and the page need {package}, which is not installed; run pip install {package}{otherwise}."
            raise RuntimeError(msg) from error


def blank_figure(width: float, height: float):
    """Make an empty white figure.

    Parameters
    ----------
    width, height : float
        Inches.

    Returns
    -------
    matplotlib.figure.Figure
        Without pyplot: no window system and no global state, also inside another program.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    require_packages("matplotlib", otherwise="")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=_DPI, facecolor="white")


def axes_at(figure, left: float, bottom: float, width: float, height: float):
    """Add axes at a place given in inches from the lower left corner of the figure."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def write_heading(figure, title: str, lines: Sequence[str], *, alarm: str = "") -> None:
    """Write a title, some lines below it, and a warning on the right."""
    _, up = figure.get_size_inches()
    figure.text(0.02, 1.0 - 0.27 / up, literal(title), size=19, weight="bold", color=TEXT_COLOUR, va="top")
    below = {"size": 10.5, "color": TEXT_COLOUR, "va": "top", "linespacing": 1.45}
    figure.text(0.02, 1.0 - 0.61 / up, literal("\n".join(lines)), **below)
    figure.text(0.98, 1.0 - 0.31 / up, alarm, size=13, weight="bold", color=ALARM_COLOUR, va="top", ha="right")


def finish_axes(axes, *, x: str, y: str, title: str = "") -> None:
    """Label the axes of a plot, and remove its frame at the top and on the right."""
    axes.set_xlabel(x, color=TEXT_COLOUR)
    axes.set_ylabel(y, color=TEXT_COLOUR)
    axes.set_title(title, size=10.5, loc="left", color=TEXT_COLOUR)
    axes.grid(axis="y", color="#e7eaee", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def scale_length(half_width: float) -> int:
    """Length of a scale bar of at most a third of the width, mm."""
    return max((length for length in (5, 10, 20, 50, 100) if length <= 0.66 * half_width), default=5)


def literal(text: str) -> str:
    """Escape dollar signs, which matplotlib takes for formulas."""
    return text.replace("$", r"\$")


def save_figure(figure, path: str | os.PathLike) -> None:
    """Write a figure as a PNG file, completely or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    content = _drawn(figure, format="png")
    with replacing(path) as draft:
        draft.write_bytes(content)


def jpeg_bytes(figure) -> bytes:
    """Draw a figure as a JPEG file in memory: a fifth of the size of a PNG file, without colour subsampling.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    bytes
    """
    return _drawn(figure, format="jpg", pil_kwargs={"quality": 85, "subsampling": 0})


def _drawn(figure, **how) -> bytes:
    content = io.BytesIO()
    with warnings.catch_warnings():
        # matplotlib warns of characters that the font lacks, and draws boxes.
        warnings.simplefilter("ignore", UserWarning)
        figure.savefig(content, **how)
    return content.getvalue()
