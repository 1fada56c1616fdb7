"""The verdict on a fit, in one word, from its diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..messages import Diagnostic
from .organ_fit import OrganFit

GOOD, CHECK, POOR = VERDICTS = ("good", "check", "poor")

# Shares of the area from which on the verdict is "check" and "poor". Area without an edge: of 74 fits to real bladders
# from good and bad starts, those below 0.26 were within 1.6 mm of the experts, those from 0.36 to 0.61 were off by 1.4
# to 3.9 mm, those beyond by 3.5 mm and more.
_WITHOUT_EDGE = (0.28, 0.65)
# Area at the border of the image: seven real bladders that end inside of their images have 0 to 0.05 if the fit is
# good; with a seventh of their slices cut off they have 0.16 and more, and the bladder of a PROSTATEx image has 0.12.
_AT_BORDER = (0.08, np.inf)
_SHARES = {"no_edge_in_places": _WITHOUT_EDGE, "no_edge_at_side": _WITHOUT_EDGE, "reaches_border": _AT_BORDER}
_CHECKED = (
    *("starts_differ", "surfaces_differ", "region_larger_than_seen", "no_further_step", "still_moving"),
    *("part_left_out", "held_closer", "surface_kept", "segmentation_in_pieces", "ends_at_level", "points_without_edge"),
    "points_left",
)
_POOR = ("invalid_surface", "no_clear_edge", "volume_differs")


@dataclass(frozen=True)
class Verdict:
    """How reliable a fit is.

    Parameters
    ----------
    word : {"good", "check", "poor"}
        Good: expected within 1.5 mm of the organ. Check: look at the contour. Poor: do not use it.
    reasons : tuple of Diagnostic
        Why it is not good; empty if it is.
    """

    word: str
    reasons: tuple[Diagnostic, ...]


def verdict_of(fit: OrganFit, diagnostics: Sequence[Diagnostic]) -> Verdict:
    """Judge a fit.

    Parameters
    ----------
    fit : OrganFit
    diagnostics : sequence of Diagnostic
        From :func:`.diagnostics.fit_diagnostics`.

    Returns
    -------
    Verdict
    """
    found = {POOR: [], CHECK: []}
    for diagnostic in (*diagnostics, *(reason for choice in fit.choices for reason in choice.reasons)):
        word = _severity(diagnostic)
        if word != GOOD:
            found[word].append(diagnostic)
    word = POOR if found[POOR] else CHECK if found[CHECK] else GOOD
    return Verdict(word, (*found[POOR], *found[CHECK]))


def _severity(diagnostic: Diagnostic) -> str:
    """Verdict by one diagnostic alone."""
    if diagnostic.code in _SHARES:
        share, (check, poor) = diagnostic.values["share"], _SHARES[diagnostic.code]
        return POOR if share >= poor else CHECK if share >= check else GOOD
    if diagnostic.code in _POOR or diagnostic.values.get("kept") == "closed surface of the region":
        return POOR
    return CHECK if diagnostic.code in _CHECKED else GOOD
