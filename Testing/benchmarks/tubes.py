"""Long, bent organs: fits from one click, and fits of a region from a tube along its axis and from an ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from measuring import table
from scipy import ndimage
from scipy.spatial import cKDTree

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.steps import finish

LENGTH_MM, RADIUS_MM = 110.0, 11.0
BENDS = (60, 100, 140, 180, 220, 260)
# What makes a click in a tube hard: radius of a gap in the wall, mm, and share of the signal that is left at one end.
HARD = {"closed wall": (0.0, 1.0), "gap": (8.0, 1.0), "dim end": (0.0, 0.35), "gap, dim end": (8.0, 0.5)}
# Places of the clicks along the axis.
CLICKS = {"middle": 200, "dim end": 40, "bright end": 360}
WALL_MM, NEIGHBOUR_MM, PATCH_MM = 3.0, 12.0, 12.0
LUMEN, WALL, TISSUE, NOISE = 900.0, 170.0, (220.0, 450.0, 700.0), 45.0


@dataclass(frozen=True, eq=False)
class BentTube:
    """A tube of 110 x 22 mm with round ends, bent by an angle, in slices of 3 mm.

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

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distances of points (n, 3), RAS mm, outward from the tube, (n,) mm; for one that is not flattened."""
        return cKDTree(self.axis).query(points)[0] - RADIUS_MM

    def errors(self, surface: BSplineSurface) -> np.ndarray:
        """Distances of a surface's points from the tube, (n,) mm; for one that is not flattened."""
        return np.abs(self.distances(surface.points(*surface.midpoints(64, 48))))


def bent_tube(degrees: float, *, flat: float = 1.0) -> BentTube:
    """Paint a tube that is bent by an angle, and is so many times as wide as it is high."""
    image, axis = _around(degrees, np.array([1.0, 1.0, 3.0]), 2.0 * RADIUS_MM)
    away, _, _ = _from_axis(image, axis)
    away = np.linalg.norm(away * [1.0, 1.0, 1.0 / flat], axis=-1)
    grey = 100.0 + 300.0 * np.clip(0.5 + RADIUS_MM - away, 0.0, 1.0)
    noisy = grey + 10.0 * np.random.default_rng(0).standard_normal(grey.shape)
    return BentTube(Image(noisy, image.ijk_to_ras), away < RADIUS_MM, axis)


def walled_tube(degrees: float, *, gap_mm: float = 0.0, left: float = 1.0) -> BentTube:
    """Paint a bent tube with a dark wall, in patchy tissue.

    Behind a gap in the wall, of a radius in mm, is a ball as bright as the tube. The signal falls along the axis to the
    share that is left of it at the first end.
    """
    image, axis = _around(degrees, np.array([0.8, 0.8, 3.0]), RADIUS_MM + WALL_MM + 2.0 * NEIGHBOUR_MM)
    away, nearest, points = _from_axis(image, axis)
    distance, random = np.linalg.norm(away, axis=-1), np.random.default_rng(0)
    patches = np.floor((points - points.reshape(-1, 3).min(axis=0)) / PATCH_MM).astype(int)
    tissue = random.choice(TISSUE, patches.reshape(-1, 3).max(axis=0) + 1)[tuple(np.moveaxis(patches, -1, 0))]
    inside, wall = (np.clip(0.5 + reach - distance, 0.0, 1.0) for reach in (RADIUS_MM, RADIUS_MM + WALL_MM))
    if gap_mm:
        place = axis[260]
        outward = np.cross(axis[261] - axis[259], [0.0, 0.0, -1.0])
        outward /= np.linalg.norm(outward)
        away = points - place
        along = away @ outward
        near = np.linalg.norm(away - (RADIUS_MM + WALL_MM + NEIGHBOUR_MM) * outward, axis=-1) < NEIGHBOUR_MM
        tissue = np.where(near, LUMEN, tissue)
        hole = (np.linalg.norm(away - along[..., None] * outward, axis=-1) < gap_mm) & (along > 0.0)
        wall = np.where(hole, 0.0, wall)
        tissue = np.where(hole & (distance < RADIUS_MM + 2.0 * WALL_MM), LUMEN, tissue)
    grey = tissue + wall * (WALL - tissue)
    grey = (grey + inside * (LUMEN - grey)) * (left + (1.0 - left) * nearest / (len(axis) - 1.0))
    noisy = grey + NOISE * random.standard_normal(grey.shape)
    blurred = ndimage.gaussian_filter(noisy, (0.0, 0.6, 0.6)).astype(np.float32)
    return BentTube(Image(blurred, image.ijk_to_ras), distance < RADIUS_MM, axis)


def _around(degrees: float, spacing: np.ndarray, margin: float) -> tuple[Image, np.ndarray]:
    """Empty volume around the axis of a bent tube, and the axis, (400, 3) RAS mm."""
    bend = LENGTH_MM / np.deg2rad(degrees)
    t = np.linspace(-0.5, 0.5, 400) * np.deg2rad(degrees)
    axis = np.column_stack([bend * np.sin(t), bend * np.cos(t), np.zeros(len(t))])
    axis -= axis.mean(axis=0)
    size = ((np.ptp(axis, axis=0) + 2.0 * margin) / spacing).astype(int) + 1
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = -(size - 1) / 2.0 * spacing
    return Image(np.zeros(size[::-1], dtype=np.float32), matrix), axis


def _from_axis(image: Image, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vector from the nearest place of the axis to each voxel, the number of that place, and the voxel's own place."""
    k, j, i = np.indices(image.array.shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3))
    _, nearest = cKDTree(axis).query(points)
    shape = image.array.shape
    return (points - axis[nearest]).reshape(*shape, 3), nearest.reshape(shape), points.reshape(*shape, 3)


def report(*, quick: bool) -> str:
    """Fit tubes of several bends from one click, and from both starts."""
    return (
        "  A tube of 110 x 22 mm with round ends, default options. Distances are those of the fitted surface's points "
        "from the\n  tube itself.\n\n  From one click. The tube has a wall, in patchy tissue. Behind the gap is a ball "
        "as bright as the tube.\n\n"
        + table(_from_clicks(quick=quick))
        + "\n\n  From the region. Start: the automatic generic model, or the ellipsoid along the principal axes.\n\n"
        + table(_from_regions(quick=quick))
    )


def _from_clicks(*, quick: bool) -> list[list[str]]:
    places = CLICKS if not quick else list(CLICKS)[:1]
    rows = [["tube bent by", "image", *(f"click {place}, mean mm" for place in places), "largest mm"]]
    for degrees in BENDS[3:4] if quick else BENDS[1::2]:
        for name, (gap, left) in HARD.items():
            tube = walled_tube(degrees, gap_mm=gap, left=left)
            errors = [tube.errors(finish(fit_organ(tube.image, tube.axis[CLICKS[place]])).surface) for place in places]
            means = [f"{each.mean():.2f}" for each in errors]
            rows.append([f"{degrees}°", name, *means, f"{max(each.max() for each in errors):.1f}"])
    return rows


def _from_regions(*, quick: bool) -> list[list[str]]:
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
    return rows
