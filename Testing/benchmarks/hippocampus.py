"""An organ outside of the pelvis: hippocampi in brain MRI of weak contrast, started from a box only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measuring import table

from VICRegistrationLib.analysis.comparison import distances_from
from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.analysis.reference_meshes import mesh_of_mask
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import fill_holes
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.region import Region, region_from_mask
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.organ_fit import OrganFit
from VICRegistrationLib.registration.steps import finish

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "hippocampus"
NAMES = ("001", "004", "006")


@dataclass(frozen=True, eq=False)
class Hippocampus:
    """An image, the label of both halves (its largest piece, holes filled) and the ellipsoid in the label's box."""

    name: str
    image: Image
    label: Region
    box: Region


def ellipsoid_in_box(image: Image, corners: np.ndarray) -> Region:
    """Ellipsoid in the box between two opposite corners (2, 3), RAS mm, as a region to start a fit from."""
    k, j, i = np.indices(image.array.shape)
    places = image.to_ras(np.stack([i, j, k], axis=-1))
    away = (places - np.mean(corners, axis=0)) / (np.ptp(corners, axis=0) / 2.0)
    return region_from_mask(image, np.einsum("...k,...k->...", away, away) <= 1.0)


def load_hippocampus(name: str, folder: Path = DATA) -> Hippocampus:
    """Read one of the images."""
    image = read_image(folder / f"{name}_t1.nii.gz")
    label = region_from_mask(image, read_image(folder / f"{name}_label.nii.gz").array, largest_component=True)
    label = replace(label, mask=fill_holes(label.mask))
    return Hippocampus(name, image, label, ellipsoid_in_box(image, box_of(label)))


def hippocampi(folder: Path = DATA) -> list[Hippocampus]:
    """All of them; none where the data is absent."""
    return [load_hippocampus(name, folder) for name in NAMES if (folder / f"{name}_t1.nii.gz").exists()]


def box_of(label: Region) -> np.ndarray:
    """Two corners of the box of a label along R, A and S, with the whole of its outer voxels, (2, 3) mm."""
    voxels = np.argwhere(label.mask)[:, ::-1]
    low, high = voxels.min(axis=0) - 0.5, voxels.max(axis=0) + 0.5
    corners = np.stack(np.meshgrid(*zip(low, high)), axis=-1).reshape(-1, 3)
    ras = label.image.to_ras(corners)
    return np.array([ras.min(axis=0), ras.max(axis=0)])


def farthest_from_start(fit: OrganFit) -> float:
    """Largest distance of a surface from the region that it started from, mm."""
    return float(np.abs(distances_from(mesh_of_mask(fit.region.image), fit.confidence.points.reshape(-1, 3))).max())


def row(case: Hippocampus, start: str, region: Region) -> list[str]:
    """Fit from a region: one line of the table."""
    fit = finish(fit_region(case.image, region))
    reference = mesh_of_mask(case.label.image)
    found, confidence = deviation(fit.surface, reference), fit.confidence
    errors = np.abs(distances_from(reference, confidence.points.reshape(-1, 3)))
    covered = confidence.areas.ravel() @ (errors <= 2.0 * confidence.deviations.ravel()) / confidence.areas.sum()
    return [
        f"{case.name}, from its {start}",
        f"{found.mean:.2f}",
        f"{found.p95:.2f}",
        f"{found.mean_signed:+.2f}",
        ", ".join(problem.kind for problem in fit.problems) or "none",
        f"{farthest_from_start(fit):.1f}",
        f"{np.median(confidence.deviations):.1f}",
        f"{covered:.0%}",
        f"{confidence.unsupported_share:.0%}",
        "{}x{}".format(*fit.options.net),
    ]


def report(*, quick: bool) -> str:
    """Fit from the box of the label, and from the label itself to compare with."""
    cases = hippocampi()
    if not cases:
        return "  Skipped: ../shared/data/hippocampus is not there."
    rows = [
        ["case", "mean mm", "95 % mm", "signed mm", "problems", "farthest mm", "sd mm", "within 2 sd", "no edge", "net"]
    ]
    for case in cases[:1] if quick else cases:
        rows += [row(case, "box", case.box), row(case, "label", case.label)]
    return (
        "  Deviation from the label of voxels of 1 mm, default options. Farthest: of the surface from the region "
        "it started\n  from. sd: the median of the fit's standard deviations; within 2 sd: share of its area "
        "that is no farther\n  from the label; no edge: share that follows none.\n\n" + table(rows)
    )
