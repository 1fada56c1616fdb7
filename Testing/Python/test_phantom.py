"""The MRI painter puts every organ where it is, with the volume it has."""

from __future__ import annotations

import numpy as np
import pytest
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.phantoms.painting import (
    add_coil_bias,
    add_rician_noise,
    paint,
    smooth_random_field,
)

# Rotation by a generic angle about a generic axis, then a mirror: an oblique, left-handed grid.
OBLIQUE = np.array([[0.36, -0.48, 0.8], [0.8, 0.6, 0.0], [0.48, -0.64, -0.6]])


def matrix_of(directions, spacing, origin):
    matrix = np.eye(4)
    matrix[:3, :3] = directions * np.asarray(spacing)
    matrix[:3, 3] = origin
    return matrix


def mesh_of(source):
    """Points and triangles of a VTK source, without duplicate points."""
    source.SetOutputPointsPrecision(vtk.vtkAlgorithm.DOUBLE_PRECISION)
    triangulate = vtk.vtkTriangleFilter()
    triangulate.SetInputConnection(source.GetOutputPort())
    clean = vtk.vtkCleanPolyData()
    clean.SetInputConnection(triangulate.GetOutputPort())
    clean.Update()
    mesh = clean.GetOutput()
    points = vtk_to_numpy(mesh.GetPoints().GetData()).astype(float)
    return points, vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3).copy()


def sphere(center, radius):
    source = vtk.vtkSphereSource()
    source.SetCenter(center)
    source.SetRadius(radius)
    source.SetThetaResolution(80)
    source.SetPhiResolution(80)
    return mesh_of(source)


def box(low, high):
    source = vtk.vtkCubeSource()
    source.SetBounds(low[0], high[0], low[1], high[1], low[2], high[2])
    return mesh_of(source)


def mesh_volume_and_centroid(points, triangles):
    corners = points[triangles]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return volumes.sum(), (volumes[:, None] * corners.sum(axis=1) / 4).sum(axis=0) / volumes.sum()


def centroid_ijk(fractions):
    kji = np.indices(fractions.shape).reshape(3, -1) @ fractions.ravel().astype(float)
    return kji[::-1] / fractions.sum(dtype=float)


class TestVolumeFractions:
    @pytest.mark.parametrize(
        ("directions", "spacing"),
        [
            (np.eye(3), (0.59, 0.59, 4.0)),
            (np.diag([-1.0, -1.0, 1.0]), (0.7, 0.9, 3.0)),
            (OBLIQUE, (0.7, 0.8, 3.0)),
        ],
        ids=["straight", "flipped", "oblique left-handed"],
    )
    def test_a_sphere_keeps_its_volume_and_its_place(self, directions, spacing):
        shape = (24, 100, 110)
        center = np.array([3.3, -5.1, 6.2])
        matrix = matrix_of(directions, spacing, [0, 0, 0])
        matrix[:3, 3] = center - matrix[:3, :3] @ [53.2, 50.4, 11.7]
        points, triangles = sphere(center, 28.0)

        fractions = volume_fractions(points, triangles, shape, matrix)

        volume, centroid = mesh_volume_and_centroid(points, triangles)
        assert fractions.shape == shape
        assert fractions.dtype == np.float32
        # 72 samples in each of some 10,000 voxels at the surface: their errors are random and cancel.
        assert fractions.sum(dtype=float) * np.prod(spacing) == pytest.approx(volume, rel=2e-4)
        expected = np.linalg.solve(matrix[:3, :3], centroid - matrix[:3, 3])
        np.testing.assert_allclose(centroid_ijk(fractions), expected, atol=2e-3)

    def test_the_test_grid_is_oblique_and_left_handed(self):
        np.testing.assert_allclose(OBLIQUE @ OBLIQUE.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(OBLIQUE) == pytest.approx(-1)

    def test_a_box_between_voxel_faces_fills_whole_voxels(self):
        points, triangles = box((1.5, 2.5, 3.5), (5.5, 7.5, 6.5))
        expected = np.zeros((10, 11, 12))
        expected[4:7, 3:8, 2:6] = 1
        for supersampling in [(1, 1, 1), (4, 3, 2), (8, 3, 3)]:
            fractions = volume_fractions(points, triangles, expected.shape, np.eye(4), supersampling=supersampling)
            np.testing.assert_array_equal(fractions, expected)

    def test_a_face_inside_voxels_gives_the_part_that_is_covered(self):
        points, triangles = box((1.5, 1.5, 2.0), (4.75, 5.5, 7.5))
        fractions = volume_fractions(points, triangles, (10, 8, 8), np.eye(4), supersampling=(8, 4, 4))
        assert fractions[2, 3, 3] == 0.5
        assert fractions[4, 3, 5] == 0.25
        assert fractions[2, 3, 5] == 0.125

    def test_what_lies_beyond_the_image_is_cut_off(self):
        points, triangles = box((-9.0, -9.0, -9.0), (3.5, 4.5, 40.0))
        fractions = volume_fractions(points, triangles, (6, 8, 9), np.eye(4))
        expected = np.zeros((6, 8, 9))
        expected[:, :5, :4] = 1
        np.testing.assert_array_equal(fractions, expected)

    def test_a_surface_beside_the_image_leaves_it_empty(self):
        points, triangles = sphere((100.0, 0.0, 0.0), 5.0)
        assert not volume_fractions(points, triangles, (5, 5, 5), np.eye(4)).any()

    def test_the_orientation_of_the_triangles_does_not_matter(self):
        points, triangles = sphere((6.1, 6.2, 6.3), 4.0)
        forward = volume_fractions(points, triangles, (13, 13, 13), np.eye(4))
        backward = volume_fractions(points, triangles[:, ::-1], (13, 13, 13), np.eye(4))
        np.testing.assert_array_equal(forward, backward)

    def test_the_surface_given_is_not_changed(self):
        points, triangles = sphere((6.1, 6.2, 6.3), 4.0)
        before = points.copy(), triangles.copy()
        volume_fractions(points, triangles, (13, 13, 13), np.eye(4))
        np.testing.assert_array_equal(points, before[0])
        np.testing.assert_array_equal(triangles, before[1])


class TestPaint:
    def test_a_voxel_that_is_half_full_gets_the_mean_of_both_levels(self):
        base = np.full((2, 2, 2), 100.0)
        image = paint(base, [(np.full(base.shape, 0.5), 300.0)])
        np.testing.assert_array_equal(image, np.full(base.shape, 200.0))
        assert image.dtype == np.float32

    def test_later_layers_cover_earlier_ones(self):
        base = np.zeros((2, 2, 2))
        full = np.ones(base.shape)
        lumen = np.zeros(base.shape)
        lumen[0] = 1
        image = paint(base, [(full, 30.0), (lumen, 200.0)])
        np.testing.assert_array_equal(image[0], np.full((2, 2), 200.0))
        np.testing.assert_array_equal(image[1], np.full((2, 2), 30.0))

    def test_a_level_may_vary_from_voxel_to_voxel(self):
        texture = np.arange(8.0).reshape(2, 2, 2)
        np.testing.assert_array_equal(paint(np.zeros((2, 2, 2)), [(np.ones((2, 2, 2)), texture)]), texture)

    def test_the_background_given_is_not_changed(self):
        base = np.zeros((2, 2, 2), dtype=np.float32)
        paint(base, [(np.ones(base.shape), 5.0)])
        assert not base.any()


class TestCoilBias:
    def test_the_gain_falls_off_as_a_gaussian_of_the_distance_in_mm(self):
        matrix = matrix_of(OBLIQUE, (0.7, 0.8, 3.0), (5.0, -3.0, 2.0))
        center, width = np.array([9.0, -2.0, 1.0]), 12.0
        image = add_coil_bias(np.full((4, 5, 6), 50), matrix, strength=0.4, center=center, width=width)
        place = matrix @ [5, 2, 3, 1]
        distance = np.linalg.norm(place[:3] - center)
        expected = 50 * (1 + 0.4 * np.exp(-0.5 * (distance / width) ** 2))
        assert image[3, 2, 5] == pytest.approx(expected, rel=1e-5)


class TestRicianNoise:
    def test_bright_tissue_has_gaussian_noise_and_air_the_rayleigh_mean(self):
        count = 200_000
        bright = add_rician_noise(np.full(count, 500.0), sigma=10.0, seed=1)
        air = add_rician_noise(np.zeros(count), sigma=10.0, seed=2)
        # Standard error of a deviation and of a mean over 200,000 voxels: 0.016 and 0.015.
        assert bright.std() == pytest.approx(10.0, abs=0.08)
        assert air.mean() == pytest.approx(10.0 * np.sqrt(np.pi / 2), abs=0.08)
        assert air.min() >= 0

    def test_the_same_seed_gives_the_same_image(self):
        image = np.full((3, 4, 5), 100.0)
        first, again, other = (add_rician_noise(image, sigma=5.0, seed=seed) for seed in (7, 7, 8))
        np.testing.assert_array_equal(first, again)
        assert np.abs(first - other).max() > 1

    def test_no_noise_leaves_the_image_as_it_is(self):
        image = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
        np.testing.assert_array_equal(add_rician_noise(image, sigma=0.0, seed=1), image)


class TestSmoothRandomField:
    def test_it_has_mean_0_and_deviation_1(self):
        field = smooth_random_field((20, 90, 110), (0.6, 0.7, 4.0), correlation_mm=9.0, seed=3)
        assert field.shape == (20, 90, 110)
        assert field.dtype == np.float32
        # Rounding of float32.
        assert field.mean(dtype=float) == pytest.approx(0, abs=1e-5)
        assert field.std(dtype=float) == pytest.approx(1, abs=1e-5)

    def test_its_correlation_length_is_in_mm_along_every_axis(self):
        field = smooth_random_field((50, 200, 200), (1.0, 1.0, 4.0), correlation_mm=8.0, seed=5)
        along_i = np.mean(field[:, :, :-8] * field[:, :, 8:])
        along_j = np.mean(field[:, :-8] * field[:, 8:])
        along_k = np.mean(field[:-2] * field[2:])
        # Some 15,000 independent places, fewer at the borders: three standard errors are 0.03.
        np.testing.assert_allclose([along_i, along_j, along_k], np.exp(-0.5), atol=0.03)

    def test_the_same_seed_gives_the_same_field(self):
        first, again, other = (
            smooth_random_field((4, 30, 40), (1.0, 1.0, 4.0), correlation_mm=6.0, seed=seed) for seed in (1, 1, 2)
        )
        np.testing.assert_array_equal(first, again)
        assert np.abs(first - other).max() > 0.5
