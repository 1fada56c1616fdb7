"""Organs of the scene in files: where they lie in the world, whatever transform they are under."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface_file import read_surface

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

SCALING = np.diag([1.2, 0.8, 1.5, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def organ_under(logic, matrix=None):
    """A fitted organ whose volume is under a linear transform."""
    under = None if matrix is None else mrml_scenes.add_linear_transform(matrix)
    volume = mrml_scenes.add_volume(under=under)
    seed = CENTER if matrix is None else matrix[:3, :3] @ CENTER + matrix[:3, 3]
    return logic.fit(volume, [seed], name="bladder")


@pytest.mark.parametrize(
    "matrix",
    [None, motion(75, (1, 2, -1), (30, -60, 12)), motion(20, (0, 1, 1), (5, 5, 5)) @ SCALING, MIRROR],
    ids=["none", "rotation", "rotation and scaling", "mirror"],
)
def test_files_hold_the_surface_where_it_lies_in_the_world(logic, tmp_path, matrix):
    from VICRegistrationLib.mrml.exporting import exportSurfaces

    organ = organ_under(logic, matrix)
    paths = [exportSurfaces([organ], tmp_path, suffix) for suffix in (".step", ".stl", ".ply", ".vtp")]
    assert [path.name for (path,) in paths] == ["bladder.step", "bladder.stl", "bladder.ply", "bladder.vtp"]
    found = read_vtp_record(tmp_path / "bladder.vtp").surface
    # The triangles that are seen in the world lie on it, and its normals point outward.
    np.testing.assert_allclose(
        closest_points(found, mrml_scenes.hardened_points(organ.surface)).distances, 0.0, atol=1e-6
    )
    assert found.volume() / 1000.0 == pytest.approx(organ.volumeMl, rel=1e-9)


def test_a_transform_that_bends_is_refused_with_what_to_do(logic, tmp_path):
    from VICRegistrationLib.mrml.exporting import exportSurfaces

    organ = organ_under(logic)
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    organ.surface.SetAndObserveTransformNodeID(bent.GetID())
    with pytest.raises(ValueError, match="under a nonlinear transform.*harden the transform"):
        exportSurfaces([organ], tmp_path, ".step")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_refused_and_nothing_is_written(logic, tmp_path):
    from VICRegistrationLib.mrml.exporting import exportSurfaces

    with pytest.raises(ValueError, match="No organ has a surface yet"):
        exportSurfaces([], tmp_path, ".step")
    volume = mrml_scenes.add_volume()
    with pytest.raises(ValueError, match="has no surface yet. Fit it first"):
        exportSurfaces([logic.addOrgan(volume, [CENTER])], tmp_path, ".stl")
    inside_out = logic.fit(volume, [CENTER], name="turned")
    logic.setSurface(inside_out, ellipsoid().turned())
    for suffix in (".step", ".stl"):
        with pytest.raises(ValueError, match="turned"):
            exportSurfaces([inside_out], tmp_path, suffix)
    logic.organs().rename(inside_out, "a/b")
    with pytest.raises(ValueError, match="a/b"):
        exportSurfaces([inside_out], tmp_path, ".step")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["bladder", "BLADDER"])
def test_organs_whose_files_would_replace_each_other_are_refused(logic, tmp_path, name):
    from VICRegistrationLib.mrml.exporting import exportSurfaces, meshArguments

    volume = mrml_scenes.add_volume()
    organs = [logic.fit(volume, [CENTER], name=each) for each in ("bladder", "other")]
    # As after a scene was loaded on top of another.
    organs[1].label = name
    for write in (
        lambda: exportSurfaces(organs, tmp_path, ".stl"),
        lambda: meshArguments(organs, tmp_path, tmp_path, ".vtu", sizeMm=3.0),
    ):
        with pytest.raises(ValueError, match=f"Two organs are named {name}; rename one"):
            write()
    assert list(tmp_path.iterdir()) == []


def test_the_mesher_gets_the_surface_in_the_world(logic, tmp_path):
    from VICRegistrationLib.mrml.exporting import meshArguments, worldSurface

    organ = organ_under(logic, motion(75, (1, 2, -1), (30, -60, 12)))
    arguments, path = meshArguments([organ], tmp_path, tmp_path / "out", ".msh", sizeMm=4.0, order=2, wallMm=1.5)
    assert arguments[:2] == ["mesh", str(tmp_path / "bladder.json")]
    assert arguments[2:] == ["--size", "4", "--order", "2", "--wall", "1.5", "--output", str(path)]
    written = read_surface(tmp_path / "bladder.json")
    np.testing.assert_array_equal(written.control_net, worldSurface(organ).control_net)


def test_a_mesh_that_is_not_there_leaves_nothing_in_the_scene(logic, tmp_path):
    from VICRegistrationLib.mrml.exporting import loadMesh

    # The first node of a scene makes its subject hierarchy as well.
    mrml_scenes.add_volume()
    before = slicer.mrmlScene.GetNumberOfNodes()
    with pytest.raises(ValueError, match="cannot be loaded"):
        loadMesh(tmp_path / "none.vtu")
    assert slicer.mrmlScene.GetNumberOfNodes() == before
