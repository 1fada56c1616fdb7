"""Contents of pictures and of the page: fitted organs with their inputs, and their references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..analysis.comparison import Comparison, compare, distances_from
from ..analysis.mirrored import mirrored
from ..analysis.references import ReadReference
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh, resolution_for_chord_error, triangulate
from ..messages import Diagnostic
from ..registration.organ_fit import OrganFit

TOLERANCES = (0.5, 1.0, 2.0)
# Statistics of absolute distances, by their names in `Deviation`.
STATISTICS = ("mean", "std", "rms", "median", "p95", "maximum")
_CHORD_ERROR = 0.05
# Fine enough to look smooth, and to show where a deviation changes.
_LEAST_RESOLUTION = (128, 80)
# Below this volume Dice, surface and reference are probably of different organs.
_DOUBTFUL_DICE = 0.1


@dataclass(frozen=True)
class Source:
    """Where the image is from.

    Parameters
    ----------
    path : str
        As the user gave it.
    series : str, optional
        The DICOM series that was chosen.
    frame : int, optional
        Number of the volume that was chosen.
    warnings : sequence of str
        Warnings about the file, a sentence each.
    """

    path: str
    series: str | None = None
    frame: int | None = None
    warnings: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class ComparedOrgan:
    """A fitted organ, its reference, and how they compare.

    Parameters
    ----------
    name : str
    surface : BSplineSurface
        RAS mm.
    read : ReadReference
    path : Path
        File of the reference.
    comparison : Comparison
    """

    name: str
    surface: BSplineSurface
    read: ReadReference
    path: Path
    comparison: Comparison

    @property
    def against(self) -> str:
        """Name of the reference."""
        return f"{self.path.name}, label {self.read.label}" if self.read.label else self.path.name

    @property
    def distance_rows(self) -> list[list[str]]:
        """Rows of a table, one for each way: its name, the numbers of `STATISTICS` and the mean with its sign, mm."""
        found = self.comparison
        ways = {"reference to surface": found.to_surface, "surface to reference": found.to_reference}
        return [
            [way, *(f"{getattr(each, key):.2f}" for key in STATISTICS), f"{each.mean_signed:+.2f}"]
            for way, each in ways.items()
        ]

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """Warnings about the reference and the comparison."""
        found, values = list(self.read.diagnostics), {"reference": self.against, "dice": self.comparison.volume_dice}
        sides, dice = self.mirrored
        if sides:
            found.append(Diagnostic("reference_mirrored", {**values, "sides": sides, "mirrored_dice": dice}))
        elif self.comparison.volume_dice < _DOUBTFUL_DICE:
            found.append(Diagnostic("little_in_common", values))
        return found

    @property
    def warnings(self) -> list[str]:
        """The diagnostics as sentences, after those about the reference's file."""
        return [*self.read.notes, *(found.sentence() for found in self.diagnostics)]

    @cached_property
    def mirrored(self) -> tuple[str, float]:
        """Sides that are exchanged in a mirror image of the reference that fits better, and its volume Dice."""
        return mirrored(self.surface, self.read.reference, self.comparison.volume_dice, center=self.read.center)

    @cached_property
    def mesh(self) -> TriangleMesh:
        """Triangles of the surface."""
        return fine_mesh(self.surface)

    @cached_property
    def distances(self) -> np.ndarray:
        """Distances of the triangles' points from the reference, mm, positive outside, (n,)."""
        return distances_from(self.read.reference, self.mesh.points)


@dataclass(frozen=True, eq=False)
class ReportedOrgan:
    """A fitted organ with the data that are shown.

    Parameters
    ----------
    name : str
        Also decides the colour.
    fit : OrganFit
    verdict : {"good", "check", "poor"}
        How far the fit can be trusted.
    seeds : sequence of (r, a, s)
        RAS mm.
    seconds : float
        From the seeds to the surface.
    asked : sequence of str
        Names of the options that the user gave.
    warnings : sequence of str
        Warnings about the surface, a sentence each.
    compared : ComparedOrgan, optional
        The comparison, if there is a reference.
    """

    name: str
    fit: OrganFit
    verdict: str
    seeds: Sequence[Sequence[float]] = ()
    seconds: float = 0.0
    asked: Sequence[str] = ()
    warnings: Sequence[str] = ()
    compared: ComparedOrgan | None = None


@dataclass(frozen=True, eq=False)
class ReportedModel:
    """A generic model that organs were fitted with, as the page shows it.

    Parameters
    ----------
    name : str
    rows : sequence of (title, text)
        About the whole model.
    parts : sequence of rows
        A row for each part, of as many texts as there are titles.
    titles : sequence of str
    notes : sequence of str
        Warnings, a sentence each.
    figure : matplotlib.figure.Figure
        The model from four sides.
    """

    name: str
    rows: Sequence[tuple[str, str]]
    parts: Sequence[Sequence[str]]
    titles: Sequence[str]
    notes: Sequence[str]
    figure: object


def compared_organ(
    name: str,
    surface: BSplineSurface,
    read: ReadReference,
    path: Path,
    *,
    points: int = 10_000,
    tolerances: Sequence[float] = TOLERANCES,
) -> ComparedOrgan:
    """Compare one organ with its reference.

    Parameters
    ----------
    name : str
    surface : BSplineSurface
        RAS mm.
    read : ReadReference
    path : Path
        File of the reference.
    points : int
        Number of points of each surface.
    tolerances : sequence of float
        Of the surface Dice, mm.

    Returns
    -------
    ComparedOrgan

    Raises
    ------
    ValueError
        If they cannot be compared; the message names the organ and the file.
    """
    try:
        found = compare(surface, read.reference, n_points=points, tolerances=tolerances)
    except ValueError as error:
        msg = f"{name} cannot be compared with {path}: {error}"
        raise ValueError(msg) from error
    return ComparedOrgan(name, surface, read, path, found)


def fine_mesh(surface: BSplineSurface) -> TriangleMesh:
    """Triangles of a surface that are small enough to look smooth, and within 0.05 mm of it."""
    needed = resolution_for_chord_error(surface, _CHORD_ERROR)
    u, v = (max(pair) for pair in zip(needed, _LEAST_RESOLUTION))
    return triangulate(surface, resolution=(u, v))
