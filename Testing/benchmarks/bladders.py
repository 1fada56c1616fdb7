"""Real MRI of bladders with the lumen that experts have drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import fill_holes
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.separation import Region, region_from_mask

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "bladder_mri"
LUMEN = 3
NAMES = ("crop_IM0465", "crop_IM0533", "full_p5")


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
    return [load_bladder(name, folder) for name in NAMES if (folder / f"{name}_t2.nii.gz").exists()]
