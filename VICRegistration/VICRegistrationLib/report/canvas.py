"""Figures of matplotlib without its global state: made, and written as PNG files."""

from __future__ import annotations

import io
import os
import warnings
from contextlib import contextmanager

import numpy as np

from ..files import replacing

_DPI = 130
TEXT_COLOUR = "#2b2f36"
# Of a palette; and how far apart red, green and blue of a grey may be.
_GREYS, _GREYISH = 80, 8


def require_matplotlib(*, otherwise: str = ", or leave the pictures out with --no-pictures") -> None:
    """Refuse to go on without matplotlib.

    Parameters
    ----------
    otherwise : str
        What the user can do instead of installing it; empty where there is nothing.

    Raises
    ------
    RuntimeError
        If it is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        msg = f"Pictures need matplotlib, which is not installed; run pip install matplotlib{otherwise}."
        raise RuntimeError(msg) from error


def blank_figure(size: tuple[float, float]):
    """Make an empty white figure.

    Parameters
    ----------
    size : (width, height)
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
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=size, dpi=_DPI, facecolor="white")


def bare(axes) -> None:
    """Leave the frame away above and to the right.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    """
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


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
    content = png_bytes(figure)
    with replacing(path) as draft:
        draft.write_bytes(content)


def png_bytes(figure) -> bytes:
    """Draw a figure as a PNG file in memory.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    bytes
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    content = io.BytesIO()
    with _quiet():
        figure.savefig(content, format="png")
    return content.getvalue()


@contextmanager
def _quiet():
    """Say nothing of letters that the font does not have: they are drawn as boxes, a title is not worth more words."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def drawn_pixels(figure) -> np.ndarray:
    """Draw a figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    (height, width, 3) ndarray of uint8
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    with _quiet():
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def read_pixels(path: str | os.PathLike) -> np.ndarray:
    """Read a picture, (height, width, 3) ndarray of uint8."""
    # matplotlib needs Pillow, so that it is there.
    from PIL import Image

    with Image.open(path) as file:
        return np.asarray(file.convert("RGB"))


def indexed_png(pixels: np.ndarray) -> bytes:
    """Make a small PNG file of a palette of 256 colours, which slices and lit surfaces do not need more of.

    Parameters
    ----------
    pixels : (height, width, 3) ndarray of uint8

    Returns
    -------
    bytes
    """
    from PIL import Image

    pixels = pixels.astype(np.int16)
    # An even scale for greys: a slice has so many of them that thin contours would be left without their colours.
    coloured = np.ptp(pixels, axis=2) > _GREYISH
    numbers = np.rint(pixels.mean(axis=2) * (_GREYS - 1) / 255.0).astype(np.uint8)
    colours = np.repeat(np.rint(np.linspace(0.0, 255.0, _GREYS)).astype(int), 3).tolist()
    if coloured.any():
        # Rare colours stay what they are: they are the ends of a scale, which people look for.
        reduced = Image.fromarray(pixels[coloured][None].astype(np.uint8)).quantize(
            256 - _GREYS, method=Image.Quantize.MAXCOVERAGE
        )
        numbers[coloured] = _GREYS + np.asarray(reduced)[0]
        colours += reduced.getpalette()[: 3 * (256 - _GREYS)]
    indexed = Image.fromarray(numbers)
    indexed.putpalette(colours)
    smaller = io.BytesIO()
    indexed.save(smaller, format="png", optimize=True)
    return smaller.getvalue()


def literal(text: str) -> str:
    """Text in which a dollar sign is a dollar sign and not the begin of a formula."""
    return text.replace("$", r"\$")
