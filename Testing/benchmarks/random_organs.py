"""Organs of random shape: the generic model, scaled, rotated and deformed at random; painted, and fitted."""

from __future__ import annotations

import numpy as np
from measuring import table
from scipy import ndimage

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.geometry import models, parametrization
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.triangulation import triangulate_volume
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.phantoms.painting import paint
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish

INSIDE, OUTSIDE = 800.0, 200.0
SPACING, NOISE, MARGIN_MM = (0.8, 0.8, 3.0), 40.0, 12.0
FIRST_SEED, N_ORGANS = 1000, 150


def random_organ(seed: int) -> BSplineSurface:
    """Smooth and closed; most of them are valid, some pass through themselves."""
    random = np.random.default_rng(seed)
    net = [(9, 7), (13, 9), (9, 7), (17, 13)][random.integers(4)]
    axes = np.diag(random.uniform(12.0, 40.0, 3))
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    model = models.closed_organ(net, axes=axes @ turn.T, center=random.normal(size=3) * 50.0)
    points, length = model.control_net, axes.max()
    pushed = np.zeros_like(points)
    for _ in range(6):
        center = points.reshape(-1, 3)[random.integers(points[..., 0].size)]
        reach = random.uniform(0.3, 0.8) * length
        fading = np.exp(-np.square(points - center).sum(axis=-1, keepdims=True) / (2.0 * reach**2))
        pushed += fading * random.normal(size=3) * length * random.uniform(0.05, 0.35)
    smooth = parametrization.closed_organ(model)
    return smooth.deform(smooth.fit(points + pushed))


def painted(
    surface: BSplineSurface, *, spacing=SPACING, noise: float = NOISE, seed: int = 0
) -> tuple[Image, np.ndarray]:
    """Image of an organ in even surroundings with Gaussian noise, and the organ's deepest place, (1, 3) RAS mm."""
    points = surface.control_net.reshape(-1, 3)
    low, high = points.min(axis=0) - MARGIN_MM, points.max(axis=0) + MARGIN_MM
    shape = tuple(np.ceil((high - low) / spacing).astype(int)[::-1])
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = low
    mesh = triangulate_volume(surface, chord_error=0.05)
    fractions = volume_fractions(mesh.points, mesh.triangles, shape, matrix)
    grey = paint(np.full(shape, OUTSIDE), [(fractions, INSIDE)])
    image = Image(grey + noise * np.random.default_rng(seed).standard_normal(shape), matrix)
    depth = ndimage.distance_transform_edt(fractions > 0.5, sampling=spacing[::-1])
    deepest = np.unravel_index(depth.argmax(), shape)
    return image, image.to_ras(np.array([deepest[::-1]], dtype=float))


def report(*, quick: bool) -> str:
    """Fit many organs of random shape with default options."""
    rows, volumes, valid = [], [], 0
    for seed in range(FIRST_SEED, FIRST_SEED + (2 if quick else N_ORGANS)):
        surface = random_organ(seed)
        if check_surface(surface):
            continue
        fit = finish(fit_organ(*painted(surface, seed=seed)))
        found = deviation(fit.surface, surface, n_points=2000)
        valid += not fit.problems
        rows.append([found.mean, found.p95, found.maximum])
        volumes.append(surface.volume() / 1000.0)
    title = ["organs of random shape", "mean mm", "95 % mm", "largest mm"]
    values = np.array(rows)
    lines = [
        [name, *(f"{value:.2f}" for value in np.percentile(values, percent, axis=0))]
        for name, percent in (("median organ", 50), ("95 % of the organs", 95), ("worst", 100))
    ]
    return (
        f"  Random shapes in voxels of {' x '.join(f'{step:g}' for step in SPACING)} mm, noise of "
        f"{NOISE / (INSIDE - OUTSIDE):.0%} of the contrast, one seed, default options.\n\n"
        f"{table([title, *lines])}\n\n  {len(rows)} organs of {min(volumes):.0f} to {max(volumes):.0f} ml fitted, "
        f"{valid} of the surfaces valid."
    )
