"""Nothing keeps listening to a scene's nodes after a call has returned, a fit has ended, or a generator was dropped."""

from __future__ import annotations

import gc
import itertools

import mrml_scenes
import pytest
from mrml_scenes import slicer
from small_phantom import CENTER

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


def observers(scene):
    """Observers of the scene and of each of its nodes, by ID."""
    # Markups listen more to the list that is the active one, which a new list takes over.
    slicer.app.applicationLogic().GetSelectionNode().SetActivePlaceNodeID(None)
    # Wrappers of parameters let go of their nodes when they are collected.
    gc.collect()
    nodes = [scene.GetNthNode(index) for index in range(scene.GetNumberOfNodes())]
    return {"scene": mrml_scenes.n_observers(scene), **{n.GetID(): mrml_scenes.n_observers(n) for n in nodes}}


def test_observers_are_counted(scene):
    node = scene.AddNewNodeByClass("vtkMRMLModelNode")
    before = observers(scene)
    tag = node.AddObserver("ModifiedEvent", lambda *_: None)
    assert observers(scene) == {**before, node.GetID(): before[node.GetID()] + 1}
    node.RemoveObserver(tag)
    assert observers(scene) == before


@pytest.mark.parametrize("kind", ["fit", "refit"])
@pytest.mark.parametrize("end", ["finished", "cancelled", "dropped"])
def test_a_fit_leaves_no_observer(logic, scene, kind, end):
    from VICRegistrationLib.mrml import fitting

    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER])
    before = observers(scene)
    steps = {"fit": fitting.fitSteps, "refit": fitting.refitSteps}[kind](organ, volume)
    list(itertools.islice(steps, None if end == "finished" else 3))
    if end == "cancelled":
        steps.close()
    del steps
    after = observers(scene)
    # A table and triangles that are new have the same observers as those that they replace.
    assert after == before


def test_preview_and_errors_leave_no_observer(logic, scene):
    from VICRegistrationLib.mrml.separating import separateOrgan

    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER])
    before = observers(scene)
    for place in ((500, 0, 0), CENTER):
        organ.seeds.SetNthControlPointPositionWorld(0, *place)
        try:
            separateOrgan(organ, volume)
        except ValueError:
            assert place == (500, 0, 0)
    with pytest.raises(ValueError, match="outside the volume"):
        logic.fit(volume, [[500, 0, 0]])
    assert observers(scene) == before


def test_a_removed_organ_leaves_no_observer(logic, scene):
    volume = mrml_scenes.add_volume()
    logic.getParameterNode()
    logic.organs().remove(logic.fit(volume, [CENTER], name="first"))
    before = observers(scene)
    logic.organs().remove(logic.fit(volume, [CENTER], name="second"))
    assert observers(scene) == before


def test_asking_for_the_organs_again_and_again_leaves_no_observer(logic, scene):
    logic.addOrgan(mrml_scenes.add_volume(), [CENTER])
    before = observers(scene)
    for _again in range(5):
        organs = logic.organs()
        organs.adopt()
        assert [organ.label for organ in organs] == ["organ"]
        del organs
    assert observers(scene) == before
