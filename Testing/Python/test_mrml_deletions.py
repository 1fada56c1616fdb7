"""Nodes deleted at any time, fits cancelled, scenes closed: a clear error or an undisturbed fit, nothing is left."""

from __future__ import annotations

import itertools

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER

from VICRegistrationLib.registration.options import FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def fitted(logic):
    """An organ with every node it can have, and its volume."""
    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], name="bladder", options=QUICK)
    # Five millimetres outside: a refit has something to do.
    organ.boundaryPoints.AddControlPointWorld(*(CENTER + [19.0, 0.0, 0.0]))
    return organ, volume


@pytest.fixture
def start(slicer_module):
    """Start a fit or a refit."""
    from VICRegistrationLib.mrml import fitting

    return {"fit": fitting.fitSteps, "refit": fitting.refitSteps}


# A coarse fit that stops early: what it finds does not matter here.
QUICK = FitOptions(net=(7, 5), tolerance=1.0, levels="organ")
# What can be deleted, and where it is found.
NODES = {
    "volume": lambda organ, logic: logic.getParameterNode().volume,
    "seeds": lambda organ, logic: organ.seeds,
    "boundary points": lambda organ, logic: organ.boundaryPoints,
    "segmentation": lambda organ, logic: organ.regions,
    "surface": lambda organ, logic: organ.surface,
    "table": lambda organ, logic: organ.convergence,
    "chart": lambda organ, logic: organ.plot,
    "series": lambda organ, logic: organ.plot.GetNthPlotSeriesNode(0),
    "organ": lambda organ, logic: organ.parameterNode,
    "module": lambda organ, logic: logic.getParameterNode().parameterNode,
}
WHAT = [*NODES, "segment"]
MADE_BY_THE_FIT = ("boundary points", "table", "chart", "series")
# What a fit cannot do without, at its start and under way, and what is said then.
NEEDED = {
    ("fit", "start"): {
        "volume": "No volume is chosen",
        "seeds": "bladder has no seed",
        "organ": "organ was deleted.*Add the organ again",
    },
    ("refit", "start"): {
        "volume": "No volume is chosen",
        "surface": "bladder has no surface yet",
        "organ": "organ was deleted.*Add the organ again",
    },
    "under way": {
        "volume": "volume mri was deleted.*Choose a volume and fit again",
        "surface": "surface was deleted.*Fit the organ again",
        "organ": "organ was deleted.*Add the organ again",
    },
}


def delete(what, organ, logic):
    if what == "segment":
        organ.regions.GetSegmentation().RemoveSegment(organ.regionSegmentId)
    else:
        slicer.mrmlScene.RemoveNode(NODES[what](organ, logic))


def run(steps):
    """Run a fit to its end, with the model following; returns the number of steps."""
    return sum(1 for _step in steps)


def followed(steps, organ):
    """Steps of a fit with the model following them, as in the panel."""
    from VICRegistrationLib.mrml.surfaces import moveSurface

    for step in steps:
        if organ.surface is not None:
            moveSurface(organ.surface, step.surface)
        yield step


@pytest.mark.parametrize("what", WHAT)
@pytest.mark.parametrize("kind", ["fit", "refit"])
def test_what_is_deleted_before_the_first_step(logic, fitted, start, scene, what, kind):
    organ, volume = fitted
    counts = mrml_scenes.owned_counts(scene)
    steps = start[kind](organ, volume)
    delete(what, organ, logic)
    content = mrml_scenes.content(scene)
    message = NEEDED[kind, "start"].get(what)
    if message is not None:
        with pytest.raises(ValueError, match=message):
            run(steps)
        assert mrml_scenes.content(scene) == content
        return
    assert run(steps) > 0
    assert organ.state.value == "fitted"
    # What shows the result was made again, once; what the user places or what is not needed was not.
    made = mrml_scenes.owned_counts(scene)
    gone = {
        "boundary points": "MarkupsFiducial",
        "seeds": "MarkupsFiducial",
        "module": "ScriptedModule",
        "segmentation": "Segmentation" if kind == "refit" else None,
    }.get(what)
    assert made == {name: count - (name == gone) for name, count in counts.items()}
    assert organ.plot.GetNthPlotSeriesNode(0).GetTableNode() is organ.convergence


@pytest.mark.parametrize("what", WHAT)
@pytest.mark.parametrize("kind", ["fit", "refit"])
def test_what_is_deleted_during_the_fit(logic, fitted, start, scene, what, kind):
    organ, volume = fitted
    counts = mrml_scenes.owned_counts(scene)
    steps = followed(start[kind](organ, volume), organ)
    next(steps)
    delete(what, organ, logic)
    content = mrml_scenes.content(scene)
    message = NEEDED["under way"].get(what)
    if message is not None:
        with pytest.raises(ValueError, match=message):
            run(steps)
        assert mrml_scenes.content(scene) == content
        return
    assert run(steps) > 0
    assert organ.state.value == "fitted"
    assert logic.surface(organ).control_net.shape[2] == 3
    gone = {
        "boundary points": "MarkupsFiducial",
        "seeds": "MarkupsFiducial",
        "module": "ScriptedModule",
        "segmentation": "Segmentation",
    }.get(what)
    assert mrml_scenes.owned_counts(scene) == {name: count - (name == gone) for name, count in counts.items()}


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        *(("fit", what) for what in ("nothing", *WHAT)),
        *(("refit", what) for what in ("nothing", "volume", "boundary points", "surface", "organ")),
    ],
)
def test_a_cancelled_fit_leaves_everything_as_it_was(logic, fitted, start, scene, kind, what):
    organ, volume = fitted
    surface, data = logic.surface(organ), organ.surface.GetPolyData()
    points = slicer.util.arrayFromModelPoints(organ.surface).copy()
    steps = start[kind](organ, volume)
    for _step in itertools.islice(followed(steps, organ), 2):
        pass
    model = organ.surface
    assert model.GetPolyData() is not data
    if what != "nothing":
        delete(what, organ, logic)
    content = mrml_scenes.content(scene)
    steps.close()
    assert mrml_scenes.content(scene) == content
    if what != "surface":
        assert model.GetPolyData() is data
        np.testing.assert_array_equal(slicer.util.arrayFromModelPoints(model), points)
    if what not in ("surface", "organ"):
        np.testing.assert_array_equal(logic.surface(organ).control_net, surface.control_net)
        assert organ.state.value == "fitted"


def test_the_triangles_of_a_finished_fit_are_never_moved(logic, fitted):
    from VICRegistrationLib.export.surface_data import add_surface, polydata_of_mesh
    from VICRegistrationLib.geometry.triangulation import triangulate
    from VICRegistrationLib.mrml.surfaces import moveSurface

    organ, _volume = fitted
    surface = logic.surface(organ)
    # As many triangles as while moving.
    moveSurface(organ.surface, surface)
    count = organ.surface.GetPolyData().GetNumberOfPoints()
    finished = polydata_of_mesh(triangulate(surface, resolution=(64, 40)))
    assert finished.GetNumberOfPoints() == count
    add_surface(finished, surface, name="bladder")
    organ.surface.SetAndObservePolyData(finished)
    before = slicer.util.arrayFromModelPoints(organ.surface).copy()
    moved = surface.transformed(motion(0, (1, 0, 0), (5, 5, 5)))
    for _again in range(2):
        moveSurface(organ.surface, moved)
    assert organ.surface.GetPolyData() is not finished
    organ.surface.SetAndObservePolyData(finished)
    np.testing.assert_array_equal(slicer.util.arrayFromModelPoints(organ.surface), before)


@pytest.mark.parametrize("what", ["nothing", *(what for what in WHAT if what not in MADE_BY_THE_FIT)])
@pytest.mark.parametrize("end", ["cancel", "go on"])
def test_a_first_fit_that_does_not_end_leaves_no_surface(logic, start, scene, what, end):
    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER])
    steps = start["fit"](organ, volume)
    for _step in itertools.islice(followed(steps, organ), 2):
        pass
    if what != "nothing":
        delete(what, organ, logic)
    if end == "cancel":
        steps.close()
    elif what in NEEDED["under way"]:
        with pytest.raises(ValueError, match="was deleted"):
            run(steps)
    else:
        return
    counts = mrml_scenes.owned_counts(scene)
    assert counts["Model"] == counts["Table"] == counts["PlotChart"] == counts["PlotSeries"] == 0
    assert not slicer.util.getNodesByClass("vtkMRMLModelDisplayNode") or what == "surface"
    if what != "organ":
        assert organ.surface is None
        assert organ.state.value == ("separated" if end == "cancel" else "failed")
    # The organ can be fitted once more.
    if what in ("nothing", "segmentation", "segment", "surface", "module"):
        assert run(start["fit"](organ, volume)) > 0
        assert logic.surface(organ).volume() > 0


def test_an_error_leaves_the_surface_and_shows_why(logic, fitted, start, scene):
    organ, volume = fitted
    surface, content = logic.surface(organ), mrml_scenes.content(scene)
    organ.seeds.SetNthControlPointPositionWorld(0, 500, 0, 0)
    with pytest.raises(ValueError, match="outside the volume"):
        run(start["fit"](organ, volume))
    np.testing.assert_array_equal(logic.surface(organ).control_net, surface.control_net)
    assert "outside the volume" in organ.message
    assert organ.state.value == "fitted"
    assert mrml_scenes.content(scene) == content


@pytest.mark.parametrize("kind", ["fit", "refit"])
@pytest.mark.parametrize("then", ["cancel", "go on", "forget"])
def test_the_scene_is_closed_while_a_fit_waits(logic, fitted, start, scene, kind, then):
    organ, volume = fitted
    steps = start[kind](organ, volume)
    next(steps)
    scene.Clear(0)
    content = mrml_scenes.content(scene)
    if then == "cancel":
        steps.close()
    elif then == "forget":
        del steps
    else:
        with pytest.raises(ValueError, match="organ was deleted"):
            next(steps)
    assert mrml_scenes.content(scene) == content
    assert len(logic.organs()) == 0
    # Work goes on in the new scene.
    organ = logic.fit(mrml_scenes.add_volume(name="other"), [CENTER])
    assert logic.surface(organ).volume() > 0
