"""What depends on voxels and points: separating an organ in a large volume, and sampling."""

from __future__ import annotations

from statistics import median

import numpy as np
from measuring import interleaved_seconds, ratio, table
from scenes import organ_volume
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.segmentation.separation import separate

SIZE, SPACING = (512, 512, 100), (0.59, 0.59, 3.0)
N_POINTS = 200_000


def separation_seconds(image: Image, repeats: int) -> dict[str, list[float]]:
    """Seconds of separating the organ in the middle, and of labelling the volume above the same threshold."""
    low = separate(image, np.zeros((1, 3))).threshold[0]
    return interleaved_seconds(
        {
            "separate": lambda: separate(image, np.zeros((1, 3))),
            "label": lambda: ndimage.label(image.array > low),
        },
        repeats,
    )


def separation_report(*, quick: bool) -> str:
    """Compare separation with one pass of labelling."""
    image = organ_volume(SIZE, SPACING)
    region = separate(image, np.zeros((1, 3)))
    seconds = separation_seconds(image, 3 if quick else 9)
    extent = region.spacing * (np.array(region.mask.shape[::-1]) - 2)
    return "\n\n".join(
        [
            f"  Organ of {' x '.join(f'{mm:.0f}' for mm in extent)} mm ({region.volume_ml:.0f} ml) in "
            f"{' x '.join(map(str, SIZE))} voxels of {' x '.join(map(str, SPACING))} mm, noisy.\n"
            "  label: one pass of scipy.ndimage.label(volume > t) over the volume.",
            table(
                [
                    [f"in {' x '.join(map(str, SIZE))} voxels", "separate / label", "separate ms", "label ms"],
                    [
                        "separation",
                        f"{ratio(seconds['separate'], seconds['label']):.2f}",
                        f"{1e3 * median(seconds['separate']):.0f}",
                        f"{1e3 * median(seconds['label']):.0f}",
                    ],
                ]
            ),
        ]
    )


def sampling_seconds(image: Image, n_points: int, repeats: int) -> dict[str, list[float]]:
    """Seconds of values with gradients, of values, and of scipy's values, at the same points."""
    sampler = Sampler(image)
    ijk = np.random.default_rng(0).uniform(1.0, image.size - 2.0, (n_points, 3))
    points, indices = image.to_ras(ijk), np.ascontiguousarray(ijk[:, ::-1].T)
    data = image.array.astype(float)
    return interleaved_seconds(
        {
            "gradients": lambda: sampler.values_and_gradients(points),
            "values": lambda: sampler.values(points),
            "scipy": lambda: ndimage.map_coordinates(data, indices, order=1, mode="mirror", prefilter=False),
        },
        repeats,
    )


def sampling_report(*, quick: bool) -> str:
    """Compare sampling with scipy's interpolation of values."""
    image = organ_volume((128, 128, 24), (0.59, 0.59, 3.0))
    rows = [["order", "values + gradients / scipy", "values / scipy", "gradients ms", "values ms", "scipy ms"]]
    seconds = sampling_seconds(image, N_POINTS, 5 if quick else 15)
    ratios = [f"{ratio(seconds[name], seconds['scipy']):.2f}" for name in ("gradients", "values")]
    rows.append(["linear", *ratios, *(f"{1e3 * median(s):.1f}" for s in seconds.values())])
    return (
        f"  {N_POINTS} points in a random order. scipy: one pass of ndimage.map_coordinates, values only.\n\n"
        f"{table(rows)}"
    )
