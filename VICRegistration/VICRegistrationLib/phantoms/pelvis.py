"""A synthetic sagittal T2-weighted MRI of a female pelvis whose organs are known exactly."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from ..export.mesh_files import write_vtp
from ..files import write_json
from ..geometry.surface import BSplineSurface
from ..geometry.surface_file import write_surface
from ..geometry.triangulation import triangulate
from ..geometry.volume_fractions import volume_fractions
from ..imaging.image import Image
from ..imaging.reading import write_image
from . import organs, painting

AIR, MUSCLE, FAT, WALL = 0.0, 220.0, 550.0, 170.0
LUMEN_LEVELS = {"bladder": 900.0, "vagina": 830.0, "rectum": 800.0}
WALL_MM = {"bladder": 3.5, "vagina": 3.0, "rectum": 3.5}
CONFIG_SCHEMA, CONFIG_VERSION = "vic-registration/organs", 1

# Rotation of the slices about S, A and R, degrees, because patients never lie quite straight.
_OBLIQUE = (4.0, -3.0, 2.0)
_POINT_SPREAD_PIXELS = 0.6
# Columns are the directions of i, j and k.
_DIRECTIONS = {
    "sagittal": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "axial": ((1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "coronal": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
_SUBCUTANEOUS_FAT_MM = 22.0
# Painted in this order: tube, thickness of its wall (mm), grey levels of wall and inside.
_SURROUNDINGS = (
    (organs.SACRUM, 2.0, 110.0, 330.0),
    (organs.SYMPHYSIS, 2.0, 90.0, 300.0),
    (organs.UTERUS, 9.0, 330.0, 480.0),
)


@dataclass(frozen=True, eq=False)
class PelvisPhantom:
    """A synthetic MRI with its true surfaces.

    Parameters
    ----------
    image : Image
        int16 grey levels; i runs to the back, j to the feet, k to the right.
    surfaces : dict of str to BSplineSurface
        True surface of each organ's lumen, RAS mm.
    seeds : dict of str to (n, 3) ndarray
        Points inside each lumen, RAS mm.
    """

    image: Image
    surfaces: dict[str, BSplineSurface]
    seeds: dict[str, np.ndarray]


def pelvis_phantom(
    *,
    seed: int = 0,
    noise: float = 0.05,
    bias: float = 0.2,
    spacing: tuple[float, float, float] = (0.59, 0.59, 4.0),
    size: tuple[int, int] = (512, 512),
    n_slices: int = 28,
    surfaces: dict[str, BSplineSurface] | None = None,
    direction: str = "sagittal",
    motion: np.ndarray | None = None,
) -> PelvisPhantom:
    """Paint a T2-weighted MRI of a pelvis with a filled bladder and gel in vagina and rectum.

    Parameters
    ----------
    seed : int
        Seed of the random texture and noise; the organs do not depend on it.
    noise : float
        Standard deviation of the noise in each of the two channels, as a fraction of the level of urine.
    bias : float
        Relative gain of the coil at the front of the body: 0.2 is 20 % brighter than far away.
    spacing : (float, float, float)
        Pixel size to the back and to the feet, and distance of the slices (as thick as they are far apart), mm.
    size : (int, int)
        Number of pixels to the back and to the feet.
    n_slices : int
        Number of slices from left to right.
    surfaces : dict of str to BSplineSurface, optional
        Other lumens of these organs, RAS mm, closed; any of them may be left out.
    direction : {"sagittal", "axial", "coronal"}
        Plane of the slices. Size and spacing are along the pixel directions of that plane, and the slices' normal.
    motion : (4, 4) ndarray, optional
        Rigid motion of the patient before the scan, RAS mm. Surfaces and seeds are those before the motion.

    Returns
    -------
    PelvisPhantom

    Raises
    ------
    ValueError
        If an organ does not end inside the field of view.

    Notes
    -----
    Levels before bias and noise: urine 900, gel 830 and 800, walls 170 and 3 to 3.5 mm thick, fat about 550, muscle
    about 220, air 0. Slice profile and pixels are boxes, which give the partial volumes; the point spread in the plane
    is a Gaussian of 0.6 pixels.
    """
    surfaces = surfaces or organs.pelvic_organs()
    shape = (int(n_slices), int(size[1]), int(size[0]))
    matrix = _slices_matrix(surfaces, shape, spacing, direction)
    patient = matrix if motion is None else np.linalg.inv(motion) @ matrix
    _check_field_of_view(surfaces, shape, patient)
    array = _surroundings(shape, patient, seed)
    array = painting.paint(array, _layers(surfaces, shape, patient))
    array = ndimage.gaussian_filter(array, (0.0, _POINT_SPREAD_PIXELS, _POINT_SPREAD_PIXELS))
    array = painting.add_coil_bias(array, matrix, strength=bias, center=(0.0, 110.0, 10.0), width=90.0)
    array = painting.add_rician_noise(array, sigma=noise * LUMEN_LEVELS["bladder"], seed=seed)
    seeds = {name: organs.seeds_inside(surface) for name, surface in surfaces.items()}
    return PelvisPhantom(Image(np.rint(array).astype(np.int16), matrix), surfaces, seeds)


def write_phantom(phantom: PelvisPhantom, directory: str | os.PathLike, *, also: Sequence[str] = ()) -> None:
    """Write the image, the true surfaces, and a configuration with the seeds for a fit.

    Parameters
    ----------
    phantom : PelvisPhantom
    directory : path
        Is made if it does not exist. The files are ``mri.nii.gz``, ``organs.json``, and the true surfaces as
        ``truth/NAME.json`` and, for Slicer, ``truth/NAME.vtp``.
    also : sequence of str
        Names of files of further stacks in that folder, for the configuration.

    Raises
    ------
    OSError
        If the folder cannot be made or written to.
    """
    directory = Path(directory)
    truth = directory / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    write_image(phantom.image, directory / "mri.nii.gz")
    for name, surface in phantom.surfaces.items():
        net = "{}x{}".format(*organs.TRUE_NET)
        write_surface(surface, truth / f"{name}.json", name=name, net=net, closure="smooth")
        write_vtp(triangulate(surface), surface, truth / f"{name}.vtp", name=name)
    config = {
        "schema": CONFIG_SCHEMA,
        "version": CONFIG_VERSION,
        **({"also": list(also)} if also else {}),
        "organs": [{"organ": name, "seed": seeds.round(2).tolist()} for name, seeds in phantom.seeds.items()],
    }
    write_json(directory / "organs.json", config)


def _slices_matrix(surfaces, shape, spacing, direction) -> np.ndarray:
    """Affine matrix (4, 4) of a field of view around the organs."""
    axes = np.array(_DIRECTIONS[direction], dtype=float)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("zyx", _OBLIQUE, degrees=True).as_matrix() @ axes * np.asarray(spacing)
    points = np.concatenate([surface.control_net.reshape(-1, 3) for surface in surfaces.values()])
    center = (points.min(axis=0) + points.max(axis=0)) / 2.0
    matrix[:3, 3] = center - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    return matrix


def _check_field_of_view(surfaces, shape, matrix) -> None:
    """Refuse organs that, with their walls, are not inside the image."""
    inverse = np.linalg.inv(matrix)
    last = np.array(shape[::-1]) - 1
    for name, surface in surfaces.items():
        points, _ = organs.shell(surface, WALL_MM[name], chord_error=0.5)
        ijk = points @ inverse[:3, :3].T + inverse[:3, 3]
        if np.any(ijk < 0) or np.any(ijk > last):
            extent = np.linalg.norm(matrix[:3, :3], axis=0) * (last + 1)
            msg = (
                f"The field of view of {extent[0]:.0f} x {extent[1]:.0f} mm and {extent[2]:.0f} mm of slices cuts the "
                f"{name}; every organ must end inside it; use more or larger pixels or slices."
            )
            raise ValueError(msg)


def _layers(surfaces, shape, matrix):
    """Yield layers for `paint`: pairs of fraction and level, all walls before all lumens."""

    def fraction(surface, thickness=0.0):
        return volume_fractions(*organs.shell(surface, thickness), shape, matrix)

    for tube, thickness, outer, inner in _SURROUNDINGS:
        surface = organs.organ_surface(tube)
        yield fraction(surface, thickness), outer
        yield fraction(surface), inner
    for name, surface in surfaces.items():
        yield fraction(surface, WALL_MM[name]), WALL
    for name, surface in surfaces.items():
        yield fraction(surface), LUMEN_LEVELS[name]


def _surroundings(shape, matrix, seed) -> np.ndarray:
    """Fat and muscle inside the outline of the body, air outside."""
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    seeds = np.random.SeedSequence(seed).generate_state(2).tolist()
    coarse = painting.smooth_random_field(shape, spacing, correlation_mm=max(9.0, spacing.min()), seed=seeds[0])
    fine = painting.smooth_random_field(shape, spacing, correlation_mm=max(2.5, spacing.min()), seed=seeds[1])
    depth = _depth_under_skin(shape, matrix)
    # Fat under the skin with varying thickness, and bundles of muscle in fat below it.
    under_skin = _step((_SUBCUTANEOUS_FAT_MM + 4.0 * coarse - depth) / 2.0)
    fat = np.maximum(under_skin, _step(2.5 * coarse + 0.5 * fine - 0.3))
    tissue = MUSCLE + (FAT - MUSCLE) * fat + 22.0 * fine
    return AIR + (tissue - AIR) * np.clip(depth / spacing[0] + 0.5, 0.0, 1.0)


def _depth_under_skin(shape, matrix) -> np.ndarray:
    """Approximate depth of each voxel under the belly or the back, mm, negative in air: (nk, nj, ni) float32."""
    k, j, i = np.ogrid[tuple(slice(n) for n in shape)]
    _, anterior, superior = (
        (row[0] * i + row[1] * j).astype(np.float32) + (row[2] * k + row[3]).astype(np.float32) for row in matrix[:3]
    )
    belly = 88.0 + 14.0 * np.sin(superior / 45.0) - 45.0 * _step((-superior - 85.0) / 10.0)
    back = -98.0 + 16.0 * np.sin((superior + 10.0) / 40.0)
    return np.minimum(belly - anterior, anterior - back)


def _step(x: np.ndarray) -> np.ndarray:
    """Step smoothly from 0 to 1."""
    return 0.5 + 0.5 * np.tanh(0.5 * x)
