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


def painted_with(pixel: float, slices: float) -> PelvisPhantom:
    """Paint the demo's pelvis with pixels and slices of other sizes, mm."""
    count = int(np.ceil(FIELD_MM[0] / pixel))
    return pelvis_phantom(
        spacing=(pixel, pixel, slices), size=(count, count), n_slices=int(np.ceil(FIELD_MM[1] / slices))
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
    for pixel in PIXELS_MM[2:3] if quick else PIXELS_MM:
        for slices in SLICES_MM[1:2] if quick else SLICES_MM:
            errors = volume_errors(painted_with(pixel, slices))
            found += errors.values()
            title = ["pixels mm", "slices mm", *(f"{name} %" for name in errors)]
            rows.append([f"{pixel:g}", f"{slices:g}", *(f"{error:+.2f}" for error in errors.values())])
    size = np.abs(found)
    within = f"{np.count_nonzero(size <= ASKED_PERCENT)} of {len(size)}"
    return (
        "  By how much the fitted volume is larger than the true one; default options, the demo's noise, bias and "
        f"seeds.\n\n{table([title, *rows])}\n\n  Within {ASKED_PERCENT} %: {within}; largest {size.max():.2f} %, root "
        f"mean square {np.sqrt(np.mean(size**2)):.2f} %."
    )
