"""Images of the benchmarks: the demo's organs, real bladders if there are any, an organ in a volume of any size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bladders import bladders

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import Region
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.segmentation.separation import separate

ORGAN_LEVEL, WALL_LEVEL, TISSUE_LEVELS, NOISE = 900.0, 170.0, (220.0, 450.0), 45.0


@dataclass(frozen=True, eq=False)
class Scene:
    """An image with a separated organ."""

    name: str
    image: Image
    region: Region


def demo_scenes() -> list[Scene]:
    """The three organs of the demo, separated from their seeds."""
    phantom = pelvis_phantom()
    return [Scene(name, phantom.image, separate(phantom.image, seeds)) for name, seeds in phantom.seeds.items()]


def bladder_scenes() -> list[Scene]:
    """Real bladders with the experts' lumen; none where the data is absent."""
    return [Scene(bladder.name, bladder.image, bladder.lumen) for bladder in bladders()]


def organ_volume(size: tuple[int, int, int], spacing: tuple[float, float, float], *, noise: float = NOISE) -> Image:
    """An ellipsoid of 70 x 64 x 60 mm with a dark wall in patchy tissue, in the middle of (ni, nj, nk) voxels."""
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = -(np.array(size) - 1.0) / 2.0 * spacing
    random = np.random.default_rng(0)
    patches = [int(np.ceil(n * step / 12.0)) for n, step in zip(size[::-1], spacing[::-1])]
    tissue = random.choice(TISSUE_LEVELS, patches).astype(np.float32)
    places = [
        np.minimum((np.arange(n) * step / 12.0).astype(int), count - 1)
        for n, step, count in zip(size[::-1], spacing[::-1], patches)
    ]
    array = np.empty(size[::-1], dtype=np.int16)
    i, j = (matrix[a, 3] + spacing[a] * np.arange(size[a], dtype=np.float32) for a in (0, 1))
    for k in range(size[2]):
        squares = (i[None, :] / 35.0) ** 2 + (j[:, None] / 32.0) ** 2 + ((matrix[2, 3] + spacing[2] * k) / 30.0) ** 2
        # About the signed distance from the ellipsoid near it, mm.
        distance = 32.0 * (np.sqrt(squares) - 1.0)
        inside, wall = (np.clip(0.5 - (distance - reach) / spacing[0], 0.0, 1.0) for reach in (0.0, 4.0))
        grey = tissue[places[0][k]][np.ix_(places[1], places[2])]
        grey = grey + wall * (WALL_LEVEL - grey)
        grey = grey + inside * (ORGAN_LEVEL - grey)
        array[k] = grey + noise * random.standard_normal(grey.shape, dtype=np.float32)
    return Image(array, matrix)
