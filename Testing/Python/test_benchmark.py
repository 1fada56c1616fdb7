"""The benchmark measures what it says; how fast anything is, no test asks."""

from __future__ import annotations

import re

import accuracy
import bladders
import confidence
import hippocampus
import measuring
import numpy as np
import pytest
import robustness
import run
import scenes
import surfaces

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.analysis.reference_meshes import mesh_of_mask
from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.segmentation.separation import separate


@pytest.fixture(scope="module")
def image():
    return scenes.organ_volume((96, 96, 28), (1.18, 1.18, 3.0))


@pytest.fixture(scope="module")
def scene(image):
    return scenes.Scene("organ", image, separate(image, np.zeros((1, 3))))


def test_jobs_take_turns_in_alternating_order_after_a_warm_up():
    calls = []
    seconds = measuring.interleaved_seconds({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert "".join(calls) == "ba" + "ab" + "ba" + "ab"
    assert [len(times) for times in seconds.values()] == [3, 3]
    # The machine was ten times slower in the last two rounds; the work always took twice as long.
    assert measuring.ratio([2.0, 20.0, 20.0], [1.0, 10.0, 10.0]) == 2.0


def test_memory_and_growth_are_measured():
    # A million doubles are 8 MB; the interpreter's own objects are far below the tolerance.
    assert measuring.peak_megabytes(lambda: np.ones(1_000_000).sum()) == pytest.approx(8.0, abs=0.1)
    sizes = np.array([1.0, 3.0, 10.0])
    assert measuring.exponent(sizes, 5.0 * sizes**1.5) == pytest.approx(1.5)


def test_a_surface_against_itself_is_off_by_nothing(image):
    truth = models.closed_organ((9, 7), axes=30.0 * np.eye(3))
    points = truth.grid(np.linspace(0.0, 1.0, 30), np.linspace(0.05, 0.95, 20)).reshape(-1, 3)
    normals = truth.normals(*closest_points(truth, points).parameters.T)
    found = accuracy.of_surface(truth, accuracy.Case("", image, None, truth, points, normals))
    assert max(found.distances.maximum, found.back.maximum) < 1e-6
    # The arc cosine of a number next to 1 has half its digits.
    assert found.angle < 1e-4
    assert found.both.n == found.distances.n + found.back.n


def test_normals_of_a_label_are_those_of_the_shape_that_was_drawn():
    k, j, i = np.indices((60, 110, 110))
    away = np.stack([-0.5 * i, 0.5 * j, k], axis=-1) - [-27.0, 27.0, 30.0]
    label = Image(np.linalg.norm(away, axis=-1) <= 22.0, np.diag([-0.5, 0.5, 1.0, 1.0]))
    points = points_on(mesh_of_mask(label), 2000)
    radial = points - [-27.0, 27.0, 30.0]
    cosines = np.einsum("nk,nk->n", accuracy.label_normals(label, points), radial) / np.linalg.norm(radial, axis=1)
    # The voxels' own faces are off by 20 degrees and more.
    assert np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).mean() < 2.0


def test_smoothed_triangles_are_measured_like_a_surface(scene):
    truth = models.closed_organ((33, 25), axes=np.diag([35.0, 32.0, 30.0]))
    points = points_on(truth, 2000)
    normals = truth.normals(*closest_points(truth, points).parameters.T)
    found = accuracy.of_contour(scene.region, accuracy.Case("", scene.image, None, truth, points, normals))
    # Voxels of 1.18 and 3 mm.
    assert found.distances.mean < 1.0
    assert 2.0 < found.angle < 20.0
    assert found.back.mean == pytest.approx(found.distances.mean, rel=0.3)


def test_seeds_are_drawn_from_all_of_an_organ():
    ball = models.closed_organ((9, 7), axes=10.0 * np.eye(3))
    depths = -closest_points(ball, robustness.seeds_anywhere(ball, 400, np.random.default_rng(0))).distances
    assert depths.min() > 0.0
    # In a ball, an eighth of the volume is deeper than half the radius.
    assert np.mean(depths > 5.0) == pytest.approx(0.125, abs=0.05)


def test_seeds_in_a_lumen_lie_deep_and_are_always_the_same(image):
    mask = np.zeros(image.array.shape, dtype=bool)
    mask[2:-2, 5:-5, 5:-5] = True
    bladder = bladders.Bladder("made up", image, region_from_mask(image, mask), None)
    seeds = bladders.other_seeds(bladder, 5)
    assert len(np.unique(seeds.round(6), axis=0)) == 5
    np.testing.assert_array_equal(seeds, bladders.other_seeds(bladder, 5))
    voxels = image.to_ijk(seeds[:, 0])[:, ::-1].round().astype(int)
    assert ((voxels > [2, 5, 5]) & (voxels < np.array(mask.shape) - [3, 6, 6])).all()


def test_the_calibration_counts_area_within_two_deviations():
    areas = np.array([0.5, 0.3, 0.2])
    one = confidence.Calibration("bladder", 0.05, np.array([0.1, -0.3, 0.9]), np.array([0.1, 0.2, 0.4]), areas, -1.0)
    assert one.covered == pytest.approx(0.8)
    # 95 % needs the third point too, three quarters of the way up from the second.
    assert confidence.widening([one]) == pytest.approx((1.5 + 0.75 * 0.75) / 2.0)


def test_the_contour_and_the_fit_are_measured_on_the_same_organ(scene):
    points, triangles, normals = surfaces.contour_in_world(surfaces.smoothed_contour(scene.region), scene.region)
    # Half axes of 35, 32 and 30 mm; voxels of 1.18 and 3 mm, and smoothing that shrinks.
    np.testing.assert_allclose(np.ptp(points, axis=0) / 2.0, [35.0, 32.0, 30.0], atol=3.0)
    assert triangles.max() < len(points)
    assert np.mean(np.einsum("nk,nk->n", normals, points - points.mean(axis=0)) > 0.0) > 0.99
    result = surfaces.measured(scene, 1)
    assert result["ratio"] == pytest.approx(result["fit"] / result["vtk"])


def test_real_images_are_left_out_where_there_are_none(tmp_path):
    assert bladders.bladders(tmp_path) == hippocampus.hippocampi(tmp_path) == []


def test_the_report_starts_with_the_machine(monkeypatch, capsys):
    monkeypatch.setitem(run.BENCHMARKS, "surface", ("surfaces.demo_scenes", "Nothing"))
    monkeypatch.setattr(surfaces, "demo_scenes", lambda *, quick: f"quick is {quick}")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert run.main(["--quick", "--only", "surface"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"\d+ cores, .*numpy \d.*scipy \d.*VTK \d", printed)
    assert "quick is True" in printed


@pytest.mark.long
@pytest.mark.parametrize("name", run.BENCHMARKS)
def test_every_benchmark_runs(name):
    assert run.report(name, quick=True).strip()
