"""Long, bent organs: fits that start from a tube along the organ's own axis, and from an ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from measuring import table
from scipy.spatial import cKDTree

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.steps import finish

LENGTH_MM, RADIUS_MM = 110.0, 11.0
BENDS = (60, 100, 140, 180, 220, 260)


@dataclass(frozen=True, eq=False)
class BentTube:
    """A tube of 110 x 22 mm with round ends, bent by an angle, bright in dark, in slices of 3 mm.

    Parameters
    ----------
    image : Image
    mask : (nk, nj, ni) ndarray of bool
        Voxels whose centres lie in the tube.
    axis : (n, 3) ndarray
        RAS mm.
    """

    image: Image
    mask: np.ndarray
    axis: np.ndarray

    def errors(self, surface: BSplineSurface) -> np.ndarray:
        """Distances of a surface's points from the tube, (n,) mm; for one that is not flattened."""
        points = surface.points(*surface.midpoints(64, 48))
        return np.abs(cKDTree(self.axis).query(points)[0] - RADIUS_MM)


def bent_tube(degrees: float, *, flat: float = 1.0) -> BentTube:
    """Paint a tube that is bent by an angle, and is so many times as wide as it is high."""
    spacing = np.array([1.0, 1.0, 3.0])
    bend = LENGTH_MM / np.deg2rad(degrees)
    t = np.linspace(-0.5, 0.5, 400) * np.deg2rad(degrees)
    axis = np.column_stack([bend * np.sin(t), bend * np.cos(t), np.zeros(len(t))])
    axis -= axis.mean(axis=0)
    size = ((np.ptp(axis, axis=0) + 4.0 * RADIUS_MM) / spacing).astype(int) + 1
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = -(size - 1) / 2.0 * spacing
    image = Image(np.zeros(size[::-1]), matrix)
    k, j, i = np.indices(image.array.shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3))
    _, nearest = cKDTree(axis).query(points)
    away = np.linalg.norm((points - axis[nearest]) * [1.0, 1.0, 1.0 / flat], axis=1).reshape(image.array.shape)
    grey = 100.0 + 300.0 * np.clip(0.5 + RADIUS_MM - away, 0.0, 1.0)
    noisy = grey + 10.0 * np.random.default_rng(0).standard_normal(grey.shape)
    return BentTube(Image(noisy, matrix), away < RADIUS_MM, axis)


def report(*, quick: bool) -> str:
    """Fit tubes of several bends from both starts."""
    rows = [["bent by", "start", "mean mm", "largest mm", "problems", "net", "held"]]
    for degrees in BENDS[3:4] if quick else BENDS:
        tube = bent_tube(degrees)
        region = region_from_mask(tube.image, tube.mask)
        for start in ("automatic", "ellipsoid"):
            fit = finish(fit_region(tube.image, region, FitOptions(model=start)))
            errors = tube.errors(fit.surface)
            held = [choice.value for choice in fit.choices if choice.option == "drift limit"]
            problems = ", ".join(problem.kind for problem in fit.problems) or "none"
            sizes = [f"{errors.mean():.2f}", f"{errors.max():.1f}"]
            rows.append([f"{degrees}°", start, *sizes, problems, "{}x{}".format(*fit.options.net), *(held or ["-"])])
    return (
        "  A tube of 110 x 22 mm with round ends, default options. Start: the automatic generic model, or the "
        "ellipsoid along the\n  principal axes. Distances are those of the fitted surface's points from the "
        "tube itself.\n\n" + table(rows)
    )
