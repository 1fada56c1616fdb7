"""Real MRI of bladders with the lumen that experts have drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, closed_mesh, mesh_of_mask
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import fill_holes
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.region import Region, region_from_mask

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "bladder_mri"
LUMEN = 3
SEED_DEPTH_MM = 4.0
NAMES = ("crop_IM0465", "crop_IM0533", "full_p5")
HARD = ("crop_IM0228", "crop_IM0952", "crop_IM1383", "crop_IM1523")


@dataclass(frozen=True, eq=False)
class Bladder:
    """An image, the experts' lumen (its largest piece, holes filled) and a seed in its deepest place, RAS mm."""

    name: str
    image: Image
    lumen: Region
    seed: np.ndarray


def load_bladder(name: str, folder: Path = DATA) -> Bladder:
    """Read one of the images and clean its label: some slices have stray pieces, others no label."""
    image = read_image(folder / f"{name}_t2.nii.gz")
    label = read_image(folder / f"{name}_label.nii.gz").array == LUMEN
    region = region_from_mask(image, _without_gaps(label), largest_component=True)
    lumen = replace(region, mask=fill_holes(region.mask))
    return Bladder(name, image, lumen, _deepest(lumen, lumen.mask))


def drawn_surface(bladder: Bladder) -> ReferenceMesh:
    """Surface of the lumen that the experts drew, RAS mm."""
    return closed_mesh(mesh_of_mask(bladder.lumen.image))


def seed_above(bladder: Bladder, level: float) -> np.ndarray:
    """Deepest place in the lumen with at least a grey level, (1, 3) RAS mm."""
    start = np.asarray(bladder.lumen.offset)
    return _deepest(bladder.lumen, bladder.image.crop(start, start + bladder.lumen.mask.shape).array >= level)


def other_seeds(bladder: Bladder, count: int) -> np.ndarray:
    """Random places in the lumen, deeper than `SEED_DEPTH_MM`, the same in every run, (count, 1, 3) RAS mm."""
    places = np.argwhere(_depth(bladder.lumen) > SEED_DEPTH_MM)
    chosen = np.random.default_rng(0).choice(len(places), count, replace=False)
    return bladder.lumen.image.to_ras(places[chosen, None, ::-1].astype(float))


def drawn_image(bladder: Bladder) -> Image:
    """Make an image of the lumen alone, as it was drawn: 1 in its voxels and 0 elsewhere."""
    drawn = bladder.lumen.in_box((0, 0, 0), bladder.image.array.shape)
    return Image(drawn.astype(np.float32), bladder.image.ijk_to_ras)


def _without_gaps(label: np.ndarray) -> np.ndarray:
    """Fill slices without a label between others, between the signed distances of the two beside the gap.

    Where an expert's wall is open, the fill that made the lumen's label ran out of it, and the slice was left empty.
    """
    label = label.copy()
    drawn = np.flatnonzero(label.any(axis=(1, 2)))
    for before, after in zip(drawn[:-1], drawn[1:]):
        if after == before + 1:
            continue
        below, above = (_signed(label[k]) for k in (before, after))
        for k in range(before + 1, after):
            label[k] = (after - k) * below + (k - before) * above < 0.0
    return label


def _signed(drawn: np.ndarray) -> np.ndarray:
    """Signed distance from the outline of a slice, negative inside, pixels."""
    return ndimage.distance_transform_edt(~drawn) - ndimage.distance_transform_edt(drawn)


def _depth(region: Region) -> np.ndarray:
    """Distance of each voxel of a region from its boundary, mm."""
    padded = np.pad(region.mask, 1)
    return ndimage.distance_transform_edt(padded, sampling=region.image.spacing[::-1])[1:-1, 1:-1, 1:-1]


def _deepest(region: Region, among: np.ndarray) -> np.ndarray:
    """Deepest of some voxels of a region, (1, 3) RAS mm."""
    depth = np.where(among, _depth(region), 0.0)
    return region.image.to_ras(np.array([np.unravel_index(depth.argmax(), depth.shape)[::-1]], dtype=float))


def bladders(folder: Path = DATA, names: tuple[str, ...] = NAMES) -> list[Bladder]:
    """Bladders of some names; none if the data is absent."""
    return [load_bladder(name, folder) for name in names if (folder / f"{name}_t2.nii.gz").exists()]
