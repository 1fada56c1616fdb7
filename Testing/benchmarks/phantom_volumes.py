"""Errors of the volumes of the demo's organs, painted with other sizes of voxels."""

from __future__ import annotations

import numpy as np
from measuring import table

from VICRegistrationLib.phantoms.pelvis import PelvisPhantom, pelvis_phantom
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish

PIXELS_MM = (0.5, 0.7, 0.9, 1.0)
SLICES_MM = (1.0, 2.0, 3.0, 4.0, 5.0)
# A field of view that holds the organs with their walls, mm: in the plane, and across it.
FIELD_MM = (146.0, 106.0)
ASKED_PERCENT = 0.7
# Noise changes the volume of a thin organ in thick slices by half a percent from image to image.
SEEDS = (0, 1, 2)


def painted_with(pixel: float, slices: float, seed: int = 0) -> PelvisPhantom:
    """Paint the demo's pelvis with pixels and slices of other sizes, mm; the seed is that of the noise."""
    count = int(np.ceil(FIELD_MM[0] / pixel))
    return pelvis_phantom(
        spacing=(pixel, pixel, slices), size=(count, count), n_slices=int(np.ceil(FIELD_MM[1] / slices)), seed=seed
    )


def volume_errors(phantom: PelvisPhantom) -> dict[str, float]:
    """Fit each organ with default options: by how much its volume is too large, in %."""
    errors = {}
    for name, truth in phantom.surfaces.items():
        fit = finish(fit_organ(phantom.image, phantom.seeds[name]))
        errors[name] = 100.0 * (fit.surface.volume() / truth.volume() - 1.0)
    return errors


def report(*, quick: bool) -> str:
    """Fit the organs in images of all sizes of voxels."""
    rows, found = [], []
    seeds = SEEDS[:1] if quick else SEEDS
    for pixel in PIXELS_MM[2:3] if quick else PIXELS_MM:
        for slices in SLICES_MM[1:2] if quick else SLICES_MM:
            errors = [volume_errors(painted_with(pixel, slices, seed)) for seed in seeds]
            organs = list(errors[0])
            found.append([[each[name] for name in organs] for each in errors])
            rows.append([f"{pixel:g}", f"{slices:g}", *(f"{mean:+.2f}" for mean in np.mean(found[-1], axis=0))])
    title = ["pixels mm", "slices mm", *(f"{name} %" for name in organs)]
    means, single = np.abs(np.mean(found, axis=1)).ravel(), np.abs(found).ravel()
    return (
        "  By how much the fitted volume is larger than the true one; default options, the demo's bias and seeds. "
        f"Number of images that differ by their noise: {len(seeds)}; the table has the mean over these.\n\n"
        f"{table([title, *rows])}\n\n  Within "
        f"{ASKED_PERCENT} %: {_within(means)} means, largest {means.max():.2f} %; {_within(single)} single images, "
        f"largest {single.max():.2f} %, root mean square {np.sqrt(np.mean(single**2)):.2f} %."
    )


def _within(sizes: np.ndarray) -> str:
    """How many errors, %, are as small as asked for."""
    return f"{np.count_nonzero(sizes <= ASKED_PERCENT)} of {sizes.size}"
