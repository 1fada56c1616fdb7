"""Hardened transforms, and triangles that other modules change: nothing jumps, and nothing wrong is exported."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
import vtk
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER

from VICRegistrationLib.geometry.projection import closest_points

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

MATRICES = {
    "rotation": motion(75, (1, 2, -1), (30, -60, 12)),
    "mirror": np.diag([-1.0, 1.0, 1.2, 1.0]),
}


def world(matrix):
    return matrix[:3, :3] @ CENTER + matrix[:3, 3]


def fitted_under(logic, matrix):
    """An organ fitted in a volume under a linear transform, with a boundary point on its wall."""
    volume = mrml_scenes.add_volume(under=mrml_scenes.add_linear_transform(matrix))
    return volume, logic.fit(volume, [world(matrix)])


def seeds(organ):
    return slicer.util.arrayFromMarkupsControlPoints(organ.seeds, world=True)


@pytest.mark.parametrize("name", MATRICES)
def test_the_exact_surface_goes_with_its_triangles(logic, name):
    from VICRegistrationLib.mrml.exporting import worldSurface

    _volume, organ = fitted_under(logic, MATRICES[name])
    before = worldSurface(organ)
    organ.surface.HardenTransform()
    after = worldSurface(organ)
    np.testing.assert_allclose(after.control_net, before.control_net, atol=1e-6)
    assert after.volume() > 0.0
    triangles = slicer.util.arrayFromModelPoints(organ.surface)
    assert np.abs(closest_points(after, triangles[::50]).distances).max() < 1e-6


def test_what_it_was_before_boundary_points_goes_along(logic):
    from VICRegistrationLib.mrml.surfaces import surfaceFromModel

    matrix = MATRICES["rotation"]
    volume, organ = fitted_under(logic, matrix)
    wall = logic.surface(organ).points(np.array([0.3]), np.array([0.5])) + 2.0
    logic.refit(organ, boundaryPoints=wall @ matrix[:3, :3].T + matrix[:3, 3])
    before = surfaceFromModel(organ.surface, corrected=False).transformed(matrix)
    organ.surface.HardenTransform()
    after = surfaceFromModel(organ.surface, corrected=False)
    np.testing.assert_allclose(after.control_net, before.control_net, atol=1e-6)


@pytest.mark.parametrize("name", MATRICES)
def test_a_transform_hardened_on_the_volume_moves_nothing(logic, name):
    volume, organ = fitted_under(logic, MATRICES[name])
    place, triangles = seeds(organ), mrml_scenes.hardened_points(organ.surface)
    voxels = np.count_nonzero(mrml_scenes.segment_voxels(organ, volume))
    volume_ml = organ.volumeMl
    volume.HardenTransform()
    logic.refit(organ)
    np.testing.assert_allclose(seeds(organ), place, atol=1e-6)
    assert organ.surface.GetParentTransformNode() is None
    moved = closest_points(logic.surface(organ), triangles[::20])
    # The refit starts where the fit ended, and is held there; the small phantom has voxels of 3 mm.
    assert np.abs(moved.distances).mean() < 0.08
    assert np.count_nonzero(mrml_scenes.segment_voxels(organ, volume)) == pytest.approx(voxels, rel=0.02)
    assert organ.volumeMl == pytest.approx(volume_ml, rel=0.01)


def test_a_bend_hardened_on_the_volume_keeps_the_seeds_in_place(logic):
    spline = mrml_scenes.thin_plate_spline()
    volume = mrml_scenes.add_volume(under=mrml_scenes.add_nonlinear_transform(spline))
    organ = logic.fit(volume, mrml_scenes.through(spline, CENTER))
    place = seeds(organ)
    volume.HardenTransform()
    with pytest.raises(ValueError, match=r"hardening a nonlinear transform.*Fit the organ again"):
        logic.refit(organ)
    np.testing.assert_allclose(seeds(organ), place, atol=1e-6)


def test_a_volume_that_is_taken_out_of_its_transform_takes_its_organs_along(logic):
    matrix = MATRICES["rotation"]
    volume, organ = fitted_under(logic, matrix)
    volume.SetAndObserveTransformNodeID(None)
    logic.refit(organ)
    np.testing.assert_allclose(seeds(organ), [CENTER], atol=1e-6)


@pytest.fixture
def two_volumes(logic):
    """An organ fitted in a volume under a rotation, with a boundary point; and a volume that shows the same place."""
    from VICRegistrationLib.mrml.organ_nodes import boundaryPointsOf

    volume, organ = fitted_under(logic, MATRICES["rotation"])
    boundaryPointsOf(organ, volume).AddControlPointWorld(1.0, 2.0, 3.0)
    return organ, volume, mrml_scenes.add_volume(mrml_scenes.oblique(matrix=MATRICES["rotation"]), name="other")


def places(organ):
    lists = (organ.seeds, organ.boundaryPoints)
    return np.concatenate([slicer.util.arrayFromMarkupsControlPoints(node, world=True) for node in lists])


def test_points_stay_where_they_are_when_another_volume_is_chosen(two_volumes):
    from VICRegistrationLib.mrml.organ_nodes import boundaryPointsOf, seedsOf

    organ, volume, other = two_volumes
    before = places(organ)
    for chosen in (other, volume, other):
        for pointsOf in (seedsOf, boundaryPointsOf):
            assert pointsOf(organ, chosen).GetParentTransformNode() is chosen.GetParentTransformNode()
        np.testing.assert_allclose(places(organ), before, atol=1e-4)


def test_a_surface_stays_in_its_volume_while_the_organ_is_separated_in_another(two_volumes):
    from VICRegistrationLib.mrml.organ_nodes import followVolume, volumeOf
    from VICRegistrationLib.mrml.separating import separateOrgan

    organ, volume, other = two_volumes
    before = mrml_scenes.hardened_points(organ.surface)
    separateOrgan(organ, other)
    followVolume(organ, other)
    assert volumeOf(organ) is volume
    np.testing.assert_array_equal(mrml_scenes.hardened_points(organ.surface), before)


def test_a_fit_in_another_volume_that_is_cancelled_brings_the_surface_back(logic, two_volumes):
    from VICRegistrationLib.mrml.fitting import fitSteps
    from VICRegistrationLib.mrml.organ_nodes import volumeOf
    from VICRegistrationLib.registration.steps import finish

    organ, volume, other = two_volumes
    organ.boundaryPoints.RemoveAllControlPoints()
    before = mrml_scenes.hardened_points(organ.surface)
    steps = fitSteps(organ, other)
    next(steps)
    assert organ.surface.GetParentTransformNode() is None
    steps.close()
    assert volumeOf(organ) is volume
    np.testing.assert_array_equal(mrml_scenes.hardened_points(organ.surface), before)
    finish(fitSteps(organ, other))
    assert volumeOf(organ) is other
    assert np.abs(closest_points(logic.surface(organ), before[::20]).distances).mean() < 0.1


def with_filter(algorithm, model):
    """A new model with what a filter makes of the triangles of another; field data passes through."""
    algorithm.SetInputData(model.GetPolyData())
    algorithm.Update()
    assert algorithm.GetOutput().GetFieldData().HasArray("control_net")
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "edited")
    node.SetAndObservePolyData(algorithm.GetOutput())
    return node


def test_an_edited_copy_is_compared_by_its_triangles(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    smooth = vtk.vtkSmoothPolyDataFilter()
    smooth.SetNumberOfIterations(200)
    shift = vtk.vtkTransform()
    shift.Translate(3.0, 0.0, 0.0)
    move = vtk.vtkTransformPolyDataFilter()
    move.SetTransform(shift)
    for algorithm, least in ((smooth, 0.1), (move, 0.5)):
        found = logic.compare(organ, with_filter(algorithm, organ.surface))
        assert found.to_surface.mean > least


def test_an_organ_whose_triangles_were_changed_is_not_exported(logic, tmp_path):
    from VICRegistrationLib.mrml.exporting import exportSurfaces

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    points = slicer.util.arrayFromModelPoints(organ.surface)
    points[:] *= 1.0 + 0.1 * np.sin(points[:, :1])
    slicer.util.arrayFromModelPointsModified(organ.surface)
    with pytest.raises(ValueError, match="by another module"):
        exportSurfaces([organ], tmp_path, ".step")
    assert not list(tmp_path.iterdir())
