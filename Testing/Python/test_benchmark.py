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
        import bladders
        import boundaries
        import growth
        import measuring
        import meshes
        import previews
        import run
        import scenes
        import simulations
        import surfaces
        import volumes

        found = (bladders, boundaries, growth, measuring, meshes, previews, run, scenes, simulations, surfaces, volumes)
        yield {module.__name__: module for module in found}
        for module in found:
            del sys.modules[module.__name__]


@pytest.fixture(scope="module")
def image(modules):
    return modules["scenes"].organ_volume((96, 96, 28), (1.18, 1.18, 3.0))


@pytest.fixture(scope="module")
def scene(modules, image):
    from VICRegistrationLib.imaging.separation import separate

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


def test_errors_of_a_surface_against_itself_are_those_of_its_triangles(modules):
    from VICRegistrationLib.geometry import models
    from VICRegistrationLib.geometry.triangulation import triangulate

    truth = models.closed_organ((9, 7), axes=30.0 * np.eye(3))
    mesh = triangulate(truth, resolution=(160, 100))
    found = modules["surfaces"].errors(mesh.points, mesh.triangles, mesh.normals, truth)
    # Chords of 1.2 mm on a radius of 30 mm: 0.006 mm; normals are means of three exact ones.
    assert found["p95"] < 0.02
    assert found["angle"] < 0.5


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
    assert re.search(r"time ~ size\^-?\d\.\d\d, memory ~ size\^0\.\d\d", text)


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


def test_random_organs_are_meshed_and_counted(modules):
    gmsh_or_skip()
    assert "2 random valid organs at 5 mm: 2 meshed, 0 failed" in modules["meshes"]._random(2)


def test_every_title_has_a_report_and_the_other_way_round(modules):
    assert list(modules["run"].reports()) == list(modules["run"].TITLES)
    assert set(modules["run"].LONG) < set(modules["run"].TITLES)


def test_a_correction_is_timed_against_the_fit(modules, image, scene):
    from VICRegistrationLib.registration.organ import finish, fit_region

    fit = finish(fit_region(image, scene.region))
    assert set(modules["boundaries"].correction_seconds(image, fit, 1)) == {"correction", "fit"}


def test_a_preview_is_timed_against_labelling(modules, image, scene):
    pytest.importorskip("slicer", reason="slicer-core is not installed")
    seconds = modules["previews"].preview_seconds(image, 2)
    assert {name: len(times) for name, times in seconds.items()} == {"preview": 2, "label": 2}


def test_energies_of_both_problems_are_told(modules):
    gmsh_or_skip()
    pytest.importorskip("skfem", reason="scikit-fem is not installed")
    text = modules["simulations"].report(quick=True)
    # A second solver on finer meshes: 351.07 and 2790.6 uJ; at 6 mm less by 0.01 and by 0.3 %.
    weight, pressure = (float(found) for found in re.findall(r"(?:kPa|1 kPa) +6 +\d+ +(\d+\.\d{3}) ", text))
    assert weight == pytest.approx(351.07, rel=1e-4)
    assert pressure == pytest.approx(2790.6, rel=5e-3)
