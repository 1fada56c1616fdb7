"""A scene saved as .mrb and loaded again: every setting, reference, voxel and control point comes back."""

from __future__ import annotations

import enum
import gc

import mrml_boot
import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER

from VICRegistrationLib.registration.options import FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

# Every setting of an organ with a value that is not its default, as text or number; enums by name.
OTHER_SETTINGS = {
    "color": (0.125, 0.3, 0.7),
    "thresholdAutomatic": False,
    "erosionMm": 1.7,
    "erosionAutomatic": False,
    "dilationMm": 2.3,
    "dilationAutomatic": False,
    "netRows": 11,
    "netColumns": 9,
    "netAutomatic": False,
    "closure": "PAPER",
    "tauMm": 2.1,
    "tauAutomatic": False,
    "profile": "PAPER",
    "levels": "GIVEN",
    "inside": 812.25,
    "outside": 1.0 / 3.0,
    "smoothnessLog10": -4.2,
    "smoothnessAutomatic": False,
    "loss": "HUBER",
    "genericModel": "TUBE",
    "solver": "GRADIENT_DESCENT",
    "stopping": "PUBLISHED",
    "toleranceMm": 0.07,
    "maxIterations": 123,
    "boundaryWeight": 0.4,
    "inputSegmentId": "some segment",
    "referenceKind": "MODEL",
    "referenceSegmentId": "some other segment",
}
NODES = (
    *("seeds", "boundaryPoints", "regions", "surface", "convergence", "plot", "inputSegmentation"),
    *("referenceSegmentation", "referenceModel"),
)
RESULTS = (
    *("label", "source", "threshold", "regionSegmentId", "state", "message", "volumeMl"),
    *("verdict", "verdictReasons"),
)
# Looked at in test_mrml_stacks.py.
STACKS = ("stackVolumes", "stackRecords", "stackContours")


@pytest.fixture
def through_a_bundle(scene, tmp_path):
    """Save the scene, empty it, and load it again."""

    def save_and_load():
        path = str(tmp_path / "scene.mrb")
        assert slicer.util.saveScene(path)
        mrml_boot.clear(scene)
        slicer.util.loadScene(path)

    return save_and_load


def set_others(organ):
    for name, value in OTHER_SETTINGS.items():
        old = getattr(organ, name)
        setattr(organ, name, type(old)[value] if isinstance(old, enum.Enum) else value)


def plain(value):
    """A parameter's value for comparison."""
    if isinstance(value, enum.Enum):
        return value.name
    if hasattr(value, "minimum"):
        return (value.minimum, value.maximum)
    return value


def parameters(organ, names):
    return {name: plain(getattr(organ, name)) for name in names}


def net_and_knots(surface):
    return surface.control_net.tobytes(), surface.knots_u.tobytes(), surface.knots_v.tobytes(), surface.degrees


def test_every_parameter_is_looked_at(logic):
    organ = logic.organs().add("organ")
    assert {*OTHER_SETTINGS, *NODES, *RESULTS, *STACKS} == set(organ.allParameters)
    defaults = parameters(organ, OTHER_SETTINGS)
    assert all(defaults[name] != value for name, value in OTHER_SETTINGS.items())


def test_every_setting_comes_back(logic, through_a_bundle):
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER], (650.0, 1.0 / 3.0 + 900.0), name="bladder")
    set_others(organ)
    results = parameters(organ, RESULTS)
    through_a_bundle()
    (organ,) = logic.organs()
    assert parameters(organ, OTHER_SETTINGS) == OTHER_SETTINGS
    assert parameters(organ, RESULTS) == results
    assert results["threshold"] == (650.0, 1.0 / 3.0 + 900.0)


def test_a_scene_without_the_automatic_net_and_smoothness_is_read(logic, through_a_bundle):
    # As the module wrote it before a fit chose them: the parameters are not in the node.
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER], name="bladder")
    organ.netRows = 13
    for name in ("netAutomatic", "smoothnessAutomatic"):
        organ.parameterNode.UnsetParameter(name)
    through_a_bundle()
    (organ,) = logic.organs()
    assert (organ.netRows, organ.netAutomatic, organ.smoothnessAutomatic) == (13, True, True)
    assert (organ.options().net, organ.options().smoothness) == (None, None)


def test_choices_and_records_of_another_version_are_passed_over(logic, through_a_bundle):
    from VICRegistrationLib.mrml.stacks import stacksOf

    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER], name="bladder")
    organ.netRows, organ.solver = 13, type(organ.solver).GRADIENT_DESCENT
    organ.stackVolumes, organ.stackRecords = [volume], ['{"used": false, "reason": "moved", "later": 1}']
    node = organ.parameterNode
    # A wrapper would read it, and fail.
    del organ
    gc.collect()
    for name in ("loss", "state"):
        node.SetParameter(name, "UNHEARD_OF")
    through_a_bundle()
    (organ,) = logic.organs()
    assert (organ.loss.name, organ.state.name, organ.solver.name) == ("SQUARES", "NEW", "GRADIENT_DESCENT")
    assert organ.netRows == 13
    (record,) = stacksOf(organ).values()
    assert (record.used, record.reason) == (False, "moved")


@pytest.mark.parametrize("renamed", [False, True])
def test_every_node_comes_back_under_whatever_name(logic, through_a_bundle, renamed):
    volume = mrml_scenes.add_volume()
    organs = [logic.fit(volume, [CENTER], name=name) for name in ("bladder", "vagina")]
    for organ in organs:
        organ.inputSegmentation = organ.referenceSegmentation = organ.regions
        organ.referenceModel = organs[0].surface
        organ.boundaryPoints.AddControlPointWorld(1.0, 2.0, 3.0)
    if renamed:
        for count, node in enumerate(slicer.util.getNodesByClass("vtkMRMLNode")):
            if not node.GetSingletonTag() and not node.IsA("vtkMRMLColorNode"):
                node.SetName(f"renamed {count}")
    names = [{name: getattr(organ, name).GetName() for name in NODES} for organ in organs]
    through_a_bundle()
    parameterNode = logic.getParameterNode()
    assert [organ.label for organ in logic.organs()] == ["bladder", "vagina"]
    assert parameterNode.current.GetParameter("label") == "vagina"
    assert parameterNode.volume.GetName() == ("mri" if not renamed else parameterNode.volume.GetName())
    np.testing.assert_array_equal(slicer.util.arrayFromVolume(parameterNode.volume), mrml_scenes.mri().array)
    for organ, expected in zip(logic.organs(), names):
        assert {name: getattr(organ, name).GetName() for name in NODES} == expected
        seeds = slicer.util.arrayFromMarkupsControlPoints(organ.seeds, world=True)
        np.testing.assert_allclose(seeds, [CENTER], atol=1e-3)
        assert organ.boundaryPoints.GetNumberOfControlPoints() == 1


def test_control_net_and_knots_come_back_bit_for_bit(logic, through_a_bundle):
    matrix = motion(40, (1, 2, -1), (10, -5, 3))
    volume = mrml_scenes.add_volume(mrml_scenes.oblique(matrix=matrix))
    organ = logic.fit(volume, matrix[:3, :3] @ CENTER + matrix[:3, 3], options=FitOptions(net=(12, 10)))
    before = net_and_knots(logic.surface(organ))
    points = slicer.util.arrayFromModelPoints(organ.surface).copy()
    through_a_bundle()
    (organ,) = logic.organs()
    assert net_and_knots(logic.surface(organ)) == before
    # The net is in RAS whatever the file's frame is: it must lie around the points.
    found = slicer.util.arrayFromModelPoints(organ.surface)
    np.testing.assert_allclose(found, points, atol=1e-4)
    net = logic.surface(organ).control_net.reshape(-1, 3)
    assert np.all(net.min(axis=0) <= found.min(axis=0) + 1e-3)
    assert np.all(net.max(axis=0) >= found.max(axis=0) - 1e-3)


@pytest.mark.parametrize("under", ["nothing", "linear", "nonlinear"])
def test_segment_voxels_and_places_in_the_world_come_back(logic, through_a_bundle, under):
    matrix = motion(75, (1, 2, -1), (30, -60, 12))
    spline = mrml_scenes.thin_plate_spline()
    node, seed = {
        "nothing": lambda: (None, CENTER),
        "linear": lambda: (mrml_scenes.add_linear_transform(matrix), matrix[:3, :3] @ CENTER + matrix[:3, 3]),
        "nonlinear": lambda: (mrml_scenes.add_nonlinear_transform(spline), spline.TransformPoint(CENTER)),
    }[under]()
    volume = mrml_scenes.add_volume(under=node)
    organ = logic.fit(volume, seed)
    voxels, points = mrml_scenes.segment_voxels(organ, volume), mrml_scenes.hardened_points(organ.surface)
    through_a_bundle()
    (organ,) = logic.organs()
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, logic.getParameterNode().volume), voxels)
    np.testing.assert_allclose(mrml_scenes.hardened_points(organ.surface), points, atol=1e-3)


def test_table_columns_and_plot_come_back(logic, through_a_bundle):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    table = organ.convergence.GetTable()
    names = [table.GetColumnName(column) for column in range(table.GetNumberOfColumns())]
    numbers = {name: slicer.util.arrayFromTableColumn(organ.convergence, name).copy() for name in names[1:]}
    stages = [table.GetColumnByName("Stage").GetValue(row) for row in range(table.GetNumberOfRows())]
    through_a_bundle()
    (organ,) = logic.organs()
    table = organ.convergence.GetTable()
    assert [table.GetColumnName(column) for column in range(table.GetNumberOfColumns())] == names
    assert [table.GetColumnByName("Stage").GetValue(row) for row in range(table.GetNumberOfRows())] == stages
    for name, values in numbers.items():
        # Tables are written with 6 digits.
        np.testing.assert_allclose(slicer.util.arrayFromTableColumn(organ.convergence, name), values, rtol=1e-5)
    series = organ.plot.GetNthPlotSeriesNode(0)
    assert series.GetTableNode() is organ.convergence
    assert series.GetYColumnName() == "Cost"


def test_work_goes_on_after_loading(logic, through_a_bundle):
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.registration.steps import finish

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    net = logic.surface(organ).control_net
    through_a_bundle()
    logic.organs().adopt()
    (organ,) = logic.organs()
    before = mrml_scenes.content(slicer.mrmlScene)
    finish(fitSteps(organ, logic.getParameterNode().volume))
    # Seeds are written in decimals.
    np.testing.assert_allclose(logic.surface(organ).control_net, net, atol=0.01)
    added = [entry for entry in mrml_scenes.content(slicer.mrmlScene) if entry not in before]
    # The stand-in does not bring folders back: a new one may be made.
    assert [entry for entry in added if not entry.startswith("item ")] == []
    logic.organs().remove(organ)
    assert not slicer.util.getNodesByClass("vtkMRMLModelNode")


def test_loading_into_a_scene_with_organs_keeps_both(logic, scene, tmp_path):
    path = str(tmp_path / "scene.mrb")
    saved = logic.fit(mrml_scenes.add_volume(name="saved"), [CENTER], name="saved organ")
    net = logic.surface(saved).control_net
    assert slicer.util.saveScene(path)
    mrml_boot.clear(scene)
    volume = mrml_scenes.add_volume(name="here")
    here = [logic.fit(volume, [CENTER], name=name, options=FitOptions(net=(7, 7))) for name in ("bladder", "vagina")]
    nets = [logic.surface(organ).control_net for organ in here]
    slicer.util.loadScene(path)
    organs = logic.organs()
    organs.adopt()
    found = {organ.label: organ for organ in organs}
    assert set(found) == {"bladder", "vagina", "saved organ"}
    np.testing.assert_array_equal(logic.surface(found["saved organ"]).control_net, net)
    for name, expected in zip(("bladder", "vagina"), nets):
        np.testing.assert_array_equal(logic.surface(found[name]).control_net, expected)
    # Every organ has nodes of its own, and its segment is on the grid of its own volume.
    assert len({organ.surface.GetID() for organ in found.values()}) == 3
    assert found["saved organ"].regions is not found["bladder"].regions
    again = logic.organs()
    again.adopt()
    assert len(again) == 3
    for organ in list(logic.organs()):
        logic.organs().remove(organ)
    for kind in ("Model", "MarkupsFiducial", "Table", "PlotChart", "PlotSeries", "Segmentation"):
        assert not slicer.util.getNodesByClass(f"vtkMRML{kind}Node"), kind
