"""Real MRI of bladders with the lumen that experts have drawn, and how far fitted surfaces are from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measuring import table
from scipy import ndimage

from VICRegistrationLib.analysis.deviation import deviation, mesh_of_mask
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import fill_holes
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.separation import Region, region_from_mask
from VICRegistrationLib.registration.organ import FitOptions, finish, fit_organ

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "bladder_mri"
LUMEN = 3
# Thresholds by hand: between the wall and most of the urine, low enough to hold its dim parts.
BY_HAND = {
    "crop_IM0465": FitOptions(threshold=(45.0, 255.0)),
    "crop_IM0533": FitOptions(threshold=(50.0, 255.0)),
    "full_p5": FitOptions(threshold=(75.0, 255.0), erosion=6.0),
}


@dataclass(frozen=True, eq=False)
class Bladder:
    """An image, the experts' lumen (its largest piece, holes filled) and a seed in its deepest place, RAS mm."""

    name: str
    image: Image
    lumen: Region
    seed: np.ndarray


def load_bladder(name: str, folder: Path = DATA) -> Bladder:
    """Read one of the images and clean its label: some slices carry stray pieces."""
    image = read_image(folder / f"{name}_t2.nii.gz")
    label = read_image(folder / f"{name}_label.nii.gz").array == LUMEN
    region = region_from_mask(image, label, largest_component=True)
    lumen = replace(region, mask=fill_holes(region.mask))
    depth = ndimage.distance_transform_edt(np.pad(lumen.mask, 1), sampling=image.spacing[::-1])[1:-1, 1:-1, 1:-1]
    deepest = np.unravel_index(depth.argmax(), depth.shape)
    return Bladder(name, image, lumen, lumen.image.to_ras(np.array([deepest[::-1]], dtype=float)))


def bladders(folder: Path = DATA) -> list[Bladder]:
    """All of them; none where the data is absent."""
    return [load_bladder(name, folder) for name in BY_HAND if (folder / f"{name}_t2.nii.gz").exists()]


def report(*, quick: bool) -> str:
    """Measure fits from one seed, with thresholds by hand and suggested ones."""
    cases = bladders()
    if not cases:
        return "  Skipped: ../shared/data/bladder_mri is not there."
    rows = [["bladder", "threshold", "mean mm", "signed mm", "95 % mm", "ml", "experts' ml"]]
    for case in cases[:1] if quick else cases:
        reference = mesh_of_mask(case.lumen.image)
        for way, options in (("by hand", BY_HAND[case.name]), ("suggested", FitOptions())):
            fit = finish(fit_organ(case.image, case.seed, options))
            found = deviation(fit.surface, reference)
            limits = " to ".join(f"{limit:.0f}" for limit in fit.region.threshold)
            distances = [f"{found.mean:.2f}", f"{found.mean_signed:+.2f}", f"{found.p95:.2f}"]
            volumes = [f"{fit.surface.volume() / 1000.0:.0f}", f"{case.lumen.volume_ml:.0f}"]
            rows.append([case.name, f"{way}, {limits}", *distances, *volumes])
    return "  Deviation from the experts' lumen; signed: positive is outside of it.\n\n" + table(rows)
