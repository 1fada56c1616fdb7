"""The fit of a generic model in the scene: what it takes and says, and what cancelling or deleting leaves."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mrml_scenes
import numpy as np
import pytest

from VICRegistrationLib.multipatch.file import write_model
from VICRegistrationLib.multipatch.pelvis import pelvis as generic_pelvis

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def parameters(logic):
    from VICRegistrationLib.mrml.generic_model import GenericModelParameters

    return GenericModelParameters(logic.getParameterNode().parameterNode)


@pytest.fixture
def steps(logic, demo_volume, parameters):
    """Function that begins a fit."""
    from VICRegistrationLib.mrml.generic_model_fit import modelSteps

    return lambda: modelSteps(parameters, logic.organs(), demo_volume)


def run_until(steps, words):
    """Run a fit until a step says these words."""
    while words not in next(steps):
        pass


def organ_of(logic, name):
    return next(organ for organ in logic.organs() if organ.label == name)


def test_the_message_has_figures_and_what_to_know(fit_model, demo_volume, model_nodes):
    found = fit_model()
    lines = model_nodes.messageOf(demo_volume).split("\n")
    assert lines[0].startswith("Model fitted to bladder, vagina in ")
    assert f"{found.smallest_determinant[0]:.2f}, near {found.smallest_determinant[1]}" in lines[1]
    assert sum("organ rectum was not given. The generic model predicts it" in line for line in lines) == 1
    assert sum(line.startswith("Estimated by the generic model, not seen in the image") for line in lines) == 1


def test_points_on_the_wall_are_said_not_to_be_used(fit_model, logic, demo_volume, model_nodes):
    from VICRegistrationLib.mrml.organ_nodes import boundaryPointsOf

    fit_model()
    assert "not used" not in model_nodes.messageOf(demo_volume)
    boundaryPointsOf(organ_of(logic, "vagina"), demo_volume).AddControlPointWorld(0.0, 0.0, 0.0)
    fit_model()
    lines = model_nodes.messageOf(demo_volume).split("\n")
    assert "vagina: the fit of a model does not use its boundary points." in lines


def test_organs_are_fitted_to_further_stacks(fit_model, logic, demo_volume, model_nodes, near_pelvis):
    brighter = dataclasses.replace(near_pelvis.image, array=near_pelvis.image.array + 1)
    logic.getParameterNode().furtherStacks = [mrml_scenes.add_volume(brighter, name="again")]
    found = fit_model()
    # The same image a second time, brighter, for the very same would be refused: nothing has moved.
    for organ in found.organs.values():
        (stack,) = organ.stacks
        assert stack.used
        assert np.linalg.norm(stack.translation_mm) < 0.1
    # Measured: 0.1 degrees for the bladder, which is nearly round.
    assert re.search(r"bladder 0\.0 mm, 0\.[01] degrees in again", model_nodes.messageOf(demo_volume))


def test_a_stack_under_a_transform_that_bends_is_left_out(fit_model, logic, demo_volume, model_nodes, near_pelvis):
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    logic.getParameterNode().furtherStacks = [mrml_scenes.add_volume(near_pelvis.image, name="bent", under=bent)]
    assert fit_model().organs["bladder"].stacks == ()
    assert "The stack bent was left out." in model_nodes.messageOf(demo_volume)


def test_a_stack_is_deleted_meanwhile(logic, steps, near_pelvis, scene):
    stack = mrml_scenes.add_volume(near_pelvis.image, name="again")
    logic.getParameterNode().furtherStacks = [stack]
    running = steps()
    run_until(running, "vagina: separating")
    scene.RemoveNode(stack)
    with pytest.raises(ValueError, match="stack again was deleted"):
        next(running)


def test_the_fills_of_its_organs_are_hidden(fit_model, logic):
    fit_model()
    for organ in logic.organs():
        assert not organ.regions.GetDisplayNode().GetSegmentVisibility(organ.regionSegmentId)


def test_fitting_again_replaces_what_the_folder_holds(fit_model, demo_volume, model_nodes, scene):
    fit_model()
    content = mrml_scenes.content(scene)
    model_nodes.removeNodes(model_nodes.partsOf(demo_volume)[3:4])
    fit_model()
    assert len(mrml_scenes.content(scene)) == len(content)
    assert len(model_nodes.partsOf(demo_volume)) == len(generic_pelvis().parts)


def test_parts_outlive_their_text_and_are_taken_again(fit_model, demo_volume, model_nodes):
    found = fit_model()
    model_nodes.removeNodes([model_nodes.findModel(demo_volume)])
    with pytest.raises(ValueError, match="no fitted model yet"):
        model_nodes.modelOfVolume(demo_volume)
    fit_model()
    assert len(model_nodes.partsOf(demo_volume)) == len(found.model.parts)


def test_another_model_leaves_no_part_of_the_one_before(fit_model, demo_volume, model_nodes, tmp_path):
    fit_model()
    model = generic_pelvis()
    write_model(_without(model, "levator ani"), tmp_path / "smaller & other.json")
    fit_model(model=str(tmp_path / "smaller & other.json"))
    names = [node.GetName() for node in model_nodes.partsOf(demo_volume)]
    assert len(names) == len(model.parts) - 1
    assert "levator ani (estimated)" not in names


def _without(model, name):
    patches = tuple(patch for patch in model.patches if patch.part != name)
    return dataclasses.replace(model, patches=patches, parts=tuple(part for part in model.parts if part.name != name))


@pytest.mark.parametrize("words", ["vagina: separating", "region", "own control points", "Determinant", "Showing"])
def test_a_fit_that_is_cancelled_leaves_the_earlier_result(fit_model, steps, demo_volume, model_nodes, scene, words):
    fit_model()
    text, content = model_nodes.findModel(demo_volume).GetText(), mrml_scenes.content(scene)
    before = [node.GetPolyData() for node in model_nodes.partsOf(demo_volume)]
    running = steps()
    run_until(running, words)
    running.close()
    assert model_nodes.findModel(demo_volume).GetText() == text
    assert mrml_scenes.content(scene) == content
    assert [node.GetPolyData() for node in model_nodes.partsOf(demo_volume)] == before


@pytest.mark.parametrize("words", ["vagina: separating", "grey levels, fine", "Sliding"])
def test_an_organ_is_deleted_meanwhile(logic, steps, demo_volume, model_nodes, scene, words):
    running = steps()
    run_until(running, words)
    logic.organs().remove(organ_of(logic, "vagina"))
    content = mrml_scenes.content(scene)
    with pytest.raises(ValueError, match=r"organ vagina was deleted.*Fit the model again"):
        next(running)
    assert model_nodes.findModel(demo_volume) is None
    assert mrml_scenes.content(scene) == content


def test_the_volume_is_deleted_meanwhile(steps, demo_volume, scene):
    running = steps()
    run_until(running, "region")
    scene.RemoveNode(demo_volume)
    with pytest.raises(ValueError, match="volume mri was deleted"):
        next(running)


def test_the_lines_for_the_python_console(slicer_module, near_pelvis, monkeypatch, capsys):
    monkeypatch.setattr("VICRegistrationLib.mrml.samples.phantom", lambda: near_pelvis)
    page = (Path(__file__).resolve().parents[2] / "docs" / "generic-model.md").read_text(encoding="utf-8")
    (block,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "fitModel" in block)
    exec(block, {})
    assert capsys.readouterr().out.startswith("ModelFit(2 organs fitted, 1 predicted, 11 parts estimated")
