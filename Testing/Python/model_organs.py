"""Organs of a generic model: the demo's, without what presses on them there."""

from __future__ import annotations

from dataclasses import replace

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.phantoms.organs import ORGANS, organ_surface


def plain_organs() -> dict[str, BSplineSurface]:
    """Bladder, vagina and rectum, RAS mm."""
    return {name: organ_surface(replace(tube, presses=())) for name, tube in ORGANS.items()}
