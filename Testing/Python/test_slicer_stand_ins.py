"""The bench that stands in for Slicer: it must behave as Slicer does, and refuse what Slicer refuses."""

from __future__ import annotations

import enum
from typing import Annotated, Optional

import numpy as np
import pytest

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")


class Kind(enum.Enum):
    """Chosen in a combo box."""

    LIVER = "liver"
    KIDNEY = "kidney"


@pytest.fixture
def wrapper(scene):
    """A parameter node wrapper with a parameter of each type in use."""
    from slicer.parameterNodeWrapper import Default, FloatRange, RangeBounds, WithinRange, parameterNodeWrapper

    def make(node=None):
        return Parameters(node or scene.AddNewNodeByClass("vtkMRMLScriptedModuleNode"))

    # At run time, for this file can be read without slicer.
    hints = {
        "label": str,
        "color": tuple[float, float, float],
        "threshold": Annotated[FloatRange, RangeBounds(-1000, 1000), Default(FloatRange(0, 300))],
        "erosion": Annotated[float, WithinRange(0, 20)],
        "net": int,
        "smooth": bool,
        "kind": Kind,
        "seeds": Optional[slicer.vtkMRMLMarkupsFiducialNode],
        "organs": list[slicer.vtkMRMLScriptedModuleNode],
    }
    defaults = {"label": "organ", "color": (1.0, 0.5, 0.0), "erosion": 2.0, "net": 9, "smooth": True}
    cls = type("Parameters", (), {"__annotations__": hints, "__module__": __name__, **defaults})
    Parameters = parameterNodeWrapper(cls)
    return make


@pytest.fixture
def events():
    """Counts the ModifiedEvents of a node."""

    def count(node):
        seen = []
        node.AddObserver("ModifiedEvent", lambda *_: seen.append(1))
        return seen

    return count


def segmentOf(volume, mask):
    """A segmentation with one segment "a" of a volume."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", "regions")
    node.CreateDefaultDisplayNodes()
    node.SetReferenceImageGeometryParameterFromVolumeNode(volume)
    node.GetSegmentation().AddEmptySegment("a", "A", [1, 0, 0])
    slicer.util.updateSegmentBinaryLabelmapFromArray(mask, node, "a", volume)
    return node


# --- the scene -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("visit", [1, 2])
def test_each_test_starts_with_an_empty_scene(scene, visit):
    assert not slicer.util.getNodes("left behind*")
    assert scene.GetNumberOfNodesByClass("vtkMRMLScriptedModuleNode") == 0
    node = scene.AddNewNodeByClass("vtkMRMLScriptedModuleNode", f"left behind {visit}")
    node.SetSingletonTag("left")
    for kind in ("vtkMRMLSliceNode", "vtkMRMLSliceCompositeNode", "vtkMRMLViewNode"):
        assert scene.GetNumberOfNodesByClass(kind) == 0
        scene.AddNewNodeByClass(kind).SetLayoutName("Red")


def test_an_error_in_an_observer_reaches_the_test(scene):
    import sys

    node = scene.AddNewNodeByClass("vtkMRMLModelNode")
    node.AddObserver("ModifiedEvent", lambda *_: 1 / 0)
    seen = []
    sys.excepthook, kept = lambda kind, error, trace: seen.append(kind), sys.excepthook
    node.Modified()
    sys.excepthook = kept
    assert seen == [ZeroDivisionError]


def test_complaints_of_mrml_are_heard(scene, vtk_messages):
    assert vtk_messages() == ""
    volume = slicer.util.addVolumeFromArray(np.zeros((2, 2, 2)))
    segmentOf(volume, np.ones((2, 2, 2), np.uint8)).GetDisplayNode().GetSegmentVisibility("no such")
    assert "No display properties" in vtk_messages()


# --- strictness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        ("app", "layoutManger"),
        ("modules", "segmentation"),
        ("i18n", "gettext"),
        ("ScriptedLoadableModule", "ScriptedLoadableModuleGui"),
        ("parameterNodeWrapper", "FloatRnage"),
    ],
)
def test_a_name_that_slicer_does_not_have_is_an_attribute_error(scene, owner, name):
    with pytest.raises(AttributeError, match=name):
        getattr(getattr(slicer, owner), name)


def test_unknown_signals_are_refused(scene):
    with pytest.raises(AttributeError, match="startupComplete"):
        slicer.app.connect("startupComplete()", print)
    with pytest.raises(AttributeError, match="no signal"):
        slicer.app.moduleManager().connect("moduleUnloaded(QString)", print)


def test_a_misspelt_parameter_is_refused(wrapper):
    with pytest.raises(AttributeError, match="Parameters.*erosionMM"):
        wrapper().erosionMM = 3
    with pytest.raises(AttributeError, match="Parameters.*erosionMM"):
        wrapper().erosionMM  # noqa: B018


# --- parameters ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("erosion", np.float32(3), TypeError),
        ("erosion", 20.5, ValueError),
        ("erosion", None, ValueError),
        ("erosion", float("nan"), ValueError),
        ("net", np.int64(3), TypeError),
        ("net", 3.0, TypeError),
        ("smooth", 1, TypeError),
        ("label", None, ValueError),
        ("color", (1.0, 0.0), ValueError),
        ("color", (np.float32(1), 0.0, 0.0), TypeError),
        ("kind", "KIDNEY", TypeError),
        ("threshold", None, ValueError),
        ("seeds", "node", TypeError),
        ("organs", [3], TypeError),
    ],
)
def test_values_of_a_wrong_type_or_size_are_refused(wrapper, name, value, error):
    p = wrapper()
    before = getattr(p, name)
    with pytest.raises(error):
        setattr(p, name, value)
    assert getattr(p, name) == before


def test_a_change_gives_one_event_and_none_without_change(wrapper, events):
    p = wrapper()
    seen = events(p.parameterNode)
    p.erosion = 5.0
    assert len(seen) == 1
    p.erosion = 5.0
    assert len(seen) == 1
    p.color = (0.1, 0.2, 0.3)
    assert len(seen) == 2
    p.organs = [p.parameterNode]
    assert len(seen) == 3
    with slicer.util.NodeModify(p):
        p.erosion, p.net, p.smooth = 6.0, 7, False
    assert len(seen) == 4


def test_a_bound_for_a_range_stops_only_what_slicer_stops(wrapper):
    from slicer.parameterNodeWrapper import FloatRange

    p = wrapper()
    with pytest.raises(ValueError, match="RangeBounds"):
        p.threshold = FloatRange(-2000, 5)
    p.threshold = FloatRange(0, 5000)
    assert p.threshold.maximum == 5000
    with pytest.raises(ValueError, match="minimum <= maximum"):
        p.threshold = FloatRange(6000, 5000)
