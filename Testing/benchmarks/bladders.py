"""Real MRI of bladders with the lumen that experts have drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import fill_holes
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.region import Region, region_from_mask

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "bladder_mri"
LUMEN = 3
SEED_DEPTH_MM = 4.0
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
    deep = _depth(lumen)
    deepest = np.unravel_index(deep.argmax(), deep.shape)
    return Bladder(name, image, lumen, lumen.image.to_ras(np.array([deepest[::-1]], dtype=float)))


def other_seeds(bladder: Bladder, count: int) -> np.ndarray:
    """Places anywhere in the lumen, deeper than `SEED_DEPTH_MM`: always the same ones, (count, 1, 3) RAS mm."""
    places = np.argwhere(_depth(bladder.lumen) > SEED_DEPTH_MM)
    chosen = np.random.default_rng(0).choice(len(places), count, replace=False)
    return bladder.lumen.image.to_ras(places[chosen, None, ::-1].astype(float))


def drawn_image(bladder: Bladder) -> Image:
    """Make an image of the lumen alone, as it was drawn: 1 in its voxels and 0 elsewhere."""
    lumen = bladder.lumen
    drawn = np.zeros(bladder.image.array.shape, dtype=np.float32)
    drawn[tuple(slice(first, first + size) for first, size in zip(lumen.offset, lumen.mask.shape))] = lumen.mask
    return Image(drawn, bladder.image.ijk_to_ras)


def _depth(region: Region) -> np.ndarray:
    """Distance of each voxel of a region from its boundary, mm."""
    padded = np.pad(region.mask, 1)
    return ndimage.distance_transform_edt(padded, sampling=region.image.spacing[::-1])[1:-1, 1:-1, 1:-1]


def bladders(folder: Path = DATA) -> list[Bladder]:
    """All of them; none where the data is absent."""
    return [load_bladder(name, folder) for name in NAMES if (folder / f"{name}_t2.nii.gz").exists()]
