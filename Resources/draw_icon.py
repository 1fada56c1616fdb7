"""Draw the icon of the extension: a smooth closed surface over an MRI-like slice. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.image import imsave

SIZE = 128
OVERSAMPLING = 6  # Averaging blocks of pixels is all the anti-aliasing there is.
SURFACE_COLOR = np.array([0.93, 0.53, 0.32])
LINE_COLOR = np.array([1.0, 0.93, 0.75])
RIM_COLOR = np.array([0.45, 0.6, 0.75])
ROOT = Path(__file__).resolve().parent.parent


def draw() -> np.ndarray:
    """Return the icon as (128, 128, 4) values from 0 to 1."""
    axis = (np.arange(SIZE * OVERSAMPLING) + 0.5) / (SIZE * OVERSAMPLING) * 2 - 1
    x, y = np.meshgrid(axis, -axis)
    color = np.repeat(slice_of_body(x, y)[..., None], 3, axis=2)
    surface, depth = shaded_surface(x, y)
    color = np.where((depth > 0)[..., None], surface, color)
    corner = np.hypot(np.maximum(np.abs(x) - 0.76, 0), np.maximum(np.abs(y) - 0.76, 0))
    # A bright rim, or the slice's black corners are lost on a dark ground.
    color = np.where(((corner > 0.17) & (depth == 0))[..., None], RIM_COLOR, color)
    picture = np.dstack([color, corner < 0.22])
    blocks = picture.reshape(SIZE, OVERSAMPLING, SIZE, OVERSAMPLING, 4)
    alpha = blocks[..., 3:].mean(axis=(1, 3))
    # Colour is averaged over the opaque pixels only, or the rim would darken.
    color = (blocks[..., :3] * blocks[..., 3:]).mean(axis=(1, 3)) / np.maximum(alpha, 1e-9)
    return np.clip(np.concatenate([color, alpha], axis=2), 0, 1)


def slice_of_body(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey levels of a cross-section: fat, muscle, two hip bones and the sacrum."""
    body = np.hypot(x / 0.9, y / 0.74)
    grey = 0.06 + 0.62 * (body < 1) - 0.38 * (body < 0.84)
    for bone_x, bone_y, radius in ((-0.58, 0.06, 0.16), (0.58, 0.06, 0.16), (0, -0.42, 0.14)):
        grey = np.where(np.hypot(x - bone_x, (y - bone_y) / 1.2) < radius, 0.5, grey)
    return grey + 0.02 * np.sin(9 * x + 4 * y) * np.cos(7 * y - 3 * x)


def shaded_surface(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth of a closed surface with parameter lines; the depth is 0 outside."""
    angle = np.arctan2(y - 0.06, x)
    outline = 0.6 * (1 + 0.1 * np.cos(3 * angle + 0.6) - 0.06 * np.cos(2 * angle))
    # On the unit sphere (right, up, towards the eye); its pole is tilted towards the eye.
    right, up = x / outline, (y - 0.06) / outline
    depth = np.sqrt(np.maximum(1 - right**2 - up**2, 0))
    latitude = np.arcsin(np.clip(0.8 * up + 0.6 * depth, -1, 1))
    around = np.arctan2(right, 0.8 * depth - 0.6 * up)
    light = 0.45 + 0.65 * np.clip(-0.45 * right + 0.5 * up + 0.74 * depth, 0, 1)
    lines = (np.abs(np.sin(4 * around)) * np.cos(latitude) < 0.1) | (np.abs(np.cos(4 * latitude)) < 0.1)
    color = np.where(lines[..., None], LINE_COLOR, SURFACE_COLOR) * light[..., None]
    return np.where(depth[..., None] < 0.2, LINE_COLOR, color), depth


for folder in ("Resources", "VICRegistration/Resources/Icons"):
    imsave(ROOT / folder / "VICRegistration.png", draw())
