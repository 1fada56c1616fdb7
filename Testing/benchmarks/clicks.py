"""Random clicks in organs and beside them: each ends with a valid surface and a verdict, or with a refusal."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from bladders import DATA, HARD, NAMES, Bladder, bladders, drawn_surface
from measuring import table

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.registration.diagnostics import fit_diagnostics
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.verdict import VERDICTS, verdict_of

N_CLICKS, N_POINTS = 300, 1500
# A surface that is called good must be nearer than this to the experts', where the click was in their lumen.
WORST_GOOD_MM = 2.0
PROSTATEX = DATA.parent / "prostatex"
# Clicks lie within this share of the volume's sides around its middle, where organs are.
_INNER = 0.6


def clicked(image: Image, seed: np.ndarray, truth: np.ndarray | None) -> tuple[str, float]:
    """Fit from one click: "refused", "invalid" or the verdict, and the mean distance from points of the truth, mm."""
    try:
        fit = finish(fit_organ(image, seed))
    except ValueError:
        return "refused", np.nan
    if fit.problems:
        return "invalid", np.nan
    away = np.nan if truth is None else float(np.abs(closest_points(fit.surface, truth).distances).mean())
    return verdict_of(fit, fit_diagnostics(image, fit)).word, away


def inside_clicks(bladder: Bladder, count: int, random: np.random.Generator) -> np.ndarray:
    """Random voxels of a lumen, at its wall too, (count, 1, 3) RAS mm."""
    places = np.argwhere(bladder.lumen.mask)
    chosen = random.choice(len(places), count, replace=False)
    return bladder.lumen.image.to_ras(places[chosen, None, ::-1].astype(float))


def clicks_anywhere(image: Image, count: int, random: np.random.Generator) -> np.ndarray:
    """Places around the middle of a volume, (count, 1, 3) RAS mm."""
    shares = 0.5 + _INNER * (random.random((count, 1, 3)) - 0.5)
    return image.to_ras(np.round(shares * (image.size - 1.0)))


def report(*, quick: bool) -> str:
    """Fit from each click, and count the outcomes."""
    random, found = np.random.default_rng(0), []
    real = bladders(names=NAMES + HARD)
    others = [pelvis_phantom().image, *map(read_image, sorted(PROSTATEX.glob("*.nii.gz")))]
    total = 24 if quick else N_CLICKS
    each = math.ceil(total / 2 / max(len(real), 1))
    for bladder in real:
        truth = points_on(drawn_surface(bladder), N_POINTS)
        found += [("in the lumen", *clicked(bladder.image, s, truth)) for s in inside_clicks(bladder, each, random)]
    images = [*(bladder.image for bladder in real), *others]
    each = math.ceil((total - len(found)) / len(images))
    for image in images:
        found += [("anywhere", *clicked(image, seed, None)) for seed in clicks_anywhere(image, each, random)]
    rows = [["clicks", "number", *VERDICTS, "refused", "invalid"]]
    for where in ("in the lumen", "anywhere"):
        count = Counter(word for place, word, _ in found if place == where)
        rows.append([where, str(sum(count.values())), *(str(count[w]) for w in (*VERDICTS, "refused", "invalid"))])
    good = np.array([away for place, word, away in found if place == "in the lumen" and word == "good"])
    summary = "  None was called good."
    if len(good):
        summary = (
            f"  Called good in the lumen: {np.count_nonzero(good < 1.5)} of {len(good)} under 1.5 mm, the worst "
            f"{good.max():.2f} mm; asked for at most {WORST_GOOD_MM:g} mm."
        )
    return (
        "  One click each, default options; invalid: a surface that is no valid solid, asked for none.\n\n"
        f"{table(rows)}\n\n{summary}"
    )
