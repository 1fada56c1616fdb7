"""Fits of the generic pelvis to images made by a known map of it, and to real shapes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measuring import table
from scipy import ndimage
from scipy.spatial.transform import Rotation

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.geometry import parametrization
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.region import Region, region_from_mask
from VICRegistrationLib.multipatch.fit import fit_model
from VICRegistrationLib.multipatch.model import MultiPatchModel
from VICRegistrationLib.multipatch.pelvis import pelvis
from VICRegistrationLib.phantoms.organs import pelvic_organs, seeds_inside
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate

N_MAPS, N_POINTS, N_SLICES = 6, 4000, 32
# Gaussian pushes, and how landmarks are placed, mm.
PUSH_REACH, LANDMARK_NOISE = 45.0, 2.0
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "female_pelvis_geometry"
# What the vagina's wall in the labels is closed and opened by before it is filled, mm.
_CLOSED, _OPENED = 3.0, 2.0


@dataclass(frozen=True, eq=False)
class SmoothMap:
    """Smooth local displacements of space, then an affine map; RAS mm.

    Parameters
    ----------
    linear : (3, 3) ndarray
    shift : (3,) ndarray
    centers, pushes : (n, 3) ndarray
        Gaussian displacements.
    """

    linear: np.ndarray
    shift: np.ndarray
    centers: np.ndarray
    pushes: np.ndarray

    @classmethod
    def random(cls, seed: int) -> SmoothMap:
        """Make a map; 0 is the identity."""
        random = np.random.default_rng(seed)
        if seed == 0:
            return cls(np.eye(3), np.zeros(3), np.zeros((1, 3)), np.zeros((1, 3)))
        turn = Rotation.from_rotvec(np.radians(8.0) * random.normal(size=3)).as_matrix()
        linear = turn @ (np.eye(3) + 0.08 * random.normal(size=(3, 3)))
        centers = random.uniform([-40, -60, -60], [40, 60, 60], (6, 3))
        return cls(linear, 10.0 * random.normal(size=3), centers, 6.0 * random.normal(size=(6, 3)))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Map points (..., 3)."""
        squared = np.square(points[..., None, :] - self.centers).sum(axis=-1)
        return (points + np.exp(squared / (-2.0 * PUSH_REACH**2)) @ self.pushes) @ self.linear.T + self.shift

    def surface(self, surface: BSplineSurface) -> BSplineSurface:
        """Map a closed organ."""
        closed = parametrization.closed_organ(surface)
        return closed.deform(closed.fit(self(surface.control_net)))


@dataclass(frozen=True, eq=False)
class Case:
    """A painted pelvis: its true organs, and the regions that were separated."""

    image: Image
    truth: dict[str, BSplineSurface]
    regions: dict[str, Region]


def mapped_case(seed: int) -> tuple[Case, SmoothMap]:
    """Paint the demo's organs after a map, and separate them from the demo's seeds."""
    known = SmoothMap.random(seed)
    truth = {name: known.surface(surface) for name, surface in pelvic_organs().items()}
    phantom = pelvis_phantom(surfaces=truth, seed=seed, n_slices=N_SLICES)
    regions = {name: separate(phantom.image, seeds) for name, seeds in phantom.seeds.items()}
    return Case(phantom.image, truth, regions), known


def real_case() -> Case:
    """Paint bladder and vagina of a body, as smooth surfaces with the first net, filled; their regions are given."""
    labels = read_image(REAL / "vhf_organs_label_0p5mm.nii.gz")
    truth = {}
    for name, label in (("bladder", 1), ("vagina", 3)):
        mask = np.pad(labels.array == label, 20)
        if name == "vagina":
            mask = _filled(mask, labels.spacing.min())
        matrix = labels.ijk_to_ras.copy()
        # To the phantom's place.
        matrix[:3, 3] += matrix[:3, :3] @ np.full(3, -20.0) - (13.0, -45.0, 0.0)
        grey = Image(ndimage.gaussian_filter(1000.0 * mask, 1.0), matrix)
        truth[name] = finish(
            fit_region(grey, region_from_mask(grey, grey.array > 500.0), FitOptions(net=(9, 7)))
        ).surface
    image = pelvis_phantom(surfaces=truth).image
    regions = {}
    for name, surface in truth.items():
        mesh = triangulate(surface, chord_error=0.1)
        shares = volume_fractions(mesh.points, mesh.triangles, image.array.shape, image.ijk_to_ras)
        regions[name] = region_from_mask(image, shares > 0.5)
    return Case(image, truth, regions)


def _filled(mask: np.ndarray, voxel: float) -> np.ndarray:
    """Close a wall, fill what is inside of it in axial slices, and take thin rims away."""
    away = ndimage.distance_transform_edt
    closed = away(away(~mask) <= _CLOSED / voxel) > _CLOSED / voxel
    filled = np.array([ndimage.binary_fill_holes(part) for part in closed])
    return away(~(away(filled) > _OPENED / voxel)) <= _OPENED / voxel


@dataclass(frozen=True)
class Measured:
    """Results of one case: errors of organs fitted together and alone, of the parts and of the map, and CPU seconds."""

    together: dict[str, tuple[float, float]]
    alone: dict[str, float]
    parts: dict[str, tuple[float, float]]
    determinant: float
    predicted: float
    seconds: float
    seconds_alone: float


def measured(seed: int, model: MultiPatchModel) -> Measured:
    """Fit the model to one case: with and without landmarks, without the rectum; and each organ alone."""
    case, known = mapped_case(seed)
    start = time.process_time()
    found = finish(fit_model(case.image, model, case.regions))
    seconds = time.process_time() - start
    start = time.process_time()
    alone = {name: finish(fit_region(case.image, region)).surface for name, region in case.regions.items()}
    seconds_alone = time.process_time() - start
    random = np.random.default_rng(seed)
    marks = {name: known(point) + LANDMARK_NOISE * random.normal(size=3) for name, point in model.landmarks.items()}
    held = finish(fit_model(case.image, model, case.regions, landmarks=marks))
    regions = {name: region for name, region in case.regions.items() if name != "rectum"}
    without = finish(fit_model(case.image, model, regions))
    off = {name: deviation(fit.surface, case.truth[name], n_points=N_POINTS) for name, fit in found.organs.items()}
    first, second = (_parts(fit.model, model, known) for fit in (found, held))
    return Measured(
        {name: (part.mean, part.maximum) for name, part in off.items()},
        {name: deviation(surface, case.truth[name], n_points=N_POINTS).mean for name, surface in alone.items()},
        {part: (first[part], second[part]) for part in first},
        found.smallest_determinant[0],
        deviation(without.model.parents["rectum"], case.truth["rectum"], n_points=N_POINTS).mean,
        seconds,
        seconds_alone,
    )


def _parts(carried: MultiPatchModel, model: MultiPatchModel, known: SmoothMap) -> dict[str, float]:
    """Mean error of the control points of parts that no image shows, against the known map, mm."""
    off = np.linalg.norm(carried.points - known(model.points), axis=1)
    found = {}
    for part in model.parts:
        if part.kind != "organ":
            found[part.name] = float(off[model.indices_of(part.name)].mean())
    return found


def _range(values) -> str:
    return f"{min(values):.2f} to {max(values):.2f}"


def report(*, quick: bool) -> str:
    """Measure the demo and maps of it, real shapes, and the fine model."""
    model = pelvis()
    cases = [measured(seed, model) for seed in range(1 if quick else N_MAPS + 1)]
    organs = [["organ", "mean mm", "worst point mm", "alone, mean mm", "most together / alone"]]
    for name in cases[0].together:
        means, worst = zip(*(case.together[name] for case in cases))
        alone = [case.alone[name] for case in cases]
        most = max(a / b for a, b in zip(means, alone))
        organs.append([name, _range(means), f"{max(worst):.2f}", _range(alone), f"{most:.2f}"])
    parts = [["part", "mean mm", "with landmarks, mean mm"]]
    for part in cases[0].parts:
        both = zip(*(case.parts[part] for case in cases))
        parts.append([part, *(_range(values) for values in both)])
    values = {
        "smallest determinant of the map": f"{min(case.determinant for case in cases):.2f}",
        "rectum predicted, mean mm": _range([case.predicted for case in cases]),
        "CPU seconds of three organs": _range([case.seconds for case in cases]),
        "times those of three single fits": _range([case.seconds / case.seconds_alone for case in cases]),
    }
    more = [["whole model", ""], *map(list, values.items())]
    about = (
        f"  The demo and {len(cases) - 1} maps of it: turns of 8 degrees and shears of 8 % (standard deviations), six "
        f"pushes of 6 mm along each axis,\n  fading over {PUSH_REACH:g} mm. Six landmarks, placed to "
        f"{LANDMARK_NOISE:g} mm. Slices of 4 mm, noise of 5 %."
    )
    return "\n\n".join([about, *(table(rows) for rows in (organs, parts, more, _fine(), _real()))])


def _fine() -> list[list[str]]:
    """Fit the fine model to the demo."""
    case, _ = mapped_case(0)
    model = pelvis(fine=True)
    start = time.process_time()
    found = finish(fit_model(case.image, model, case.regions))
    seconds = time.process_time() - start
    rows = [["fine model, organ", "mean mm", "CPU seconds of all"]]
    for name, fit in found.organs.items():
        off = deviation(fit.surface, case.truth[name], n_points=N_POINTS).mean
        rows.append([name, f"{off:.2f}", f"{seconds:.1f}"])
    return rows


def _real() -> list[list[str]]:
    """Fit the model to real shapes, of which the rectum is missing."""
    rows = [["real shape", "mean mm", "95 % mm", "volume ml", "volume off %", "alone, mean mm", "determinant"]]
    if not REAL.is_dir():
        return [*rows, ["Skipped: there is no folder ../shared/data", *[""] * 6]]
    case = real_case()
    separated = {name: separate(case.image, seeds_inside(surface)) for name, surface in case.truth.items()}
    for regions, how in ((case.regions, ""), (separated, ", by seeds")):
        found = finish(fit_model(case.image, pelvis(), regions))
        for name, fit in found.organs.items():
            truth = case.truth[name]
            off = deviation(fit.surface, truth, n_points=N_POINTS)
            alone = deviation(finish(fit_region(case.image, regions[name])).surface, truth, n_points=N_POINTS)
            volume = fit.surface.volume()
            more = 100.0 * (volume / truth.volume() - 1.0)
            numbers = [f"{off.mean:.2f}", f"{off.p95:.2f}", f"{volume / 1000.0:.1f}", f"{more:+.1f}"]
            rows.append([f"{name}{how}", *numbers, f"{alone.mean:.2f}", f"{found.smallest_determinant[0]:.2f}"])
    return rows
