"""A model that is not the pelvis: an egg with a band and a cord."""

from __future__ import annotations

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.multipatch.cuts import OrganCuts
from VICRegistrationLib.multipatch.drawing import Drawing

ROWS, COLUMNS = ("low", "middle", "high"), ("first", "second", "third")


def egg():
    return closed_organ((9, 7), axes=[[0, 20, 0], [0, 0, 14], [31, 0, 0]], center=(5, -3, 8))


def egg_with_band():
    """One organ in nine patches, a sheet and a cord; the first cut lies across the seam."""
    names = [[f"egg {row} {column}" for row in ROWS] for column in COLUMNS]
    drawing = Drawing({"egg": egg()}, {"egg": OrganCuts([0.125, 0.5, 0.75], [0.0, 0.25, 0.75, 1.0], names)})
    drawing.sheet("band", drawing.border("egg middle first", "u_max"), [(-20, -50, 25), (30, -50, 25)], fixed="wall")
    drawing.cord("string", "egg middle second", (5, -45, -10), (0, -1, 0), taper=0.3, fixed="wall")
    return drawing.model(name="egg with a band", landmarks={"peg": (1.5, 2.25, 1 / 3)})
