"""Fits from one click in real MRI: seven bladders that experts have drawn, from many places in each."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from bladders import HARD, NAMES, Bladder, bladders, drawn_surface, other_seeds
from measuring import table
from surfaces import contour_in_world, smoothed_contour

from VICRegistrationLib.analysis.comparison import distances_from
from VICRegistrationLib.analysis.distances import Reference, points_on
from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, closed_mesh
from VICRegistrationLib.imaging.region import dice_coefficient
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.organ_fit import OrganFit
from VICRegistrationLib.registration.steps import finish

N_PLACES = 8
N_POINTS = 4000
# What is asked for: the mean from the deepest place, and from anywhere.
DEEPEST_MM, ANYWHERE_MM = 1.0, 1.5


@dataclass(frozen=True)
class Started:
    """Result of one click.

    Parameters
    ----------
    mean, p95 : float
        Of the distances of points on the experts' surface from the fitted one, mm; infinite if there is none.
    dice : float
        Of the region that was fitted to, and the experts' lumen.
    seconds : float
        From the click to the surface.
    surface : str
        What the fit said of itself, or why there is none.
    both, triangles : float
        Mean distances both ways, mm: of the fitted surface, and of smoothed triangles of the same region, as Slicer
        makes them.
    """

    mean: float
    p95: float
    dice: float
    seconds: float
    surface: str
    both: float = np.inf
    triangles: float = np.inf


def distances(reference: Reference, surface: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Distances of points on a reference from a surface, and of points on the surface from the reference, mm."""
    there = np.abs(distances_from(surface, points_on(reference, N_POINTS)))
    return there, np.abs(distances_from(reference, points_on(surface, N_POINTS)))


def started(bladder: Bladder, reference: Reference, seed: np.ndarray) -> Started:
    """Fit one bladder from one place with default options, and measure it against the experts' surface."""
    start = time.perf_counter()
    try:
        fit = finish(fit_organ(bladder.image, seed))
    except ValueError as error:
        return Started(np.inf, np.inf, 0.0, time.perf_counter() - start, str(error).split(";")[0])
    seconds = time.perf_counter() - start
    corners, triangles, _ = contour_in_world(smoothed_contour(fit.region), fit.region)
    away, back = distances(reference, fit.surface)
    theirs = distances(reference, closed_mesh(ReferenceMesh(corners, triangles)))
    sizes = float(away.mean()), float(np.quantile(away, 0.95)), dice_coefficient(bladder.lumen, fit.region)
    both = (float(np.concatenate(pair).mean()) for pair in ((away, back), theirs))
    return Started(*sizes, seconds, kind(fit), *both)


def kind(fit: OrganFit) -> str:
    """Verdict of a fit."""
    return ", ".join(problem.kind for problem in fit.problems) or "valid"


def by_case(found: dict[str, list[Started]]) -> str:
    """Distances both ways, medians and worst of all clicks into each bladder, and into all of them."""
    title = ["real case", "clicks", "fitted: median mm", "worst mm", "triangles: median mm", "worst mm"]
    rows = [title]
    everything = [one for clicks in found.values() for one in clicks]
    for name, ones in [*found.items(), ("all", everything)]:
        sizes = [[one.both for one in ones], [one.triangles for one in ones]]
        rows.append([name, str(len(ones)), *(f"{part(size):.2f}" for size in sizes for part in (np.median, max))])
    return table(rows)


def report(*, quick: bool) -> str:
    """Fit each bladder from its deepest place, and from places anywhere in its lumen."""
    rows = [["bladder", "place", "mean mm", "95 % mm", "both ways", "triangles", "Dice", "s", "surface"]]
    deepest, anywhere, seconds, cases = [], [], {}, {}
    for bladder in bladders(names=NAMES + HARD):
        reference = drawn_surface(bladder)
        places = [] if quick else list(other_seeds(bladder, N_PLACES))
        found = [started(bladder, reference, seed) for seed in (bladder.seed, *places)]
        cases[bladder.name.split("_")[-1]] = found
        deepest.append(found[0].mean)
        anywhere += [one.mean for one in found[1:]]
        seconds[bladder.name] = np.median([one.seconds for one in found])
        rows += [
            [bladder.name, str(number or "deepest"), f"{one.mean:.2f}", f"{one.p95:.2f}"]
            + [f"{one.both:.2f}", f"{one.triangles:.2f}", f"{one.dice:.3f}", f"{one.seconds:.1f}", one.surface]
            for number, one in enumerate(found)
        ]
    if not deepest:
        return "  The data is absent."
    slowest = max(seconds, key=seconds.get)
    summary = [["clicks", "number", *(f"under {limit:g} mm" for limit in (DEEPEST_MM, ANYWHERE_MM)), "worst mm"]]
    for where, found in (("at the deepest place", deepest), ("anywhere", anywhere)):
        under = [str(np.count_nonzero(np.array(found) < limit)) for limit in (DEEPEST_MM, ANYWHERE_MM)]
        summary += [[where, str(len(found)), *under, f"{max(found):.2f}"]] if found else []
    return "\n\n".join(
        [
            "  One click and default options. Mean and 95 %: from points of the experts' lumen to the fitted surface. "
            "Both ways: the mean\n  of these and of the distances back. Triangles: the same of marching cubes and "
            "smoothing as in Slicer, of the same region.\n  Dice: of the separated region. Deepest: the place in the "
            "lumen that is farthest from its wall; others: anywhere in it, at\n  random.",
            table(rows),
            table(summary),
            "  Mean distances both ways, over all of these clicks.",
            by_case(cases),
            f"  The slowest, {slowest}, takes {seconds[slowest] / np.median(list(seconds.values())):.1f} times as long "
            "as the median one (medians over the places).",
        ]
    )
