"""Verdicts on images that they were not tuned on: real bladders that were changed, with noise for instance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from bladders import HARD, NAMES, Bladder, bladders, drawn_image, drawn_surface, other_seeds
from clicks import clicked
from measuring import table
from scipy import ndimage

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.verdict import GOOD, VERDICTS

N_PLACES, N_POINTS = 2, 1500
# What "good" means, and how often it must be so.
GOOD_MM, GOOD_SHARE = 1.5, 0.95
# Standard deviation of the noise and strength of the bias, shares of the 95th percentile of the grey levels.
_NOISE, _BIAS = 0.04, 0.4
# Share of the organ's slices that is cut off at the top, and exponent of the grey levels.
_CUT, _GAMMA = 0.15, 0.6
# So many slices are averaged into one. Shares of the grey level that are left of urine, and of its layer at the back,
# which takes the last share of the lumen's depth.
_AVERAGED = 3
_DIM, _LAYER, _LAYER_DEPTH = 0.7, 0.55, 0.25

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def mirrored(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exchange left and right."""
    return grey[:, :, ::-1], mask[:, :, ::-1]


def cut(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut the volume within the organ."""
    slices = np.flatnonzero(mask.any(axis=(1, 2)))
    last = slices[-1] - int(_CUT * len(slices))
    return grey[:last], mask[:last]


def with_noise(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add noise of a Rician distribution, as in MRI."""
    width = _NOISE * np.quantile(grey, 0.95)
    noise = width * np.random.default_rng(0).standard_normal((2, *grey.shape))
    return np.rint(np.hypot(grey + noise[0], noise[1])), mask


def with_bias(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Let the signal fall off towards the front, as far from a coil."""
    away = np.linspace(-1.0, 1.0, grey.shape[1])[:, None]
    return np.rint(grey * (1.0 + _BIAS * away)), mask


def with_other_contrast(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Raise dark levels more than bright ones."""
    return np.rint(grey.max() * (grey / grey.max()) ** _GAMMA), mask


def with_thick_slices(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average slices; `changed` moves them to their places."""
    grey, share = (
        part[: len(part) // _AVERAGED * _AVERAGED].reshape(-1, _AVERAGED, *part.shape[1:]).mean(axis=1)
        for part in (grey, mask)
    )
    return np.rint(grey), share > 0.5


def with_dim_urine(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make urine hardly brighter than fat."""
    return np.rint(grey * (1.0 - (1.0 - _DIM) * ndimage.gaussian_filter(mask.astype(float), 1.0))), mask


def with_a_dark_layer(grey: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make urine dark at the back of the lumen, as by contrast medium."""
    rows = np.flatnonzero(mask.any(axis=(0, 2)))
    level = rows[-1] - _LAYER_DEPTH * (rows[-1] - rows[0])
    dark = mask * (np.arange(mask.shape[1]) > level)[:, None]
    return np.rint(grey * (1.0 - (1.0 - _LAYER) * ndimage.gaussian_filter(dark.astype(float), 1.0))), mask


CHANGES: dict[str, Change] = {
    "mirrored": mirrored,
    "cut": cut,
    "noise": with_noise,
    "bias": with_bias,
    "contrast": with_other_contrast,
    "thick slices": with_thick_slices,
    "dim urine": with_dim_urine,
    "dark layer": with_a_dark_layer,
}


def changed(bladder: Bladder, change: Change) -> Bladder:
    """Change an image and its lumen alike."""
    grey, mask = change(bladder.image.array.astype(float), drawn_image(bladder).array > 0)
    matrix = bladder.image.ijk_to_ras.copy()
    if change is with_thick_slices:
        matrix[:3, 3] += (_AVERAGED - 1) / 2.0 * matrix[:3, 2]
        matrix[:3, 2] *= _AVERAGED
    image = Image(np.ascontiguousarray(grey, dtype=np.float32), matrix)
    return replace(
        bladder, image=image, lumen=region_from_mask(image, np.ascontiguousarray(mask), largest_component=True)
    )


def report(*, quick: bool) -> str:
    """Fit every changed bladder from places anywhere in it, and compare the verdict with the distance."""
    found: list[tuple[str, str, float]] = []
    for bladder in bladders(names=NAMES[:1] if quick else NAMES + HARD):
        for name, change in CHANGES.items():
            case = changed(bladder, change)
            truth = points_on(drawn_surface(case), N_POINTS)
            places = other_seeds(case, 1 if quick else N_PLACES)
            found += [(name, *clicked(case.image, seed, truth)) for seed in places]
    if not found:
        return "  The data is absent."
    rows = [["change", "clicks", *VERDICTS, "refused", "invalid", "good and under 1.5 mm", "worst good mm"]]
    for name in (*CHANGES, "all"):
        own = [(word, away) for change, word, away in found if name in (change, "all")]
        good = np.array([away for word, away in own if word == GOOD])
        counts = [str(sum(word == which for word, _ in own)) for which in (*VERDICTS, "refused", "invalid")]
        worst = f"{good.max():.2f}" if len(good) else "-"
        rows.append([name, str(len(own)), *counts, f"{np.count_nonzero(good < GOOD_MM)} of {len(good)}", worst])
    return (
        f"  One click anywhere in the lumen. Asked for: {GOOD_SHARE:.0%} of what is called good lies under "
        f"{GOOD_MM:g} mm\n  from the experts' lumen.\n\n{table(rows)}"
    )
