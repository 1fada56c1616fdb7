"""What a report is about, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.comparison import Comparison
from ..geometry.triangulation import TriangleMesh
from ..registration.automatic import Choice
from ..registration.confidence import Confidence
from ..registration.organ import OrganFit

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Source:
    """Where the image is from.

    Parameters
    ----------
    path : str
        As the user gave it.
    series : str
        The DICOM series that was asked for; empty if none was.
    """

    path: str
    series: str = ""


@dataclass(frozen=True, eq=False)
class Compared:
    """An organ beside its reference.

    Parameters
    ----------
    against : str
        What the reference is, in words.
    comparison : Comparison
    mesh : TriangleMesh
        Of the fitted surface, RAS mm.
    distances : (n,) ndarray
        Of its vertices from the reference, mm, positive outside.
    """

    against: str
    comparison: Comparison
    mesh: TriangleMesh
    distances: np.ndarray


@dataclass(frozen=True, eq=False)
class OrganFigures:
    """Pictures of one organ, PNG files in memory.

    Parameters
    ----------
    slices, sides, convergence : bytes
    confidence, deviation : bytes, optional
    """

    slices: bytes
    sides: bytes
    convergence: bytes
    confidence: bytes | None = None
    deviation: bytes | None = None


@dataclass(frozen=True, eq=False)
class ReportedOrgan:
    """A fitted organ and what is told of it.

    Parameters
    ----------
    name : str
    fit : OrganFit
    figures : OrganFigures
    seeds : sequence of (r, a, s)
        RAS mm.
    asked : sequence of str
        Names of the options that the user gave; all others were chosen.
    seconds : float
        From the seeds to the surface.
    warnings : sequence of str
        What to look at before the surface is used, a sentence each.
    percentiles : sequence of (percent, mm)
        Standard deviations that shares of the area stay below.
    compared : Compared, optional
        If there is a reference.
    """

    name: str
    fit: OrganFit
    figures: OrganFigures
    seeds: Sequence[Point]
    asked: Sequence[str]
    seconds: float
    warnings: Sequence[str] = ()
    percentiles: Sequence[tuple[float, float]] = ()
    compared: Compared | None = None

    @property
    def choices(self) -> Sequence[Choice]:
        """What was chosen, and why."""
        return self.fit.choices

    @property
    def confidence(self) -> Confidence:
        """How sure the surface is of its place."""
        return self.fit.confidence
