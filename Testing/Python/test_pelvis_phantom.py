"""The synthetic pelvic MRI shows organs that are valid, apart, and exactly where the truth says."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from VICRegistrationLib.cli.configuration import read_requests
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.phantoms import organs
from VICRegistrationLib.phantoms.pelvis import LUMEN_LEVELS, WALL, WALL_MM, pelvis_phantom, write_phantom
from VICRegistrationLib.segmentation.separation import separate

SMALL = {"spacing": (0.8, 0.8, 3.0), "size": (180, 180), "n_slices": 34}
COARSE = {"spacing": (1.5, 1.5, 4.0), "size": (96, 96), "n_slices": 26}
NAMES = ("bladder", "vagina", "rectum")


@pytest.fixture(scope="module")
def surfaces():
    return organs.pelvic_organs()


@pytest.fixture(scope="module")
def meshes(surfaces):
    return {name: triangulate(surface, chord_error=0.02) for name, surface in surfaces.items()}


@pytest.fixture(scope="module")
def clean():
    """A phantom without noise and bias."""
    return pelvis_phantom(noise=0.0, bias=0.0, **SMALL)


@pytest.fixture(scope="module")
def coarse():
    return pelvis_phantom(**COARSE)


@pytest.fixture(scope="module")
def noise_free():
    """The coarse phantom before the noise, with the coil's bias."""
    return pelvis_phantom(noise=0.0, **COARSE)


def volume_and_centroid(mesh):
    """Volume in mm^3 and centroid in RAS mm by the divergence theorem."""
    corners = mesh.points[mesh.triangles]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    return volumes.sum(), (volumes[:, None] * corners.sum(axis=1) / 4.0).sum(axis=0) / volumes.sum()


def in_plane(mesh, image):
    """Vertices where the surface is cut across by the slices, so that thick slices do not blur its edge."""
    slice_normal = image.ijk_to_ras[:3, 2] / image.spacing[2]
    return np.abs(mesh.normals @ slice_normal) < 0.2


# ---------------------------------------------------------------------- organs


@pytest.mark.parametrize("name", NAMES)
def test_true_surfaces_bound_a_solid(surfaces, name):
    assert check_surface(surfaces[name]) == ()
    assert surfaces[name].volume() > 0.0  # negative if the normals pointed inward


@pytest.mark.parametrize(
    ("name", "millilitres", "extent"),
    [("bladder", (100, 150), (76, 63, 57)), ("vagina", (12, 22), (27, 32, 77)), ("rectum", (30, 50), (29, 37, 91))],
)
def test_organs_have_the_size_of_real_ones(surfaces, meshes, name, millilitres, extent):
    low, high = millilitres
    assert low < surfaces[name].volume() / 1000.0 < high
    # R, A and S extent in mm; the shapes are part of what the results in the documentation rest on.
    assert np.ptp(meshes[name].points, axis=0) == pytest.approx(extent, abs=1.0)


@pytest.mark.parametrize(("one", "other"), [("bladder", "vagina"), ("vagina", "rectum"), ("bladder", "rectum")])
def test_organs_are_apart(meshes, one, other):
    distances, _ = cKDTree(meshes[other].points).query(meshes[one].points)
    # Room for a wall of some seven pixels, and no organ within another.
    assert distances.min() > 4.0


def test_the_truth_lies_outside_the_space_of_the_fitted_net(surfaces):
    fitted = closed_organ((9, 7))
    for surface in surfaces.values():
        # A fitted spline is smooth across knots that it does not have, and so cannot follow these.
        assert not np.isin(np.round(surface.knots_v, 9), np.round(fitted.knots_v, 9)).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_shell_lies_at_its_thickness_from_the_surface(surfaces, meshes, name):
    points, _ = organs.shell(surfaces[name], 3.0)
    distances, _ = cKDTree(meshes[name].points).query(points)
    # Never farther than along the normal, but for what keeps the volume; nearer only where the tree's vertices would be
    # closer in a hollow.
    assert distances.max() < 3.01
    assert distances.min() > 2.9


@pytest.mark.parametrize("name", NAMES)
def test_what_is_painted_has_the_volume_of_the_surface(surfaces, clean, name):
    image = clean.image
    shares = volume_fractions(*organs.shell(surfaces[name]), image.array.shape, image.ijk_to_ras)
    painted = shares.sum(dtype=float) * np.prod(image.spacing)
    # Places in voxels are counted, which is within 0.02 %; triangles with their corners on the surface miss 0.05 to
    # 0.13 %.
    assert painted == pytest.approx(surfaces[name].volume(), rel=3e-4)


# ---------------------------------------------------------------------- image


@pytest.mark.parametrize("name", NAMES)
def test_the_bright_region_is_the_true_organ(clean, meshes, name):
    half_level = (LUMEN_LEVELS[name] + WALL) / 2.0
    region = separate(clean.image, clean.seeds[name], threshold=(half_level, 2000.0), erosion=1.0)
    volume, centroid = volume_and_centroid(meshes[name])
    # Voxels of 1.9 mm^3 taken or left as a whole: the thin vagina is 0.8 % off, the others less.
    assert region.volume_ml == pytest.approx(volume / 1000.0, rel=0.015)
    found = region.image.to_ras(np.argwhere(region.mask)[:, ::-1]).mean(axis=0)
    # A quarter of a pixel: an image moved by half a voxel, turned or mirrored would be farther off.
    assert found == pytest.approx(centroid, abs=0.2)


@pytest.mark.parametrize("name", NAMES)
def test_every_organ_ends_inside_the_field_of_view(pelvis, name):
    threshold = (LUMEN_LEVELS[name] + WALL) / 2.0 * 1.05, 2000.0
    assert separate(pelvis.image, pelvis.seeds[name], threshold=threshold, erosion=2.0).touches_border == ()


@pytest.mark.parametrize("name", NAMES)
def test_seeds_lie_in_the_bright_inside(clean, meshes, name):
    seeds = clean.seeds[name]
    assert seeds.shape == (3, 3)
    values, valid = Sampler(clean.image).values(seeds)
    assert valid.all()
    assert values == pytest.approx(LUMEN_LEVELS[name], abs=1.0)
    # Deep enough for an erosion of 2 mm, which is the default of the separation.
    distances, _ = cKDTree(meshes[name].points).query(seeds)
    assert distances.min() > 4.0


@pytest.mark.parametrize("name", NAMES)
def test_lumen_and_wall_have_their_levels(clean, meshes, name):
    mesh, sampler = meshes[name], Sampler(clean.image)
    chosen = in_plane(mesh, clean.image)
    points, normals = mesh.points[chosen], mesh.normals[chosen]
    lumen, _ = sampler.values(points - 3.0 * normals)
    wall, _ = sampler.values(points + WALL_MM[name] / 2.0 * normals)
    assert np.median(lumen) == pytest.approx(LUMEN_LEVELS[name], abs=1.0)
    # Half a wall away from either edge, the point spread and the pixels leave some grey levels.
    assert np.median(wall) == pytest.approx(WALL, abs=10.0)


def test_axes_are_those_of_a_slightly_turned_sagittal_image(pelvis):
    image = pelvis.image
    assert image.array.dtype == np.int16
    assert image.array.shape == (28, 512, 512)
    assert image.spacing == pytest.approx([0.59, 0.59, 4.0])
    directions = image.ijk_to_ras[:3, :3] / image.spacing
    assert directions.T @ directions == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(directions) == pytest.approx(1.0)
    back, feet, right = directions.T
    turned = [back @ [0, -1, 0], feet @ [0, 0, -1], right @ [1, 0, 0]]
    assert min(turned) > np.cos(np.radians(6.0))
    assert max(turned) < np.cos(np.radians(1.0))


def test_noise_has_the_stated_deviation(coarse, noise_free):
    lumen = separate(noise_free.image, coarse.seeds["bladder"], threshold=(890.0, 1200.0), erosion=2.0)
    k, j, i = (np.argwhere(lumen.mask) + lumen.offset).T
    noise = coarse.image.array[k, j, i] - noise_free.image.array[k, j, i]
    # 5 % of urine; some 13 000 voxels give the deviation within 0.6 % (one standard error).
    assert noise.std() == pytest.approx(45.0, rel=0.025)


def test_the_coil_brightens_the_front(noise_free):
    even = pelvis_phantom(noise=0.0, bias=0.0, **COARSE).image.array
    bright = even > 200
    gain = noise_free.image.array[bright] / even[bright]
    # Never darker, never more than 20 % brighter; whole grey levels are 0.5 % of the darkest tissue.
    assert 0.99 < gain.min() < 1.05
    assert 1.1 < gain.max() < 1.21
    back = np.argwhere(bright)[:, 2]
    assert np.corrcoef(back, gain)[0, 1] < -0.9


# ---------------------------------------------------------------------- options and files


def test_the_same_seed_gives_the_same_image(coarse):
    assert np.array_equal(pelvis_phantom(**COARSE).image.array, coarse.image.array)


def test_another_seed_changes_tissue_and_noise_but_not_the_organs(coarse):
    other = pelvis_phantom(seed=1, **COARSE)
    assert not np.array_equal(other.image.array, coarse.image.array)
    assert np.array_equal(other.image.ijk_to_ras, coarse.image.ijk_to_ras)
    for name, surface in coarse.surfaces.items():
        assert np.array_equal(other.surfaces[name].control_net, surface.control_net)


@pytest.mark.parametrize("cut", [{"size": (60, 96)}, {"size": (96, 60)}, {"n_slices": 15}])
def test_a_field_of_view_that_cuts_an_organ_is_refused(cut):
    with pytest.raises(
        ValueError, match=r"^The field of view of .* cuts the .*; use more or larger pixels or slices\.$"
    ):
        pelvis_phantom(**{**COARSE, **cut})


def test_written_files_bring_everything_back(coarse, tmp_path):
    write_phantom(coarse, tmp_path / "new" / "folder")
    image = read_image(tmp_path / "new" / "folder" / "mri.nii.gz")
    assert np.array_equal(image.array, coarse.image.array)
    # NIfTI keeps its directions in single precision: 1e-7 of the 144 mm to the far corner.
    assert image.ijk_to_ras == pytest.approx(coarse.image.ijk_to_ras, abs=1e-4)
    for name, surface in coarse.surfaces.items():
        truth = read_surface(tmp_path / "new" / "folder" / "truth" / f"{name}.json")
        assert np.array_equal(truth.control_net, surface.control_net)


def test_the_written_configuration_asks_for_every_organ(coarse, tmp_path):
    write_phantom(coarse, tmp_path)
    config = json.loads((tmp_path / "organs.json").read_text(encoding="utf-8"))
    assert (config["schema"], config["version"]) == ("vic-registration/organs", 1)
    requests = read_requests(tmp_path / "organs.json")
    assert [request.name for request in requests] == list(NAMES)
    for request in requests:
        # Seeds are written with two decimals.
        assert np.asarray(request.seeds) == pytest.approx(coarse.seeds[request.name], abs=0.006)
