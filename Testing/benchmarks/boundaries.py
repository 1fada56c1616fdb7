"""Corrections by boundary points 5 mm off the edge: distance left, displacement elsewhere; and repeated fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bladders import bladders
from measuring import interleaved_seconds, ratio, table

from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.moments import ball_radius
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.organ_fit import OrganFit
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish

HEIGHT_MM = 5.0
# Places (u, v) on the surface: in the middle, on the seam, at the poles, and beside one.
PLACES = ((0.3, 0.45), (0.61, 0.2), (0.0, 0.5), (0.1, 0.0), (0.1, 1.0), (0.4, 0.95))
# All around, for the benchmark.
_MORE_PLACES = tuple((u, v) for u in (0.0, 0.2, 0.4, 0.6, 0.8) for v in (0.1, 0.3, 0.5, 0.7, 0.9))


def off(surface: BSplineSurface, places, heights) -> np.ndarray:
    """Points at heights over places (u, v) of a surface, mm."""
    u, v = np.array(places, dtype=float).T
    return surface.points(u, v) + np.asarray(heights, dtype=float)[:, None] * surface.normals(u, v)


def moved(before: BSplineSurface, after: BSplineSurface) -> tuple[np.ndarray, np.ndarray]:
    """Points of a surface and how far they have moved along its normals, mm; both have the same parameters."""
    u, v = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 97), np.linspace(0, 1, 65)))
    points = before.points(u, v)
    return points, np.einsum("nk,nk->n", after.points(u, v) - points, before.normals(u, v))


@dataclass(frozen=True)
class Pull:
    """Effect of one boundary point, mm.

    Parameters
    ----------
    left : float
        Distance of the point from the corrected surface.
    opposite : float
        Largest displacement to the other side than the point's.
    far : float
        Largest displacement farther from the wall next to the point than half the organ's radius, that of a ball of its
        volume.
    elsewhere : bool
        Whether that wall is another one than the point was put over: inside of a thin organ.
    found : OrganFit
    """

    left: float
    opposite: float
    far: float
    elsewhere: bool
    found: OrganFit


def pull(image: Image, fit: OrganFit, place: tuple[float, float], height: float) -> Pull:
    """Correct an organ with one point over a place of its surface."""
    point = off(fit.surface, [place], [height])
    found = finish(refit(image, fit.surface, fit.options, boundary_points=point))
    points, heights = moved(fit.surface, found.surface)
    nearest = closest_points(fit.surface, point)
    far = np.linalg.norm(points - nearest.points, axis=1) > 0.5 * ball_radius(fit.surface.volume())
    return Pull(
        left=float(abs(boundary_deviations(found.surface, point)[0])),
        opposite=float((-np.sign(height) * heights).max()),
        far=float(np.abs(heights[far]).max()),
        elsewhere=bool(abs(nearest.distances[0]) < 0.99 * abs(height)),
        found=found,
    )


def report(*, quick: bool) -> str:
    """Correct the demo's organs at many places, outward and inward, and time one correction against a whole fit."""
    pelvis = pelvis_phantom()
    places = PLACES[:2] if quick else PLACES + _MORE_PLACES
    count = 0
    rows = [["organ", "wall next to it", "points", "left mm", "opposite mm", "far mm", "correction / fit"]]
    again = [["organ", "moved by mm", "at most mm", "again / first"]]
    for name, seed in pelvis.seeds.items():
        fit = finish(fit_organ(pelvis.image, seed))
        again.append(_again(name, fit))
        seconds = correction_seconds(pelvis.image, fit, 1 if quick else 5)
        pulls = [pull(pelvis.image, fit, place, height) for place in places for height in (HEIGHT_MM, -HEIGHT_MM)]
        count += len(pulls)
        for elsewhere, wall in ((False, "meant"), (True, "another")):
            some = [one for one in pulls if one.elsewhere == elsewhere]
            if some:
                worst = [max(getattr(one, what) for one in some) for what in ("left", "opposite", "far")]
                numbers = [str(len(some)), *(f"{value:.2f}" for value in worst)]
                rows.append([name, wall, *numbers, f"{ratio(seconds['correction'], seconds['fit']):.1f}"])
    for found in () if quick else bladders():
        again.append(_again(f"bladder {found.name}", finish(fit_organ(found.image, found.seed))))
    return (
        f"  {count} points, one at a time, {HEIGHT_MM:g} mm outside or inside of the fitted surface. Worst values.\n"
        "  left: distance of the point from the surface; opposite: displacement to the other side; far: displacement\n"
        "  beyond half the organ's radius.\n\n" + table(rows) + "\n\n  Fitted again without points:\n\n" + table(again)
    )


def _again(name: str, fit: OrganFit) -> list[str]:
    """Fit a surface again that is at its edge already, and measure how far it moves."""
    found = finish(refit(fit.image, fit.surface))
    heights = np.abs(moved(fit.surface, found.surface)[1])
    return [name, f"{heights.mean():.2f}", f"{heights.max():.2f}", f"{found.seconds / fit.seconds:.1f}"]


def correction_seconds(image: Image, fit: OrganFit, repeats: int) -> dict[str, list[float]]:
    """Seconds of one point's correction, and of the fit itself from the separated region."""
    point = off(fit.surface, PLACES[:1], [HEIGHT_MM])
    return interleaved_seconds(
        {
            "correction": lambda: finish(refit(image, fit.surface, fit.options, boundary_points=point)),
            "fit": lambda: finish(fit_region(image, fit.region, fit.options)),
        },
        repeats,
    )
