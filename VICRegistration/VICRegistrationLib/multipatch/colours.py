"""Colours of a model's parts and patches: organs have theirs everywhere, the others one for each kind of structure."""

from __future__ import annotations

import colorsys

import numpy as np

from ..organ_colours import organ_colours, rgb
from .model import MultiPatchModel

CORD_COLOUR, SHEET_COLOURS = "#2fb5c9", {"ligament": "#3f8fd2", "fascia": "#8f9ad8"}
_OTHER_SHEET = "#b06a4f"
# Shades of a part's patches: difference in hue, as a share of the colour wheel, and factor on the lightness.
_SHADES = ((0.0, 1.0), (0.01, 0.72), (-0.02, 0.86), (0.02, 1.14), (-0.03, 0.6))


def part_colours(model: MultiPatchModel) -> dict[str, str]:
    """Colours "#rrggbb" of the parts by their names."""
    found = organ_colours(list(model.organs))
    for part in model.parts:
        if part.kind == "cord":
            found[part.name] = CORD_COLOUR
        elif part.kind == "sheet":
            words = part.name.lower().split()
            found[part.name] = next((SHEET_COLOURS[word] for word in words if word in SHEET_COLOURS), _OTHER_SHEET)
    return found


def patch_colours(model: MultiPatchModel) -> dict[str, tuple[float, float, float]]:
    """Colours (r, g, b), from 0 to 1, of the patches by their names: shades of their part's, others for neighbours."""
    parts, found = part_colours(model), {}
    for part in model.parts:
        hue, lightness, saturation = colorsys.rgb_to_hls(*rgb(parts[part.name]))
        shade: dict[str, int] = {}
        patches = model.patches_of(part.name)
        for patch in patches:
            # Patches with a common border get different shades; those with only a common corner may not.
            beside = {
                shade[other.name]
                for other in patches
                if other.name in shade and len(np.intersect1d(other.indices, patch.indices)) > 1
            }
            shade[patch.name] = next((number for number in range(len(_SHADES)) if number not in beside), 0)
            turn, share = _SHADES[shade[patch.name]]
            found[patch.name] = colorsys.hls_to_rgb((hue + turn) % 1.0, min(lightness * share, 0.95), saturation)
    return found
