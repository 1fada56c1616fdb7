"""Fits on volume nodes: the same surface as that of the command line, on whatever grid and of whatever type."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion, reordered
from small_phantom import CENTER, SEED, ellipsoid

from VICRegistrationLib import cli
from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface_file import read_surface_record
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image, write_image
from VICRegistrationLib.registration.options import FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits")

# Asked for. The same numbers go through the same arithmetic, but for the matrix of the file, written in decimals.
SAME_MM = 1e-6
ELLIPSOID_ML = 4.0 / 3.0 * np.pi * 14.0 * 18.0 * 22.0 / 1000.0


def by_command_line(image, folder):
    """Surface that the command line finds in an image file."""
    write_image(image, folder / "mri.nrrd")
    words = ["fit", str(folder / "mri.nrrd"), "--organ", "organ", f"--seed={SEED}", "--output", str(folder / "out")]
    assert cli.main([*words, "--quiet", "--no-pictures"]) == 0
    return read_surface_record(folder / "out" / "organ.json").surface


def is_read_alike(image, folder):
    """Check that a volume node and a file of an image are the same for a fit."""
    from VICRegistrationLib.mrml.volumes import imageFromVolume

    write_image(image, folder / "mri.nrrd")
    found, expected = imageFromVolume(mrml_scenes.add_volume(image)), read_image(folder / "mri.nrrd")
    np.testing.assert_array_equal(found.array, expected.array)
    np.testing.assert_allclose(found.ijk_to_ras, expected.ijk_to_ras, atol=SAME_MM)


def as_type(image, dtype):
    """The small phantom in another type of voxel, with grey levels that fit into it."""
    levels = np.clip(np.rint(image.array / 4.0), 0, 127) if np.dtype(dtype).itemsize == 1 else image.array
    return Image(levels.astype(dtype), image.ijk_to_ras)


@pytest.mark.parametrize(
    ("order", "flips"),
    [
        ((0, 1, 2), (False, False, False)),
        ((0, 1, 2), (True, False, False)),
        ((2, 0, 1), (False, True, False)),
        ((1, 0, 2), (True, True, True)),
        ((2, 1, 0), (False, False, True)),
    ],
)
def test_a_volume_with_axes_in_any_order_is_the_image_of_its_file(scene, tmp_path, order, flips):
    is_read_alike(reordered(mrml_scenes.mri(), order, flips), tmp_path)


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16", "int32", "float32", "float64"])
def test_a_volume_with_voxels_of_any_type_is_the_image_of_its_file(scene, tmp_path, dtype):
    image = as_type(mrml_scenes.mri(), dtype)
    assert slicer.util.arrayFromVolume(mrml_scenes.add_volume(image)).dtype == dtype
    is_read_alike(image, tmp_path)


@pytest.mark.usefixtures("grown_regions")
def test_the_surface_is_that_of_the_command_line(logic, tmp_path):
    image = reordered(as_type(mrml_scenes.mri(), "uint8"), (1, 0, 2), (True, True, True))
    expected = by_command_line(image, tmp_path)
    found = logic.surface(logic.fit(mrml_scenes.add_volume(image), [CENTER]))
    assert np.abs(found.control_net - expected.control_net).max() < SAME_MM


@pytest.mark.usefixtures("grown_regions")
def test_an_oblique_volume_gives_the_surface_of_the_command_line(logic, tmp_path):
    # About the centre, so that the seed stays in it.
    turn = motion(35, (1, -2, 1))
    turn[:3, 3] = CENTER - turn[:3, :3] @ CENTER
    image = mrml_scenes.oblique(matrix=turn)
    found = logic.surface(logic.fit(mrml_scenes.add_volume(image), [CENTER]))
    expected = by_command_line(image, tmp_path)
    assert np.abs(found.control_net - expected.control_net).max() < SAME_MM
    # Slices of 3 mm and noise.
    assert deviation(found, ellipsoid().transformed(turn), n_points=1000).mean < 0.25


@pytest.mark.parametrize(("factor", "offset"), [(1e-4, 0.0), (3e5, -3e8)])
def test_grey_levels_of_any_size_are_fitted(logic, factor, offset):
    image = mrml_scenes.mri()
    scaled = Image(image.array.astype(np.float64) * factor + offset, image.ijk_to_ras)
    organ = logic.fit(mrml_scenes.add_volume(scaled), [CENTER])
    assert deviation(logic.surface(organ), ellipsoid(), n_points=500).mean < 0.25


def test_the_fit_leaves_the_volume_as_it_was(logic):
    volume = mrml_scenes.add_volume()
    time = volume.GetImageData().GetMTime()
    logic.fit(volume, [CENTER])
    np.testing.assert_array_equal(slicer.util.arrayFromVolume(volume), mrml_scenes.mri().array)
    assert volume.GetImageData().GetMTime() == time


def test_a_fit_returns_the_organ_with_all_that_came_out(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name="bladder")
    assert (organ.label, organ.state.value) == ("bladder", "fitted")
    surface = logic.surface(organ)
    assert deviation(surface, ellipsoid(), n_points=1000).mean < 0.25
    assert organ.volumeMl == pytest.approx(surface.volume() / 1000.0, rel=1e-12)
    assert organ.volumeMl == pytest.approx(ELLIPSOID_ML, rel=0.03)
    assert organ.message.startswith(f"{organ.volumeMl:.1f} ± 0.")
    assert "iterations, cost" in organ.message
    assert organ.threshold.minimum < 800.0 < organ.threshold.maximum
    assert organ.seeds.GetNumberOfControlPoints() == 1
    assert logic.getParameterNode().volume.GetName() == "mri"
    assert [other.label for other in logic.organs()] == ["bladder"]
    assert logic.organs().current().parameterNode is organ.parameterNode


def test_the_model_shows_the_surface_and_carries_it(logic, tmp_path):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name="bladder")
    points = slicer.util.arrayFromModelPoints(organ.surface)
    # Double precision: the triangles' corners are on the surface.
    assert np.abs(closest_points(logic.surface(organ), points[::7]).distances).max() < 1e-6
    # The library's own reader takes the model's file.
    path = tmp_path / "bladder.vtp"
    storage = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelStorageNode")
    storage.SetFileName(str(path))
    assert storage.WriteData(organ.surface)
    np.testing.assert_array_equal(read_vtp_record(path).surface.control_net, logic.surface(organ).control_net)


def test_the_course_of_the_fit_is_in_the_table_and_plotted(logic):
    steps = []
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], onStep=steps.append)
    table = organ.convergence.GetTable()
    assert table.GetNumberOfRows() == len(steps) > 5
    np.testing.assert_array_equal(slicer.util.arrayFromTableColumn(organ.convergence, "Cost"), [s.cost for s in steps])
    iterations = slicer.util.arrayFromTableColumn(organ.convergence, "Iteration")
    np.testing.assert_array_equal(iterations, np.arange(1, len(steps) + 1))
    moves = slicer.util.arrayFromTableColumn(organ.convergence, "Displacement (mm)")
    np.testing.assert_array_equal(moves, [step.displacement for step in steps])
    stages = [table.GetColumnByName("Stage").GetValue(row) for row in range(table.GetNumberOfRows())]
    assert stages == [step.stage for step in steps]
    series = organ.plot.GetNthPlotSeriesNode(0)
    assert series.GetTableNode() is organ.convergence
    assert (series.GetXColumnName(), series.GetYColumnName()) == ("Iteration", "Cost")


def test_what_a_user_plots_of_the_table_stays_as_it_is(logic):
    from VICRegistrationLib.mrml.organ_nodes import paint

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    series = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLPlotSeriesNode", "displacement")
    series.SetAndObserveTableNodeID(organ.convergence.GetID())
    series.SetYColumnName("Displacement (mm)")
    series.SetColor(0.1, 0.2, 0.3)
    slicer.mrmlScene.RemoveNode(organ.plot)
    logic.refit(organ)
    paint(organ)
    assert series.GetScene() is not None
    assert series.GetColor() == (0.1, 0.2, 0.3)
    assert organ.plot.GetNumberOfPlotSeriesNodes() == 1
    assert organ.plot.GetNthPlotSeriesNode(0).GetYColumnName() == "Cost"


def test_seeds_are_taken_from_an_array_a_point_or_a_list_of_points(logic):
    volume = mrml_scenes.add_volume()
    markups = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", "mine")
    markups.AddControlPoint(*CENTER)
    # A point that is not placed: its coordinates mean nothing.
    markups.AddControlPoint(500, 500, 500)
    markups.UnsetNthControlPointPosition(1)
    surfaces = [logic.surface(logic.fit(volume, seeds)) for seeds in (CENTER, [CENTER.tolist()], markups)]
    for surface in surfaces[1:]:
        np.testing.assert_array_equal(surface.control_net, surfaces[0].control_net)
    assert markups.GetNumberOfControlPoints() == 2


def test_thresholds_erosion_and_options_are_used(logic):
    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER], (600, 1000), erosion=1.0, options=FitOptions(net=(11, 9), levels="organ"))
    assert (organ.threshold.minimum, organ.threshold.maximum, organ.thresholdAutomatic) == (600, 1000, False)
    assert (organ.erosionMm, organ.erosionAutomatic) == (1.0, False)
    assert (organ.netRows, organ.netColumns) == (11, 9)
    assert not organ.netAutomatic
    expected = logic.surface(logic.fit(volume, [CENTER], options=FitOptions(net=(9, 7)))).control_net.shape
    assert logic.surface(organ).control_net.shape == (expected[0] + 2, expected[1] + 2, 3)


def test_what_the_fit_has_chosen_is_shown(logic):
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.registration.steps import finish

    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER])
    fit = finish(fitSteps(organ, volume))
    assert (organ.netRows, organ.netColumns) == fit.options.net
    assert organ.tauMm == pytest.approx(fit.options.tau)
    assert 10.0**organ.smoothnessLog10 == pytest.approx(fit.options.smoothness)
    assert (organ.netAutomatic, organ.tauAutomatic, organ.smoothnessAutomatic) == (True, True, True)
    told = ", ".join(f"{word} {choice.value}" for word, choice in zip(("net", "edge", "smoothness"), fit.choices))
    assert organ.message.splitlines()[1] == f"Chosen: {told}"


def test_what_was_given_to_the_fit_is_not_told_as_chosen(logic):
    options = FitOptions(net=(9, 7), tau=1.75, smoothness=0.0)
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], options=options)
    assert (organ.tauMm, organ.options().smoothness, organ.options().net) == (1.75, 0.0, (9, 7))
    assert "Chosen" not in organ.message


def test_boundary_points_do_not_change_the_net_that_is_shown(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    before = organ.netRows, organ.netColumns
    surface = logic.surface(organ)
    logic.refit(organ, surface.points([0.3], [0.5]) + 4.0 * surface.normals([0.3], [0.5]))
    assert (organ.netRows, organ.netColumns) == before
    assert logic.surface(organ).control_net.shape > surface.control_net.shape


def test_fitting_again_gives_the_same_surface_in_the_same_nodes(logic):
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.registration.steps import finish

    volume = mrml_scenes.add_volume()
    organ = logic.fit(volume, [CENTER])
    surface, before = logic.surface(organ), mrml_scenes.content(slicer.mrmlScene)
    finish(fitSteps(organ, volume))
    np.testing.assert_array_equal(logic.surface(organ).control_net, surface.control_net)
    assert mrml_scenes.content(slicer.mrmlScene) == before
