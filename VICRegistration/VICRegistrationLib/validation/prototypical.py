"""Section 2.3 of the paper: a bell-like surface is transformed and then registered to its own image.

The paper does not say how large its bell is in the 100 mm image, what the image shows below the bell's open rim, or how
strong the Gaussian smoothing is. Here the bell is 50 mm large and in the middle of the image, its wall is continued
straight down below the rim, and the smoothing is 0.5 mm (standard deviation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..geometry import models
from ..geometry.parametrization import affine, affine_matrix
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from ..registration.sample_grid import SampledSurface, SampleGrid
from ..registration.stages import Stage, Step, run_stage
from ..registration.steps import finish
from ..registration.virtual_image import IntensityProfile, VirtualImage

IMAGE_MM = 100.0
BELL_MM = 50.0
RAMP_MM = 6.0
SMOOTHING_MM = 0.5
PROFILE = IntensityProfile(inside=1.0, outside=0.0, width=RAMP_MM)

_TILT = np.deg2rad(20.0)


@dataclass(frozen=True, eq=False)
class PrototypicalTest:
    """One of the paper's three tests.

    Parameters
    ----------
    name : str
    imposed : (4, 4) ndarray
        Affine matrix that maps the bell to the start model, mm.
    free : tuple of str
        Free parameters of equation 2.
    paper_errors : tuple of float
        Absolute errors of table 1 at 100^3, in the order of `free`.
    """

    name: str
    imposed: np.ndarray
    free: tuple[str, ...]
    paper_errors: tuple[float, ...]

    @property
    def theory(self) -> np.ndarray:
        """Values of the free parameters that undo the imposed transformation, in the order of `free`."""
        return parameters_in(np.linalg.inv(self.imposed), self.free)


def parameters_in(matrix: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return the parameters of equation 2 with given names, such as R01 or T2, of a 4x4 matrix."""
    return np.array([matrix[int(name[1]), int(name[2]) if name[0] == "R" else 3] for name in names])


def _imposed(linear: np.ndarray, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, shift
    return matrix


TESTS = (
    PrototypicalTest("scaling", _imposed(np.diag([2.0, 2.0, 1.5])), ("R00", "R11", "R22"), (0.02, 0.02, 0.03)),
    PrototypicalTest("translation", _imposed(np.eye(3), (-10.0, -15.0, 10.0)), ("T0", "T1", "T2"), (0.64, 0.01, 1.21)),
    PrototypicalTest(
        "scaling + rotation",
        _imposed(
            [
                [1.5, 0.0, 0.0],
                [0.0, 1.5 * np.cos(_TILT), -1.2 * np.sin(_TILT)],
                [0.0, 1.5 * np.sin(_TILT), 1.2 * np.cos(_TILT)],
            ]
        ),
        ("R00", "R01", "R02", "R10", "R11", "R12", "R20", "R21", "R22"),
        (0.01, 0.01, 0.04, 0.00, 0.03, 0.01, 0.05, 0.02, 0.04),
    ),
)


def prototypical_image(n: int) -> Image:
    """Make the image of the bell: n^3 voxels over 100 mm, grey levels from 1 inside to 0 outside over 6 mm, smoothed.

    Parameters
    ----------
    n : int
        Voxels along each axis; the paper uses 100 and 200.

    Returns
    -------
    Image
        Centred at the origin of RAS.
    """
    coarse = _grid(25)
    rough = Image(_distances(coarse.to_ras(_indices(coarse))).reshape(coarse.array.shape), coarse.ijk_to_ras)
    image = _grid(n)
    grey = np.empty(image.array.shape)
    for k in range(n):
        points = image.to_ras(_indices(image, k))
        distance, _ = Sampler(rough).values(points)
        # The rough distances are used only where they are beyond the ramp by a coarse voxel or more.
        near = np.abs(distance) < RAMP_MM / 2.0 + IMAGE_MM / 25.0
        distance[near] = _distances(points[near])
        grey[k] = PROFILE.value(distance).reshape(n, n)
    return _blurred(Image(grey, image.ijk_to_ras), SMOOTHING_MM)


def _grid(n: int) -> Image:
    """Make an empty image of n^3 voxels over the 100 mm, centred at the origin."""
    matrix = np.diag([IMAGE_MM / n] * 3 + [1.0])
    matrix[:3, 3] = -(n - 1) / 2.0 * IMAGE_MM / n
    return Image(np.zeros((n, n, n), dtype=np.uint8), matrix)


def _indices(image: Image, k: int | None = None) -> np.ndarray:
    """List the indices (i, j, k) of all voxels, or of those of one slice, (n, 3)."""
    n = len(image.array)
    slices = np.arange(n) if k is None else np.array([k])
    k, j, i = np.meshgrid(slices, np.arange(n), np.arange(n), indexing="ij")
    return np.column_stack([i.ravel(), j.ravel(), k.ravel()])


@lru_cache(maxsize=1)
def _bell_samples() -> tuple[cKDTree, np.ndarray, np.ndarray]:
    """Points and normals of the bell, 0.3 mm apart, and a tree of the points."""
    bell = models.bell(BELL_MM)
    u, v = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 500), np.linspace(0, 1, 250), indexing="ij"))
    points = bell.points(u, v)
    return cKDTree(points), points, bell.normals(u, v)


def _distances(points: np.ndarray) -> np.ndarray:
    """Signed distances (n,) of points (n, 3) from the bell and its straight continuation below the rim, mm.

    They are measured along the normal of the nearest sample; near the surface the error is up to 0.002 mm.
    """
    tree, surface_points, normals = _bell_samples()
    points = points * [1.0, 1.0, 0.0] + np.maximum(points[:, 2:], -BELL_MM / 2.0) * [0.0, 0.0, 1.0]
    nearest = tree.query(points, workers=-1)[1]
    return np.einsum("nk,nk->n", points - surface_points[nearest], normals[nearest])


def run_test(test: PrototypicalTest, image: Image, *, solver: str = "gauss-newton") -> tuple[np.ndarray, list[Step]]:
    """Register the start model of a test.

    Parameters
    ----------
    test : PrototypicalTest
    image : Image
        From :func:`prototypical_image`.
    solver : {"gauss-newton", "gradient-descent"}

    Returns
    -------
    values : (n_free,) ndarray
        Free parameters of equation 2 after the registration, in the order of ``test.free``.
    history : list of Step
    """
    start = models.bell(BELL_MM).transformed(test.imposed)
    grid = SampleGrid.on(start, (32, 16))
    whole = np.eye(4)
    surface, history = start, []
    for stage in _plan(image, solver):
        moving = affine(surface, free=test.free, center=np.zeros(3))
        found = finish(run_stage(stage, SampledSurface(moving, grid)), history.append)
        whole = affine_matrix(found, free=test.free) @ whole
        surface = history[-1].surface
    return parameters_in(whole, test.free), history


def _plan(image: Image, solver: str) -> list[Stage]:
    """Make the stages: the image is blurred and the ramp wide in the first, both less in the next ones."""
    stages = []
    for blur, width in ((10.0, 40.0), (5.0, 20.0), (2.0, 10.0), (0.0, RAMP_MM)):
        last = blur == 0.0
        sampler = Sampler(_blurred(image, blur) if blur else image)
        stages.append(
            Stage(
                f"{blur:g} mm blur",
                sampler,
                VirtualImage(replace(PROFILE, width=width), mode="given"),
                solver=solver,
                n_depths=13,
                stop_rule="parameters",
                tolerance=1e-4 if last else 0.01,
                max_iterations=300,
                largest_step=20.0,
            )
        )
    return stages


@lru_cache(maxsize=3)
def _blurred(image: Image, sigma_mm: float) -> Image:
    """Blur an image by a Gaussian, isotropic in mm; cached, because all tests use the same images."""
    blurred = ndimage.gaussian_filter(image.array.astype(np.float32), sigma_mm / image.spacing[::-1], mode="nearest")
    return Image(blurred, image.ijk_to_ras)
