"""VTP, STL and PLY files lie in place in Slicer, and a VTP file gives the surface back."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOGeometry import vtkSTLReader
from vtkmodules.vtkIOPLY import vtkPLYReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from VICRegistrationLib.export.mesh_files import (
    write_mesh,
    write_ply,
    write_stl,
    write_vtp,
)
from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.triangulation import triangulate

LPS = np.array([-1.0, -1.0, 1.0])


@pytest.fixture
def surface():
    return closed_organ(axes=np.diag([20.0, 25.0, 30.0]), center=(-12.3, 45.6, 7.8))


@pytest.fixture
def mesh(surface):
    return triangulate(surface, resolution=(24, 16))


def read_with(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def test_a_vtp_file_says_lps_and_holds_points_in_lps(surface, mesh, tmp_path):
    write_vtp(mesh, surface, tmp_path / "a.vtp", name="bladder")
    data = read_with(vtkXMLPolyDataReader(), tmp_path / "a.vtp")
    space = data.GetFieldData().GetAbstractArray("SPACE")
    assert space.GetClassName() == "vtkStringArray"
    assert [space.GetValue(n) for n in range(space.GetNumberOfValues())] == ["LPS"]
    np.testing.assert_array_equal(vtk_to_numpy(data.GetPoints().GetData()), mesh.points * LPS)
    np.testing.assert_array_equal(vtk_to_numpy(data.GetPointData().GetNormals()), mesh.normals * LPS)
    triangles = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    np.testing.assert_array_equal(triangles, mesh.triangles)


def test_a_vtp_file_holds_the_control_net_with_its_frame(surface, mesh, tmp_path):
    write_vtp(mesh, surface, tmp_path / "a.vtp", name="Blasé")
    fields = read_with(vtkXMLPolyDataReader(), tmp_path / "a.vtp").GetFieldData()
    texts = {key: fields.GetAbstractArray(key).GetValue(0) for key in ("name", "unit", "control_net_space")}
    assert texts == {"name": "Blasé", "unit": "mm", "control_net_space": "RAS"}
    n_u, n_v, _ = surface.control_net.shape
    assert vtk_to_numpy(fields.GetArray("control_net_shape")).tolist() == [n_u, n_v]
    net = vtk_to_numpy(fields.GetArray("control_net"))
    np.testing.assert_array_equal(net[1 * n_v + 2], surface.control_net[1, 2])


def test_the_surface_comes_back_to_the_last_bit(surface, mesh, tmp_path):
    write_vtp(mesh, surface, tmp_path / "a.vtp", name="bladder")
    again = read_vtp_record(tmp_path / "a.vtp").surface
    assert again.degrees == surface.degrees
    np.testing.assert_array_equal(again.knots_u, surface.knots_u)
    np.testing.assert_array_equal(again.knots_v, surface.knots_v)
    np.testing.assert_array_equal(again.control_net, surface.control_net)


def test_an_stl_file_says_lps_and_holds_points_in_lps(mesh, tmp_path):
    write_stl(mesh, tmp_path / "a.stl", name="bladder")
    reader = vtkSTLReader()
    data = read_with(reader, tmp_path / "a.stl")
    assert reader.GetHeader().startswith("3D Slicer output. SPACE=LPS bladder")
    assert data.GetNumberOfCells() == len(mesh.triangles)
    bounds = np.array(data.GetBounds()).reshape(3, 2).T
    expected = np.array([(mesh.points * LPS).min(axis=0), (mesh.points * LPS).max(axis=0)])
    # STL holds single precision: 50 mm to 4e-6 mm.
    np.testing.assert_allclose(bounds, expected, atol=1e-5)


def test_the_facets_of_an_stl_file_point_outward(mesh, tmp_path):
    write_stl(mesh, tmp_path / "a.stl", name="bladder")
    facets = np.frombuffer(
        (tmp_path / "a.stl").read_bytes()[84:],
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")],
    )
    outward = facets["corners"].mean(axis=1) - (mesh.points * LPS).mean(axis=0)
    assert (np.einsum("nk,nk->n", facets["normal"], outward) > 0).all()


@pytest.mark.parametrize("name", ["x" * 200, "Größe", ""])
def test_any_name_leaves_an_stl_header_of_80_bytes(mesh, tmp_path, name):
    write_stl(mesh, tmp_path / "a.stl", name=name)
    content = (tmp_path / "a.stl").read_bytes()
    assert len(content) == 84 + 50 * len(mesh.triangles)
    assert int.from_bytes(content[80:84], "little") == len(mesh.triangles)


def test_a_ply_file_says_lps_and_holds_points_in_lps(mesh, tmp_path):
    write_ply(mesh, tmp_path / "a.ply", name="Blasé\nend_header")
    reader = vtkPLYReader()
    data = read_with(reader, tmp_path / "a.ply")
    comments = [reader.GetComments().GetValue(n) for n in range(reader.GetComments().GetNumberOfValues())]
    assert comments[-2:] == ["3D Slicer output. SPACE=LPS", "Blas? end_header"]
    # PLY holds single precision here: 50 mm to 4e-6 mm.
    np.testing.assert_allclose(vtk_to_numpy(data.GetPoints().GetData()), mesh.points * LPS, atol=1e-5)
    triangles = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    np.testing.assert_array_equal(triangles, mesh.triangles)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".vtp"])
def test_slicer_opens_a_mesh_in_place(scene, surface, tmp_path, suffix):
    write_mesh(surface, tmp_path / f"a{suffix}", name="bladder", chord_error=0.5)
    node = scene.AddNewNodeByClass("vtkMRMLModelNode")
    storage = scene.AddNewNodeByClass("vtkMRMLModelStorageNode")
    storage.SetFileName(str(tmp_path / f"a{suffix}"))
    assert storage.ReadData(node) == 1
    points = triangulate(surface, chord_error=0.5).points
    bounds = np.array(node.GetPolyData().GetBounds()).reshape(3, 2).T
    np.testing.assert_allclose(bounds, [points.min(axis=0), points.max(axis=0)], atol=1e-5)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".vtp", ".STL"])
def test_a_mesh_is_written_as_its_file_is_named(surface, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_mesh(surface, path, name="bladder", chord_error=0.5)
    reader = {".stl": vtkSTLReader, ".ply": vtkPLYReader, ".vtp": vtkXMLPolyDataReader}[suffix.lower()]()
    data = read_with(reader, path)
    assert data.GetNumberOfCells() == len(triangulate(surface, chord_error=0.5).triangles)


def test_a_mesh_of_another_format_or_no_chord_error_is_refused(surface, tmp_path):
    with pytest.raises(ValueError, match=r"a\.obj was asked for; its name must end in one of \.stl, \.ply, \.vtp"):
        write_mesh(surface, tmp_path / "a.obj", name="bladder")
    with pytest.raises(ValueError, match="give a positive length"):
        write_mesh(surface, tmp_path / "a.stl", name="bladder", chord_error=0.0)
    assert list(tmp_path.iterdir()) == []


def test_the_triangles_keep_to_the_chord_error(surface, tmp_path):
    write_mesh(surface, tmp_path / "a.stl", name="bladder", chord_error=0.2)
    data = read_with(vtkSTLReader(), tmp_path / "a.stl")
    corners = vtk_to_numpy(data.GetPoints().GetData())[vtk_to_numpy(data.GetPolys().GetConnectivityArray())]
    middles = corners.reshape(-1, 3, 3).mean(axis=1) * LPS
    distances = np.abs(closest_points(surface, middles.astype(float)).distances)
    assert 0.05 < distances.max() <= 0.2


@pytest.mark.parametrize("name", ["Blasé", ""])
def test_the_name_comes_back_with_the_surface(surface, mesh, tmp_path, name):
    write_vtp(mesh, surface, tmp_path / "a.vtp", name=name)
    assert read_vtp_record(tmp_path / "a.vtp").name == name


@pytest.mark.parametrize("content", [b"", b"<VTKFile", b"\x00\xff", b"solid"])
def test_a_file_without_a_surface_is_refused(tmp_path, content, capfd):
    (tmp_path / "a.vtp").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.vtp lacks degrees, .* in its field data; give a VTP file"):
        read_vtp_record(tmp_path / "a.vtp")
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(OSError, match=r"none\.vtp cannot be read \(No such file"):
        read_vtp_record(tmp_path / "none.vtp")


def test_a_file_that_cannot_be_written_leaves_nothing(surface, mesh, tmp_path):
    with pytest.raises(OSError, match=r"a\.vtp cannot be written"):
        write_vtp(mesh, surface, tmp_path / "none" / "a.vtp", name="bladder")
    (tmp_path / "a.stl").mkdir()
    with pytest.raises(OSError, match=r"a\.stl cannot be written"):
        write_stl(mesh, tmp_path / "a.stl", name="bladder")
    assert [path.name for path in tmp_path.iterdir()] == ["a.stl"]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".vtp"])
def test_a_file_that_is_cut_short_is_refused(surface, tmp_path, suffix, capfd):
    import resource

    write_mesh(surface, tmp_path / f"a{suffix}", name="old", chord_error=1.0)
    before, limits = (tmp_path / f"a{suffix}").read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, limits[1]))
    try:
        with pytest.raises(OSError, match=rf"a\{suffix} cannot be written"):
            write_mesh(surface, tmp_path / f"a{suffix}", name="new", chord_error=0.1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / f"a{suffix}").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [f"a{suffix}"]
    assert capfd.readouterr() == ("", "")
