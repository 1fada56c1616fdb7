"""The organs of a scene: their names, colours, order, nodes and folder."""

from __future__ import annotations

import re

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from small_phantom import CENTER

from VICRegistrationLib.gui.option_texts import ELSEWHERE, WIDGETS
from VICRegistrationLib.registration.options import OPTIONS, FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def organs(logic):
    return logic.organs()


def labels(organs):
    return [organ.label for organ in organs]


def hierarchy_item(node):
    hierarchy = slicer.mrmlScene.GetSubjectHierarchyNode()
    return hierarchy, hierarchy.GetItemByDataNode(node)


def folder_of(node):
    """Item of the folder that holds a node."""
    hierarchy, item = hierarchy_item(node)
    return hierarchy.GetItemParent(item)


# --- the list --------------------------------------------------------------------------------------------------------


def test_two_organs_of_one_name_are_told_apart(organs):
    for _again in range(3):
        organs.add("bladder")
    assert labels(organs) == ["bladder", "bladder 2", "bladder 3"]
    organs.remove(list(organs)[1])
    organs.add("bladder")
    assert labels(organs) == ["bladder", "bladder 3", "bladder 2"]


def test_two_fits_of_one_name_have_nodes_of_their_own(logic):
    from VICRegistrationLib.mrml.organ_nodes import nodesOf

    volume = mrml_scenes.add_volume()
    first, second = (logic.fit(volume, [CENTER], name="bladder") for _again in range(2))
    assert {node.GetID() for node in nodesOf(first)}.isdisjoint(node.GetID() for node in nodesOf(second))
    assert first.regionSegmentId != second.regionSegmentId
    assert second.surface.GetName() == "bladder 2 surface"


def test_the_list_keeps_its_order_and_a_new_organ_is_the_current_one(organs):
    for name in ("vagina", "bladder", "rectum"):
        organ = organs.add(name)
        assert organs.current() is organ
    assert labels(organs) == ["vagina", "bladder", "rectum"]
    assert len(organs) == 3


def test_another_list_of_the_scene_holds_the_same_organs(logic, organs):
    organ = organs.add("bladder")
    (other,) = logic.organs()
    other.label = "urinary bladder"
    assert organ.label == "urinary bladder"
    assert organs.of(organ.parameterNode) is organ


@pytest.mark.parametrize(("removed", "current"), [(0, "b"), (1, "c"), (2, "b")])
def test_after_the_current_organ_its_neighbour_is_the_current_one(organs, removed, current):
    made = [organs.add(name) for name in "abc"]
    organs.parameters.current = made[removed].parameterNode
    organs.remove(made[removed])
    assert organs.current().label == current


def test_removing_another_organ_keeps_the_current_one(organs):
    made = [organs.add(name) for name in "abc"]
    organs.remove(made[0])
    assert organs.current() is made[2]
    organs.remove(made[1])
    organs.remove(made[2])
    assert organs.current() is None
    assert len(organs) == 0


def test_organs_that_others_deleted_are_passed_over(organs, scene):
    made = [organs.add(name) for name in "abc"]
    scene.RemoveNode(made[2].parameterNode)
    assert labels(organs) == ["a", "b"]
    assert organs.current() is None
    organs.adopt()
    assert organs.current().label == "a"
    assert len(organs.parameters.organs) == 2


def test_a_name_is_free_for_an_organ_that_failed(logic):
    volume = mrml_scenes.add_volume()
    with pytest.raises(ValueError, match="outside"):
        logic.fit(volume, [CENTER + 100.0], name="bladder")
    assert logic.fit(volume, [CENTER], name="bladder").label == "bladder"


# --- removing --------------------------------------------------------------------------------------------------------


def test_a_removed_organ_leaves_no_node(logic, scene):
    volume = mrml_scenes.add_volume()
    logic.getParameterNode()
    before = mrml_scenes.content(scene)
    organ = logic.fit(volume, [CENTER], name="bladder", boundaryPoints=[CENTER + [14, 0, 0]])
    assert len(mrml_scenes.content(scene)) > len(before) + 10
    logic.organs().remove(organ)
    assert mrml_scenes.content(scene) == before


def test_a_removed_organ_leaves_no_node_after_saving(logic, scene, tmp_path):
    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], name="bladder")
    assert slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    logic.organs().remove(organ)
    kept = [node for node in slicer.util.getNodesByClass("vtkMRMLStorageNode") if node is not volume.GetStorageNode()]
    assert [node for node in kept if not node.IsA("vtkMRMLColorTableStorageNode")] == []


@pytest.mark.parametrize("gone", ["plot", "convergence", "surface", "seeds", "boundaryPoints", "regions"])
def test_an_organ_that_lacks_a_node_is_removed_with_the_rest(logic, scene, gone):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    scene.RemoveNode(getattr(organ, gone))
    logic.organs().remove(organ)
    assert [kind for kind, count in mrml_scenes.owned_counts(scene).items() if count] == ["ScriptedModule"]


def test_organs_that_stay_are_not_touched(logic, scene):
    volume = mrml_scenes.add_volume()
    stays = logic.fit(volume, [CENTER], name="stays")
    voxels, content = mrml_scenes.segment_voxels(stays, volume), mrml_scenes.content(scene)
    logic.organs().remove(logic.fit(volume, [CENTER], name="goes"))
    assert mrml_scenes.content(scene) == content
    assert (mrml_scenes.segment_voxels(stays, volume) == voxels).all()


def test_segments_of_others_in_the_segmentation_stay(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    regions = organ.regions
    regions.GetSegmentation().AddEmptySegment("mine", "Mine", [1, 0, 0])
    logic.organs().remove(organ)
    assert regions.GetScene() is not None
    assert list(regions.GetSegmentation().GetSegmentIDs()) == ["mine"]


def test_renaming_an_organ_renames_its_nodes_and_its_segment(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name="bladder")
    organ.surface.SetName("my surface")
    logic.organs().rename(organ, "  urinary bladder ")
    assert organ.label == "urinary bladder"
    assert organ.seeds.GetName() == "urinary bladder seeds"
    assert organ.convergence.GetName() == organ.plot.GetName() == "urinary bladder convergence"
    assert organ.plot.GetNthPlotSeriesNode(0).GetName() == "urinary bladder convergence"
    assert organ.surface.GetName() == "my surface"
    assert organ.regions.GetSegmentation().GetSegment(organ.regionSegmentId).GetName() == "urinary bladder"


@pytest.mark.parametrize("name", ["", "   ", "vagina", "bladder"])
def test_names_that_are_blank_or_taken_are_not_given(organs, name):
    organ = organs.add("bladder")
    organs.add("vagina")
    organs.rename(organ, name)
    assert labels(organs) == ["bladder", "vagina"]


@pytest.mark.parametrize(
    "name", ["Blase, übervoll (2)", "a/b\\c", 'quo"ted', "<b>", "x" * 300, "50 % full", "%s%n {organ} $1"]
)
def test_any_text_is_a_name(logic, tmp_path, name):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name=name)
    assert organ.label == name
    net = logic.surface(organ).control_net.tobytes()
    path = str(tmp_path / "scene.mrb")
    assert slicer.util.saveScene(path)
    slicer.mrmlScene.Clear()
    slicer.util.loadScene(path)
    (organ,) = logic.organs()
    assert organ.label == name
    assert logic.surface(organ).control_net.tobytes() == net


def test_presets_have_their_colours_and_others_those_that_are_free(organs):
    from VICRegistrationLib.mrml.organs import PRESETS

    assert list(PRESETS) == ["bladder", "vagina", "rectum", "uterus"]
    for name, color in PRESETS.items():
        assert organs.add(name).color == color
    others = [organs.add("tumour").color for _again in range(4)]
    assert len({*others, *PRESETS.values()}) == 8


def test_the_colour_is_that_of_everything_that_belongs_to_the_organ(logic):
    from VICRegistrationLib.mrml.organ_nodes import paint

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name="bladder")
    for color in (organ.color, (0.1, 0.2, 0.3)):
        organ.color = color
        paint(organ)
        segment = organ.regions.GetSegmentation().GetSegment(organ.regionSegmentId)
        shown = [
            organ.surface.GetDisplayNode().GetColor(),
            organ.seeds.GetDisplayNode().GetSelectedColor(),
            segment.GetColor(),
            organ.plot.GetNthPlotSeriesNode(0).GetColor(),
        ]
        assert shown == [pytest.approx(color)] * 4


def test_an_organ_is_hidden_and_shown_with_all_that_belongs_to_it(logic):
    from VICRegistrationLib.mrml.organ_nodes import isVisible, setVisible

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    display = organ.regions.GetDisplayNode()
    for visible in (False, True):
        setVisible(organ, visible)
        assert isVisible(organ) is visible
        assert bool(organ.surface.GetDisplayNode().GetVisibility()) is visible
        assert bool(organ.seeds.GetDisplayNode().GetVisibility()) is visible
        # The region is in the way of a surface; it is shown again where that is asked for.
        assert not display.GetSegmentVisibility(organ.regionSegmentId)


def test_before_there_is_a_surface_the_region_is_hidden_and_shown(logic):
    from VICRegistrationLib.mrml.organ_nodes import isVisible, setVisible

    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER])
    display = organ.regions.GetDisplayNode()
    for visible in (False, True):
        setVisible(organ, visible)
        assert isVisible(organ) is visible
        assert bool(display.GetSegmentVisibility(organ.regionSegmentId)) is visible


# --- folder and settings ---------------------------------------------------------------------------------------------


def test_what_belongs_to_the_organs_of_a_volume_is_in_one_folder_beside_it(logic):
    from VICRegistrationLib.mrml.organ_nodes import nodesOf

    volume, other = mrml_scenes.add_volume(), mrml_scenes.add_volume(name="other")
    made = [logic.fit(volume, [CENTER], name=name) for name in ("bladder", "vagina")]
    elsewhere = logic.fit(other, [CENTER], name="rectum")
    nodes = [node for organ in made for node in [*nodesOf(organ), organ.regions]]
    assert len(nodes) == 14
    folders = {folder_of(node) for node in nodes}
    assert len(folders) == 1
    hierarchy, item = hierarchy_item(volume)
    (folder,) = folders
    assert hierarchy.GetItemName(folder) == "mri organs"
    assert hierarchy.GetItemParent(folder) == hierarchy.GetItemParent(item)
    assert hierarchy.GetItemName(folder_of(elsewhere.surface)) == "other organs"


def test_a_folder_that_was_renamed_stays_the_folder(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    hierarchy, item = hierarchy_item(organ.surface)
    folder = folder_of(organ.surface)
    hierarchy.SetItemName(folder, "my organs")
    logic.addOrgan(logic.getParameterNode().volume, [CENTER])
    assert hierarchy.GetItemParent(item) == folder
    names = [hierarchy.GetItemName(folder_of(each.seeds)) for each in logic.organs()]
    assert names == ["my organs", "my organs"]


def test_options_and_parameters_are_turned_into_each_other(organs):
    organ = organs.add("bladder")
    assert organ.options() == FitOptions()
    options = FitOptions(
        net=(13, 9),
        closure="paper",
        solver="gradient-descent",
        tau=2.25,
        profile="paper",
        loss="huber",
        model="tube",
        levels="given",
        inside=812.5,
        outside=100.0,
        smoothness=0.0,
        tolerance=0.05,
        max_iterations=70,
        boundary_weight=2.0,
    )
    organ.setFitOptions(options)
    assert organ.options() == options
    published = FitOptions.as_published()
    organ.setFitOptions(published)
    found = organ.options()
    assert (found.closure, found.solver, found.profile, found.levels) == ("paper", "gradient-descent", "paper", "organ")
    assert (found.smoothness, found.net, found.tau) == (published.smoothness, published.net, None)
    organ.setFitOptions(FitOptions())
    assert organ.options() == FitOptions()


def test_options_that_are_refused_change_nothing(organs):
    organ = organs.add("bladder")
    # What a fit has found may lie beyond what may be given.
    found = FitOptions(closure="paper", net=(11, 9)).filled_in(tau=50.0)
    with pytest.raises(ValueError, match=r"^The edge width \(tau\) is 50.0; it must be a number from 0.01 to 20 mm.$"):
        organ.setFitOptions(found)
    assert organ.options() == FitOptions()


@pytest.mark.parametrize(
    ("parameter", "value", "sentence"),
    [
        ("tauMm", 50.0, "The edge width (tau) is 50.0; it must be a number from 0.01 to 20 mm."),
        ("netRows", 4, "The control net is 4; it must be two whole numbers ROWSxCOLUMNS from 5 to 65."),
        ("smoothnessLog10", 0.5, "The smoothness is 10^0.5; it must be 0, or a number from 1e-08 to 1."),
        ("maxIterations", 20000, "The iteration limit is 20000; it must be a whole number from 1 to 10000."),
        ("erosionMm", -1.0, "The erosion is -1.0; it must be a number from 0 to 20 mm."),
    ],
)
def test_a_parameter_outside_of_its_range_is_refused_by_the_sentence_of_its_option(organs, parameter, value, sentence):
    organ = organs.add("bladder")
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        setattr(organ, parameter, value)
    assert organ.options() == FitOptions()


def test_smoothness_comes_back_as_it_was_stored(organs):
    organ = organs.add("bladder")
    for smoothness in (0.0, *10.0 ** np.arange(-8.0, 0.1, 0.5), 0.0):
        organ.setFitOptions(FitOptions(smoothness=min(smoothness, 1.0)))
        assert organ.options().smoothness == pytest.approx(smoothness, rel=1e-12)


def test_every_option_has_a_parameter(organs):
    shown = (*WIDGETS, *ELSEWHERE)
    assert {name for name, _, _ in shown} == set(OPTIONS)
    assert {parameter for _, parameter, _ in shown} <= set(type(organs.add("bladder")).allParameters)


def test_names_are_such_that_slicer_can_save_them(logic):
    organ = logic.organs().add("wall & tumour")
    assert organ.label == "wall + tumour"
    logic.organs().rename(organ, "a&b")
    assert organ.label == "a+b"
