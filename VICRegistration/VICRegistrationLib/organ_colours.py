"""Colours of organs, for Slicer, pictures, STEP files and reports."""

from __future__ import annotations

from collections.abc import Sequence

# Bright, so that contours stand out on grey levels.
ORGAN_COLOURS = {"bladder": "#f5b82e", "vagina": "#ea6a9d", "rectum": "#4fb477", "uterus": "#9a7be0"}
OTHER_COLOURS = ("#3f9be0", "#e8743b", "#35b8b1", "#b58a5b")


def organ_colours(names: Sequence[str]) -> dict[str, str]:
    """Return the colour of each organ: that of its name, or the next one of a few others.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    dict of str to str
        Colours as "#rrggbb".
    """
    unknown = [name for name in names if name.lower() not in ORGAN_COLOURS]
    others = {name: OTHER_COLOURS[number % len(OTHER_COLOURS)] for number, name in enumerate(unknown)}
    return {name: others.get(name) or ORGAN_COLOURS[name.lower()] for name in names}


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue of "#rrggbb", from 0 to 1."""
    red, green, blue = (int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5))
    return red, green, blue
