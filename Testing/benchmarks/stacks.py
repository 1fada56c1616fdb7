"""Several stacks of one patient: how far the surface and the motion are from the truth, for good and for bad stacks."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measuring import table

from VICRegistrationLib.analysis.comparison import distances_from
from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.geometry.parametrization import rigid_matrix
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.phantoms.pelvis import PelvisPhantom, pelvis_phantom
from VICRegistrationLib.phantoms.stacks import PhantomStack, further_stacks
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.organ_fit import OrganFit
from VICRegistrationLib.registration.stacks import Stack, StackUse
from VICRegistrationLib.registration.steps import finish

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "prostatex"
# In the bladder of px0_sag, RAS mm.
BLADDER = np.array([-57.0, -12.6, 4.0])
SEEDS, SHIFT_MM, TURN_DEGREES = 5, 3.0, 2.0
N_POINTS = 4000
_ABOUT = f"""\
  The demo's organs in slices of 4 mm and pixels of 0.59 mm, each stack with other noise and tissue. The patient moved
  by {SHIFT_MM:g} mm and {TURN_DEGREES:g} degrees before each further one. Default options. Distances are from points of
  the truth to the surface; that of a motion is the mean one between where it takes these points and where they are."""


@dataclass(frozen=True, eq=False)
class Patient:
    """A first stack with the truth, and further ones."""

    first: PelvisPhantom
    further: Sequence[PhantomStack]

    def points(self, organ: str) -> np.ndarray:
        """Points of an organ's true surface, RAS mm."""
        return points_on(self.first.surfaces[organ], N_POINTS)


def patient(seed: int) -> Patient:
    """Paint three stacks."""
    return Patient(
        pelvis_phantom(seed=seed), further_stacks(2, seed=seed, shift_mm=SHIFT_MM, turn_degrees=TURN_DEGREES)
    )


def fitted(patient: Patient, organ: str, images: Sequence[Image], *, first: Image | None = None) -> OrganFit:
    """Fit an organ to the first stack and others."""
    return finish(fit_organ(first or patient.first.image, patient.first.seeds[organ], further=images))


def errors(fit: OrganFit, points: np.ndarray) -> np.ndarray:
    """Distances of true points from a surface, (n,) mm."""
    return np.abs(distances_from(fit.surface, points))


def motion_error(use: StackUse, truth: np.ndarray, points: np.ndarray) -> float:
    """Mean distance between where a motion takes points of the surface and where the true one does, mm."""
    off = use.motion - truth
    return float(np.linalg.norm(points @ off[:3, :3].T + off[:3, 3], axis=1).mean())


def accuracy(patients: Sequence[Patient]) -> str:
    """Make a table of errors with one to three stacks, and of the motions that were found."""
    rows = [["organ", "stacks", "mean mm", "95 % mm", "of one stack", "motion off by, mm", "time of one stack"]]
    organs = list(patients[0].first.surfaces)
    measured = {(organ, count): _measured(patients, organ, count) for organ in organs for count in (1, 2, 3)}
    for organ, names in (*((each, [each]) for each in organs), ("all", organs)):
        for count in (1, 2, 3):
            found, moved, seconds = (np.concatenate(part) for part in zip(*(measured[each, count] for each in names)))
            alone, _, seconds_alone = (np.concatenate(part) for part in zip(*(measured[each, 1] for each in names)))
            motion = f"{np.mean(moved):.2f} (largest {np.max(moved):.2f})" if len(moved) else "-"
            sizes = [f"{found.mean():.3f}", f"{np.mean(np.quantile(found, 0.95, axis=1)):.2f}"]
            shares = [f"{found.mean() / alone.mean():.2f}", motion, f"{seconds.sum() / seconds_alone.sum():.2f}"]
            rows.append([organ, str(count), *sizes, *shares])
    return table(rows)


def _measured(patients: Sequence[Patient], organ: str, count: int) -> tuple[list, list, list]:
    """Distances of all patients' points from the surface, what motions are off by, and seconds."""
    found, moved, seconds = [], [], []
    for each in patients:
        images, points = [stack.image for stack in each.further[: count - 1]], each.points(organ)
        start = time.process_time()
        fit = fitted(each, organ, images)
        seconds.append(time.process_time() - start)
        found.append(errors(fit, points))
        moved += [motion_error(use, s.motion, points) for use, s in zip(fit.stacks, each.further) if use.used]
    return found, moved, seconds


def noiseless() -> str:
    """Make a table of what is left without noise: of the model, not of the images."""
    almost = {"noise": 1e-3}
    clean = Patient(pelvis_phantom(**almost), further_stacks(2, shift_mm=SHIFT_MM, turn_degrees=TURN_DEGREES, **almost))
    rows = [["without noise", "stacks", "mean mm", "outward mm"]]
    for organ in clean.first.surfaces:
        for count in (1, 3):
            fit = fitted(clean, organ, [stack.image for stack in clean.further[: count - 1]])
            away = distances_from(fit.surface, clean.points(organ))
            rows.append([organ, str(count), f"{np.abs(away).mean():.3f}", f"{-away.mean():+.3f}"])
    return table(rows)


def real() -> str:
    """Make a table of the motion between two stacks of a real bladder, looked for from different starts."""
    image, other = (read_image(REAL / f"px0_{name}.nii.gz") for name in ("sag", "tra"))
    rows = [["start, mm", "and degrees", "R, A, S, mm", "sd, mm", "degrees", "sd, degrees", "volume, ml", "apart, mm"]]
    points = None
    for shift, turn in ((0.0, 0.0), (0.0, 2.0), (2.0, 0.0), (-2.0, 2.0)):
        start = rigid_matrix(np.array([0.0, 0.0, np.radians(turn), shift, 0.0, 0.0]), BLADDER)
        fit = finish(fit_organ(image, [BLADDER], further=[Stack(other, motion=start)]))
        points = points_on(fit.surface, N_POINTS) if points is None else points
        (use,) = fit.stacks
        place = ", ".join(f"{each:+.1f}" for each in use.translation_mm)
        sure = [f"{use.translation_sd_mm:.1f}", f"{use.rotation_degrees:.1f}", f"{use.rotation_sd_degrees:.1f}"]
        size = [f"{fit.surface.volume() / 1000.0:.1f}", f"{errors(fit, points).mean():.3f}"]
        rows.append([f"{shift:g}", f"{turn:g}", place, *sure, *size])
    return table(rows)


def hard_stacks(patient: Patient) -> Iterator[tuple[str, Image]]:
    """Make second stacks that are unlike the first one in some way."""
    stack = patient.further[0]
    image, grey = stack.image, stack.image.array.astype(float)
    rng = np.random.default_rng(1)
    half = len(grey) // 2
    yield "inside darker", Image(1200.0 - grey, image.ijk_to_ras)
    yield "another scale", Image(0.013 * grey + 5.0, image.ijk_to_ras)
    yield "lower half", image.crop((0, 0, 0), (half, *grey.shape[1:]))
    yield "upper half", image.crop((half, 0, 0), grey.shape)
    coarse = np.diag([3.0, 3.0, 1.0, 1.0])
    coarse[:2, 3] = 1.0
    means = grey.reshape(len(grey), grey.shape[1] // 3, 3, grey.shape[2] // 3, 3).mean(axis=(2, 4))
    yield "pixels of 1.8 mm", Image(means, image.ijk_to_ras @ coarse)
    yield "axes turned, left-handed", image.canonical()
    yield "five times the noise", Image(grey + rng.normal(0.0, 220.0, grey.shape), image.ijk_to_ras)
    yield "noise alone", Image(rng.normal(300.0, 100.0, grey.shape), image.ijk_to_ras)
    far = image.ijk_to_ras.copy()
    far[2, 3] += 30.0
    yield "moved by 30 mm", Image(image.array, far)
    for percent in (3, 5):
        swollen = {name: _swollen(surface, 1.0 + percent / 100.0) for name, surface in patient.first.surfaces.items()}
        other = {"direction": "axial", "size": (384, 384), "n_slices": 44, "surfaces": swollen}
        yield f"organs {percent} % larger", pelvis_phantom(seed=77, **other).image


def _swollen(surface, factor: float):
    net = surface.control_net
    center = net.reshape(-1, 3).mean(axis=0)
    return surface.with_control_net(center + factor * (net - center))


def hard(patient: Patient) -> str:
    """Make a table of the results with hard stacks."""
    rows = [["second stack", "organ", "alone, mm", "with it, mm", "used"]]
    alone = {organ: errors(fitted(patient, organ, []), patient.points(organ)).mean() for organ in patient.first.seeds}
    for name, image in hard_stacks(patient):
        for organ, before in alone.items():
            fit = fitted(patient, organ, [image])
            (use,) = fit.stacks
            why = "yes" if use.used else use.reason.code
            rows.append([name, organ, f"{before:.3f}", f"{errors(fit, patient.points(organ)).mean():.3f}", why])
    return table(rows)


def cut(patient: Patient) -> str:
    """Make a table of organs that each stack cuts on another side."""
    rows = [["cut organ", "stacks", "all, mm", "where any stack shows it, mm", "share that is shown"]]
    for organ, truth in patient.first.surfaces.items():
        points = patient.points(organ)
        center, extent = truth.control_net.reshape(-1, 3).mean(axis=0), np.ptp(points, axis=0)
        images = [patient.first.image, *(stack.image for stack in patient.further)]
        motions = [np.eye(4), *(stack.motion for stack in patient.further)]
        # To the right, above and in front.
        cuts = [_up_to(image, center + 0.22 * extent * axis) for image, axis in zip(images, np.eye(3)[[0, 2, 1]])]
        seeds = patient.first.seeds[organ]
        seeds = seeds[cuts[0].to_ijk(seeds)[:, 2] < cuts[0].size[2] - 2.0]
        shown = np.zeros(len(points), dtype=bool)
        for count, (image, motion) in enumerate(zip(cuts, motions), start=1):
            ijk = image.to_ijk(points @ motion[:3, :3].T + motion[:3, 3])
            shown |= np.all((ijk > -0.5) & (ijk < image.size - 0.5), axis=1)
            steps = fit_organ(cuts[0], seeds, further=cuts[1:count])
            off = errors(finish(steps), points)
            rows.append([organ, str(count), f"{off.mean():.2f}", f"{off[shown].mean():.3f}", f"{shown.mean():.2f}"])
    return table(rows)


def _up_to(image: Image, point: np.ndarray) -> Image:
    """Part of an image up to the slice of a point."""
    last = int(round(image.to_ijk(point[None])[0, 2]))
    return image.crop((0, 0, 0), (last, *image.array.shape[1:]))


def report(*, quick: bool) -> str:
    """Measure good stacks, hard ones and cut ones."""
    patients = [patient(seed) for seed in range(1 if quick else SEEDS)]
    parts = [_ABOUT, accuracy(patients)]
    if not quick:
        parts += [
            "  A second stack that is unlike the first one; for each organ the mean without it and with it:",
            hard(patients[0]),
            "  Stacks that each cut the organ on another side:",
            cut(patients[0]),
            "  What is left without noise; outward is the mean distance of the surface to the outside:",
            noiseless(),
            "  A sagittal stack of a real bladder with an axial one, the motion looked for from different starts;\n"
            "  apart is the mean distance from the surface of the first row:",
            real() if REAL.is_dir() else "  Skipped: ../shared/data/prostatex is not there.",
        ]
    return "\n\n".join(parts)
