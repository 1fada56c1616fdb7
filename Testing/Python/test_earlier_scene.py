"""A scene saved by an earlier version of the module opens with its seeds, regions, surfaces and settings."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from mrml_scenes import segment_voxels, slicer

DATA = Path(__file__).resolve().parent / "data"
EXPECTED = json.loads((DATA / "earlier_scene.json").read_text())


@pytest.fixture
def organs(logic):
    """Organs of the scene by name."""
    slicer.util.loadScene(str(DATA / "earlier_scene.mrb"))
    logic.organs().adopt()
    return {organ.label: organ for organ in logic.organs()}


def points_of(node):
    return slicer.util.arrayFromMarkupsControlPoints(node, world=True) if node else np.zeros((0, 3))


def as_json(value):
    return json.loads(json.dumps(value))


def test_organs_come_in_their_order(organs):
    assert list(organs) == list(EXPECTED) == ["rectum", "bladder"]


@pytest.mark.parametrize("name", list(EXPECTED))
def test_settings_come_back(organs, name):
    organ, expected = organs[name], EXPECTED[name]
    options = as_json(asdict(organ.options()))
    assert {key: options[key] for key in expected["options"]} == expected["options"]
    assert [organ.state.name, list(organ.color)] == [expected["state"], expected["color"]]
    assert organ.volumeMl == pytest.approx(expected["volume_ml"])


@pytest.mark.parametrize("name", list(EXPECTED))
def test_points_come_back(organs, name):
    organ, expected = organs[name], EXPECTED[name]
    np.testing.assert_allclose(points_of(organ.seeds), expected["seeds"], atol=1e-3)
    found = points_of(organ.boundaryPoints)
    np.testing.assert_allclose(found, np.reshape(expected["boundary_points"], (-1, 3)), atol=1e-3)


@pytest.mark.parametrize("name", list(EXPECTED))
def test_region_comes_back(organs, logic, name):
    expected = EXPECTED[name]
    voxels = segment_voxels(organs[name], logic.getParameterNode().volume)
    assert np.count_nonzero(voxels) == expected["region_voxels"]
    np.testing.assert_allclose(np.argwhere(voxels).mean(axis=0), expected["region_center_kji"], atol=1e-5)


@pytest.mark.parametrize("name", list(EXPECTED))
def test_surface_comes_back_bit_for_bit(organs, logic, name):
    surface, expected = logic.surface(organs[name]), EXPECTED[name]
    arrays = (surface.control_net, surface.knots_u, surface.knots_v)
    digest = hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()
    assert digest == expected["surface_sha256"]
    assert surface.volume() / 1000.0 == pytest.approx(expected["volume_ml"])


@pytest.mark.parametrize("name", list(EXPECTED))
def test_there_are_no_further_stacks(organs, logic, name):
    from VICRegistrationLib.mrml.stacks import stacksOf

    assert (stacksOf(organs[name]), organs[name].contours()) == ({}, [])
    assert list(logic.getParameterNode().furtherStacks) == []


def test_reference_comes_back(organs, logic):
    node, segment = organs["bladder"].reference()
    assert (node.GetName(), segment) == (EXPECTED["bladder"]["reference"], "")
    found = logic.compare(organs["bladder"], node)
    assert found.to_surface.mean == pytest.approx(EXPECTED["bladder"]["mean_deviation_mm"], rel=1e-3)


def test_work_goes_on(organs, logic):
    # From the surface before the boundary point was set, through that point and another one: two are reached.
    organ = organs["bladder"]
    deviations = logic.refit(organ, points_of(organ.seeds) + [0.0, 0.0, 11.0])
    assert deviations.shape == (2,)
    assert organ.volumeMl == pytest.approx(EXPECTED["bladder"]["volume_ml"], rel=0.2)
