"""Dependence of a fit on the places of the seeds and on the chosen grey levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from measuring import table

from VICRegistrationLib.analysis.distances import Deviation, deviation
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.phantoms.pelvis import LUMEN_LEVELS, WALL, PelvisPhantom, pelvis_phantom
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.organ_fit import OrganFit
from VICRegistrationLib.registration.steps import finish

# Of the contrast between urine and wall, up or down; both ends of the grey levels by themselves.
MOVED = 0.15
CONTRAST = LUMEN_LEVELS["bladder"] - WALL
ALLOWED_MM = 0.05
MOST_SEEDS = 3
N_POINTS = 3000


@dataclass(frozen=True)
class Trials:
    """One organ, fitted from the phantom's own seeds with suggested grey levels, and again from others.

    Parameters
    ----------
    base : Deviation
        From the truth.
    means : tuple of float
        Mean deviation of every trial that came to an end, mm.
    failures : tuple of str
        What the others said.
    """

    base: Deviation
    means: tuple[float, ...]
    failures: tuple[str, ...]

    @property
    def changes(self) -> np.ndarray:
        """By how much the mean deviation of each trial differs from that of the base fit, mm."""
        return np.abs(np.array(self.means) - self.base.mean)


def seeds_anywhere(surface: BSplineSurface, number: int, random: np.random.Generator) -> np.ndarray:
    """Random points inside a closed surface, evenly spread over its volume, (number, 3) RAS mm."""
    net = surface.control_net.reshape(-1, 3)
    found = np.zeros((0, 3))
    while len(found) < number:
        places = random.uniform(net.min(axis=0), net.max(axis=0), (50, 3))
        found = np.concatenate([found, places[closest_points(surface, places).distances < 0.0]])
    return found[:number]


def trials(phantom: PelvisPhantom, organ: str, number: int, random: np.random.Generator, base: OrganFit) -> Trials:
    """Fit one organ `number` times from random seeds and moved grey levels, and compare with the fit from its own."""
    truth = phantom.surfaces[organ]
    means, failures = [], []
    for _ in range(number):
        seeds = seeds_anywhere(truth, int(random.integers(1, MOST_SEEDS + 1)), random)
        limits = np.array(base.region.threshold) + random.uniform(-MOVED, MOVED, 2) * CONTRAST
        try:
            fit = finish(fit_organ(phantom.image, seeds, FitOptions(threshold=tuple(limits))))
        except ValueError as error:
            failures.append(str(error))
        else:
            means.append(deviation(fit.surface, truth, n_points=N_POINTS).mean)
    return Trials(deviation(base.surface, truth, n_points=N_POINTS), tuple(means), tuple(failures))


def report(*, quick: bool) -> str:
    """Measure by how much seeds and grey levels change the result."""
    n_phantoms, number = (1, 1) if quick else (4, 10)
    rows = [
        ["organ", "noise", "mean mm", "95 % mm", "trials", "largest change mm", f"beyond {ALLOWED_MM} mm", "failed"]
    ]
    results = []
    for seed in range(n_phantoms):
        phantom, random = pelvis_phantom(seed=seed), np.random.default_rng(seed)
        for organ in phantom.seeds:
            base = finish(fit_organ(phantom.image, phantom.seeds[organ]))
            found = trials(phantom, organ, number, random, base)
            results.append(found)
            beyond = str(np.count_nonzero(found.changes > ALLOWED_MM))
            largest = f"{found.changes.max(initial=0.0):.3f}"
            sizes = [f"{found.base.mean:.3f}", f"{found.base.p95:.2f}", str(number), largest, beyond]
            rows.append([organ, str(seed), *sizes, str(len(found.failures))])
    changes = np.concatenate([found.changes for found in results])
    failures = [failure for found in results for failure in found.failures]
    return "\n\n".join(
        [
            "  Phantoms of 0.59 x 0.59 x 4 mm, 5 % noise, 20 % coil bias, each with its own noise and tissue. mean, "
            "95 %: from the\n  truth, with the phantom's seeds and suggested grey levels. Trials: 1 to "
            f"{MOST_SEEDS} seeds anywhere inside the true surface,\n  both grey levels moved by up to {MOVED:.0%} of "
            f"the contrast ({MOVED * CONTRAST:.0f} of {CONTRAST:.0f}). Change: of the mean deviation.",
            table(rows),
            f"  {len(changes) + len(failures)} trials: the mean changes by {np.median(changes):.3f} mm (median) and by "
            f"at most {changes.max():.3f} mm,\n  {np.count_nonzero(changes > ALLOWED_MM)} of them beyond "
            f"{ALLOWED_MM} mm; {len(failures)} failed.",
            *(f"  Failed: {failure}" for failure in failures),
        ]
    )
