"""The benchmark's parts work and say what they measured; how fast anything is, no test asks."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def modules():
    """The benchmark is a folder of scripts, not a package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        import accuracy
        import bladders
        import boundaries
        import confidence
        import growth
        import hippocampus
        import measuring
        import meshes
        import nets
        import previews
        import random_organs
        import robustness
        import run
        import scenes
        import surfaces
        import tubes
        import volumes

        parts = (bladders, boundaries, growth, measuring, meshes, previews, run, scenes, surfaces, volumes)
        found = (accuracy, confidence, hippocampus, nets, random_organs, robustness, tubes, *parts)
        yield {module.__name__: module for module in found}
        for module in found:
            del sys.modules[module.__name__]


@pytest.fixture(scope="module")
def image(modules):
    return modules["scenes"].organ_volume((96, 96, 28), (1.18, 1.18, 3.0))


@pytest.fixture(scope="module")
def scene(modules, image):
    from VICRegistrationLib.segmentation.separation import separate

    return modules["scenes"].Scene("organ", image, separate(image, np.zeros((1, 3))))


def test_jobs_take_turns_in_alternating_order_after_a_warm_up(modules):
    calls = []
    jobs = {"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}
    seconds = modules["measuring"].interleaved_seconds(jobs, 3)
    assert "".join(calls) == "ba" + "ab" + "ba" + "ab"
    assert [len(seconds[name]) for name in jobs] == [3, 3]


def test_a_ratio_is_taken_within_rounds(modules):
    # The machine was ten times slower in the last two rounds; the work always took twice as long.
    assert modules["measuring"].ratio([2.0, 20.0, 20.0], [1.0, 10.0, 10.0]) == 2.0


def test_the_exponent_of_a_power_is_found(modules):
    sizes = np.array([1.0, 3.0, 10.0])
    assert modules["measuring"].exponent(sizes, 5.0 * sizes**1.5) == pytest.approx(1.5)


def test_peak_memory_counts_what_was_held_and_freed(modules):
    # A million doubles are 8 MB; the interpreter's own objects are far below the tolerance.
    assert modules["measuring"].peak_megabytes(lambda: np.ones(1_000_000).sum()) == pytest.approx(8.0, abs=0.1)


def test_the_organ_has_the_volume_of_its_ellipsoid(scene):
    # 4/3 pi 35 32 30 mm^3 = 140.7 ml; the threshold lies between organ and wall, voxels are coarse: 3 %.
    assert scene.region.volume_ml == pytest.approx(140.7, rel=0.03)


def test_vtk_and_the_fit_are_timed_on_the_same_region(modules, scene):
    result = modules["surfaces"].measured(scene, 1)
    assert result["fit"] > 0.0
    assert result["vtk"] > 0.0
    assert result["ratio"] == pytest.approx(result["fit"] / result["vtk"])
    assert result["iterations"] > 0


def test_a_surface_against_itself_is_off_by_nothing(modules, image):
    from VICRegistrationLib.geometry import models

    accuracy = modules["accuracy"]
    truth = models.closed_organ((9, 7), axes=30.0 * np.eye(3))
    points = truth.grid(np.linspace(0.0, 1.0, 30), np.linspace(0.05, 0.95, 20)).reshape(-1, 3)
    normals = truth.normals(*accuracy.closest_points(truth, points).parameters.T)
    found = accuracy.of_surface(truth, accuracy.Case("", image, None, truth, points, normals))
    assert found.distances.maximum < 1e-6
    # The arc cosine of a number next to 1 has half its digits.
    assert found.angle < 1e-4
    assert found.back.maximum < 1e-6
    assert found.both.n == found.distances.n + found.back.n


def test_normals_of_a_label_are_those_of_the_shape_that_was_drawn(modules):
    from VICRegistrationLib.analysis.distances import mesh_of_mask, points_on
    from VICRegistrationLib.imaging.image import Image

    matrix = np.diag([-0.5, 0.5, 1.0, 1.0])
    k, j, i = np.indices((60, 110, 110))
    away = np.stack([-0.5 * i, 0.5 * j, k], axis=-1) - [-27.0, 27.0, 30.0]
    label = Image(np.linalg.norm(away, axis=-1) <= 22.0, matrix)
    points = points_on(mesh_of_mask(label), 2000)
    radial = points - [-27.0, 27.0, 30.0]
    cosines = np.einsum("nk,nk->n", modules["accuracy"].label_normals(label, points), radial)
    angles = np.degrees(np.arccos(np.clip(cosines / np.linalg.norm(radial, axis=1), -1.0, 1.0)))
    # The voxels' own faces are off by 20 degrees and more.
    assert angles.mean() < 2.0


def test_smoothed_triangles_are_measured_like_a_surface(modules, scene):
    from VICRegistrationLib.geometry import models

    accuracy = modules["accuracy"]
    truth = models.closed_organ((33, 25), axes=np.diag([35.0, 32.0, 30.0]))
    points = accuracy.points_on(truth, 2000)
    normals = truth.normals(*accuracy.closest_points(truth, points).parameters.T)
    case = accuracy.Case("", scene.image, None, truth, points, normals)
    found = accuracy.of_contour(scene.region, case)
    # Voxels of 1.18 and 3 mm.
    assert found.distances.mean < 1.0
    assert 2.0 < found.angle < 20.0
    assert found.back.mean == pytest.approx(found.distances.mean, rel=0.3)


def test_the_table_of_accuracy_has_both_surfaces_and_the_paper_s(modules, pelvis, monkeypatch):
    monkeypatch.setattr(modules["accuracy"], "pelvis_phantom", lambda: pelvis)
    monkeypatch.setattr(modules["accuracy"], "bladders", list)
    monkeypatch.setattr(modules["accuracy"], "N_POINTS", 500)
    text = modules["accuracy"].report(quick=True)
    for organ in ("bladder", "vagina", "rectum"):
        assert re.search(rf"{organ}, demo: fitted +0\.\d\d ", text)
    assert text.count("triangles / fitted") == 3
    assert re.search(r"vagina, paper's witness 3 +1\.23 +1\.04\n", text)
    assert "smoothed triangles worse in mean, 95 %, normals: so" in text
    assert "smoothed triangles worse in both, both 95 %: so" in text
    assert "Real bladders were skipped" in text


def test_seeds_are_drawn_from_all_of_an_organ(modules):
    from VICRegistrationLib.geometry import models
    from VICRegistrationLib.geometry.projection import closest_points

    ball = models.closed_organ((9, 7), axes=10.0 * np.eye(3))
    seeds = modules["robustness"].seeds_anywhere(ball, 400, np.random.default_rng(0))
    assert seeds.shape == (400, 3)
    depths = -closest_points(ball, seeds).distances
    assert depths.min() > 0.0
    # In a ball, an eighth of the volume is deeper than half the radius.
    assert np.mean(depths > 5.0) == pytest.approx(0.125, abs=0.05)


def test_sureness_counts_area_within_two_deviations(modules):
    confidence = modules["confidence"]
    areas = np.array([0.5, 0.3, 0.2])
    one = confidence.Sureness("bladder", 0.05, np.array([0.1, -0.3, 0.9]), np.array([0.1, 0.2, 0.4]), areas, -1.0)
    assert one.covered == pytest.approx(0.8)
    # 95 % needs the third point too, three quarters of the way up from the second.
    assert confidence.widening([one]) == pytest.approx((1.5 + 0.75 * 0.75) / 2.0)


def test_confidence_is_told_for_every_organ_and_noise(modules, pelvis, monkeypatch):
    monkeypatch.setattr(modules["confidence"], "phantom", lambda number: ((0.05, 0.1)[number], pelvis))
    text = modules["confidence"].report(quick=True)
    assert re.search(r"all +6 +9\d\.\d% ", text)
    assert re.search(r"rectum +2 ", text)
    assert re.search(r"noise 10% +3 ", text)


def test_hippocampi_are_left_out_where_there_are_none(modules, tmp_path):
    assert modules["hippocampus"].hippocampi(tmp_path) == []


def test_each_net_is_measured(modules, pelvis, monkeypatch):
    monkeypatch.setattr(modules["accuracy"], "pelvis_phantom", lambda: pelvis)
    monkeypatch.setattr(modules["accuracy"], "N_POINTS", 500)
    text = modules["nets"].report(quick=True)
    coarse, fine = (float(re.search(rf" {net} +(0\.\d+) ", text)[1]) for net in ("9x7", "17x11"))
    assert fine < coarse


def test_random_shapes_are_painted_and_fitted(modules):
    text = modules["random_organs"].report(quick=True)
    assert re.search(r"2 organs of \d+ to \d+ ml fitted, 2 of the surfaces valid\.", text)
    assert float(re.search(r"worst +(0\.\d\d) ", text)[1]) < 0.15


def test_a_bent_tube_is_told_from_both_starts(modules):
    lines = modules["tubes"].report(quick=True).splitlines()
    means = {words[1]: float(words[2]) for words in map(str.split, lines) if words[:1] == ["180°"]}
    assert means["automatic"] < 0.3
    assert means["ellipsoid"] > 3.0 * means["automatic"]


def test_a_hippocampus_is_told_from_its_box_and_from_its_label(modules, shared_data):
    text = modules["hippocampus"].report(quick=True)
    assert re.search(r"001, from its box +\d\.\d\d ", text)
    assert re.search(r"001, from its label +\d\.\d\d ", text)


def test_vtks_contour_lies_where_the_organ_is(modules, scene):
    surfaces = modules["surfaces"]
    points, triangles, normals = surfaces.contour_in_world(surfaces.smoothed_contour(scene.region), scene.region)
    # Half axes of 35, 32 and 30 mm; voxels of 1.18 and 3 mm, and smoothing that shrinks.
    np.testing.assert_allclose(np.ptp(points, axis=0) / 2.0, [35.0, 32.0, 30.0], atol=3.0)
    assert triangles.max() < len(points)
    assert np.mean(np.einsum("nk,nk->n", normals, points - points.mean(axis=0)) > 0.0) > 0.99


def test_growth_is_told_with_ratios_and_exponents(modules, image):
    growth = modules["growth"]
    jobs = [growth.local_fit(image, (9, 7), shape) for shape in ((24, 16), (48, 32))]
    text = growth.grown(["few", "many"], [384, 1536], jobs, 1)
    assert re.search(r"many +1536 .* 4\.0 ", text)
    assert re.search(r"time ~ size\^-?\d\.\d\d, memory ~ size\^[01]\.\d\d", text)


@pytest.mark.parametrize("order", ["linear", "cubic"])
def test_sampling_is_timed_against_scipy(modules, image, order):
    seconds = modules["volumes"].sampling_seconds(image, order, 100, 1)
    assert set(seconds) == {"gradients", "values", "scipy"}


def test_separation_is_timed_against_labelling(modules, image):
    assert set(modules["volumes"].separation_seconds(image, 1)) == {"separate", "label"}


def test_real_bladders_are_left_out_where_there_are_none(modules, tmp_path):
    assert modules["bladders"].bladders(tmp_path) == []


def test_the_report_starts_with_the_machine(modules, monkeypatch, capsys):
    monkeypatch.setattr(modules["run"], "reports", lambda: {"surface": lambda *, quick: f"quick is {quick}"})
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert modules["run"].main(["--quick", "--only", "surface"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"\d+ cores, .*numpy \d.*scipy \d.*VTK \d", printed)
    assert "quick is True" in printed


@pytest.mark.long
def test_random_organs_are_meshed_and_counted(modules):
    gmsh_or_skip()
    assert "2 random valid organs at 5 mm: 2 meshed, 0 failed" in modules["meshes"]._random(2)


def test_every_title_has_a_report_and_the_other_way_round(modules):
    assert list(modules["run"].reports()) == list(modules["run"].TITLES)
    assert set(modules["run"].LONG) < set(modules["run"].TITLES)


@pytest.mark.long
def test_a_correction_is_timed_against_the_fit(modules, image, scene):
    from VICRegistrationLib.registration.organ import finish, fit_region

    fit = finish(fit_region(image, scene.region))
    assert set(modules["boundaries"].correction_seconds(image, fit, 1)) == {"correction", "fit"}


def test_a_preview_is_timed_against_labelling(modules, image, scene):
    pytest.importorskip("slicer", reason="slicer-core is not installed")
    seconds = modules["previews"].preview_seconds(image, 2)
    assert {name: len(times) for name, times in seconds.items()} == {"preview": 2, "label": 2}


def test_other_seeds_lie_deep_in_the_lumen_and_are_always_the_same(modules, image):
    from VICRegistrationLib.imaging.region import region_from_mask

    mask = np.zeros(image.array.shape, dtype=bool)
    mask[2:-2, 5:-5, 5:-5] = True
    lumen = region_from_mask(image, mask)
    bladder = modules["bladders"].Bladder("made up", image, lumen, None)
    seeds = modules["bladders"].other_seeds(bladder, 5)
    assert seeds.shape == (5, 1, 3)
    assert len(np.unique(seeds.round(6), axis=0)) == 5
    np.testing.assert_array_equal(seeds, modules["bladders"].other_seeds(bladder, 5))
    first, last = (lumen.image.to_ras(np.array([part], dtype=float))[0] for part in ([0, 0, 0], lumen.image.size - 1))
    low, high = np.minimum(first, last), np.maximum(first, last)
    assert ((seeds > low + 2.0) & (seeds < high - 2.0)).all()
