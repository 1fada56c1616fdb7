"""What tests look at in pictures."""

from __future__ import annotations

import io

import numpy as np


def pixels_of(figure) -> np.ndarray:
    """Pixels of a figure, (rows, columns, 3) from 0 to 1."""
    from matplotlib.image import imread

    content = io.BytesIO()
    figure.savefig(content, format="png")
    content.seek(0)
    return imread(content)[..., :3]


def pixels_in(figure, axes) -> np.ndarray:
    """Pixels of a figure that are in axes, (rows, columns, 3) from 0 to 1."""
    pixels = pixels_of(figure)
    left, bottom, right, top = axes.get_position().extents * np.tile(pixels.shape[1::-1], 2)
    return pixels[len(pixels) - round(top) : len(pixels) - round(bottom), round(left) : round(right)]
