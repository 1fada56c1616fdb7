"""References out of files: meshes of all kinds in their frames, label images, surfaces."""

from __future__ import annotations

import re
import struct
import subprocess
import sys

import numpy as np
import pytest
from vtkmodules.vtkIOGeometry import vtkOBJWriter, vtkSTLWriter
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOPLY import vtkPLYWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from VICRegistrationLib.analysis.comparison import compare, distances_from, volume_dice
from VICRegistrationLib.analysis.mirrored import mirrored
from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, closed_mesh
from VICRegistrationLib.analysis.references import read_reference
from VICRegistrationLib.export import mesh_to_vtp
from VICRegistrationLib.export.mesh_files import write_mesh
from VICRegistrationLib.export.surface_data import add_text
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.polydata import polydata
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.geometry.triangles import enclosed_volume
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.phantoms.organs import pelvic_organs

CENTER = np.array([30.0, -20.0, 10.0])
WRITERS = {
    ".stl": vtkSTLWriter,
    ".ply": vtkPLYWriter,
    ".vtp": vtkXMLPolyDataWriter,
    ".vtk": vtkPolyDataWriter,
    ".obj": vtkOBJWriter,
}


@pytest.fixture(scope="module")
def surface():
    return closed_organ(axes=np.diag([8.0, 10.0, 12.0]), center=CENTER)


def depth(reference, place=CENTER):
    """Signed distance of a place from a reference."""
    return float(distances_from(reference, [place])[0])


def written(path, points, triangles, *, space=""):
    """Write a mesh as other programs do; with a marker of the frame in Slicer's manner if asked for."""
    data, writer = polydata(points, triangles), WRITERS[path.suffix]()
    if space and path.suffix == ".vtp":
        add_text(data, "SPACE", space)
    elif space:
        writer.SetHeader(f"3D Slicer output. SPACE={space}")
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    assert writer.Write()
    return path


# ------------------------------------------------------------------ meshes


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".vtp"])
def test_a_mesh_of_the_program_is_where_its_surface_is(surface, tmp_path, suffix):
    path = tmp_path / f"organ{suffix}"
    write_mesh(surface, path, name="organ")
    read = read_reference(path)
    # A VTP file of the program carries the surface itself.
    assert read.kind == ("surface" if suffix == ".vtp" else "mesh")
    assert depth(read.reference) == pytest.approx(-8.0, abs=0.1)


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_a_mesh_of_another_program_is_lps_unless_it_is_told(surface, tmp_path, suffix):
    mesh = triangulate(surface)
    path = written(tmp_path / f"organ{suffix}", mesh.points, mesh.triangles)
    assert depth(read_reference(path).reference, CENTER * [-1.0, -1.0, 1.0]) == pytest.approx(-8.0, abs=0.1)
    assert depth(read_reference(path, frame="RAS").reference) == pytest.approx(-8.0, abs=0.1)


@pytest.mark.parametrize("suffix", [".stl", ".vtk", ".vtp"])
def test_the_marker_of_slicer_is_heeded(surface, tmp_path, suffix):
    mesh = triangulate(surface)
    path = written(tmp_path / f"organ{suffix}", mesh.points, mesh.triangles, space="RAS")
    assert depth(read_reference(path).reference) == pytest.approx(-8.0, abs=0.1)


def test_the_largest_piece_of_a_mesh_has_no_hollow(surface, tmp_path):
    outer, inner = triangulate(surface), triangulate(closed_organ(axes=3.0 * np.eye(3), center=CENTER))
    stray = triangulate(closed_organ(axes=2.0 * np.eye(3), center=CENTER + [20.0, 0.0, 0.0]))
    parts = [outer, ReferenceMesh(inner.points, inner.triangles[:, ::-1]), stray]
    offsets = np.cumsum([0, *(len(part.points) for part in parts)])
    triangles = np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets)])
    path = written(tmp_path / "hollow.ply", np.concatenate([part.points for part in parts]), triangles)
    whole = read_reference(path, frame="RAS")
    assert depth(whole.reference) == pytest.approx(3.0, abs=0.1)
    assert whole.diagnostics == (Diagnostic("reference_in_pieces", {"reference": str(path), "count": 3}),)
    largest = read_reference(path, frame="RAS", largest=True)
    assert depth(largest.reference) == pytest.approx(-8.0, abs=0.1)
    assert largest.diagnostics == largest.notes == ()


def test_what_is_no_closed_mesh_is_refused_with_its_name(surface, tmp_path):
    mesh = triangulate(surface)
    path = written(tmp_path / "open.stl", mesh.points, mesh.triangles[3:])
    with pytest.raises(ValueError, match=r"open\.stl: The mesh is open"):
        read_reference(path)
    for suffix in WRITERS:
        path = tmp_path / f"text{suffix}"
        path.write_text("This is no mesh.\n" * 20)
        with pytest.raises(ValueError, match=rf"text\{suffix} holds no triangles that can be read"):
            read_reference(path)
        with pytest.raises(OSError, match=r"cannot be read \(No such file or directory\); give a file that exists"):
            read_reference(tmp_path / f"missing{suffix}")


def ply(path, points, faces, *, binary, count="uchar", index="int"):
    """PLY as other programs write it: with colours and other types, bytes or text."""
    order = ">" if binary else ""
    head = ["ply", "format binary_big_endian 1.0" if binary else "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property float {axis}" for axis in "xyz"] + ["property uchar red"]
    head += [f"element face {len(faces)}", f"property list {count} {index} vertex_indices", "end_header", ""]
    if not binary:
        rows = [f"{x:.9g} {y:.9g} {z:.9g} 7" for x, y, z in points]
        rows += [" ".join(map(str, [len(face), *face])) for face in faces]
        path.write_text("\n".join([*head[:-1], *rows, ""]))
        return path
    kinds = {"uchar": "B", "int": "i", "uint": "I"}
    rows = [struct.pack(f"{order}3fB", *point, 7) for point in points]
    rows += [struct.pack(f"{order}{kinds[count]}{len(face)}{kinds[index]}", len(face), *face) for face in faces]
    path.write_bytes("\n".join(head).encode() + b"".join(rows))
    return path


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("types", [("uchar", "int"), ("int", "uint")])
def test_ply_of_other_programs_is_read(surface, tmp_path, binary, types):
    mesh = triangulate(surface)
    points, faces = mesh.points, mesh.triangles.tolist()
    kinds = {"binary": binary, "count": types[0], "index": types[1]}
    path = ply(tmp_path / "a.ply", points, faces, **kinds)
    assert depth(read_reference(path, frame="RAS").reference) == pytest.approx(-8.0, abs=0.1)


REFUSED = r"a\.\w+(: The mesh is open| is cut short or damaged| holds no triangles| has polygons with corners)"


@pytest.mark.parametrize("left", [0.3, 0.7, 0.99])
@pytest.mark.parametrize("binary", [True, False])
def test_ply_that_is_cut_short_is_refused(surface, tmp_path, binary, left):
    mesh = triangulate(surface)
    path = ply(tmp_path / "a.ply", mesh.points, mesh.triangles.tolist(), binary=binary)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(left * len(whole))])
    with pytest.raises(ValueError, match=REFUSED):
        read_reference(path)


@pytest.mark.parametrize("suffix", [".ply", ".vtk"])
def test_a_file_that_ends_its_reader_is_refused(surface, tmp_path, suffix):
    mesh = triangulate(surface)
    path = tmp_path / f"a{suffix}"
    if suffix == ".ply":
        ply(path, mesh.points, [[0, 1, 2], [0, 1, 10**8]], binary=True)
    else:
        writer = vtkPolyDataWriter()
        writer.SetFileName(str(path))
        writer.SetInputData(polydata(mesh.points, mesh.triangles))
        writer.SetFileTypeToBinary()
        writer.Write()
        path.write_bytes(re.sub(rb"POLYGONS (\d+) \d+", rb"POLYGONS \1 0", path.read_bytes()))
    # VTK 9.6 ends its process with it; another version may return it, and it is refused in other words.
    with pytest.raises(ValueError, match=REFUSED):
        read_reference(path)


def test_what_keeps_the_reading_process_from_its_work_is_no_damage(surface, tmp_path, monkeypatch):
    path = tmp_path / "a.stl"
    write_mesh(surface, path, name="a")
    (tmp_path / "vtkmodules.py").write_text("raise ModuleNotFoundError('no VTK')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(OSError, match=r"a\.stl cannot be read, because the process .* failed \(.*no VTK"):
        read_reference(path)


def test_a_copy_that_cannot_be_written_is_reported(surface, tmp_path):
    path = tmp_path / "a.stl"
    write_mesh(surface, path, name="a")
    command = [sys.executable, mesh_to_vtp.__file__, str(path), str(tmp_path / "missing" / "copy.vtp")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "copy.vtp cannot be written; is the disk full?" in done.stderr


def test_polygons_of_points_that_are_not_there_are_refused(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    with pytest.raises(ValueError, match=r"corners that are not among its 3 points, so it is damaged"):
        read_reference(path)


def lines_of_stl(points, triangles):
    """ASCII STL as most programs write it."""
    yield "solid organ"
    for triangle in triangles:
        yield "  facet normal 0 0 0"
        yield "    outer loop"
        yield from (f"      vertex {x:.9g} {y:.9g} {z:.9e}" for x, y, z in points[triangle])
        yield "    endloop"
        yield "  endfacet"
    yield "endsolid organ"


@pytest.mark.parametrize(
    "written_as",
    [
        str,
        str.upper,
        lambda text: text.replace("\n", "\r\n").upper(),
        lambda text: text.replace("vertex", "Vertex").replace("facet", "Facet"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("solid organ", "solid"),
    ],
)
def test_all_ways_to_write_stl_as_text(surface, tmp_path, written_as):
    mesh = triangulate(surface)
    path = tmp_path / "organ.stl"
    text = "\n".join(lines_of_stl(mesh.points, mesh.triangles)) + "\n"
    path.write_bytes(written_as(text).encode("utf-8"))
    assert depth(read_reference(path, frame="RAS").reference) == pytest.approx(-8.0, abs=0.1)


@pytest.mark.parametrize("header", [b"solid organ", b"SOLID organ", b"solid organ\n facet normal 0 0 0\n"])
def test_a_binary_stl_that_begins_as_text(surface, tmp_path, header):
    mesh = triangulate(surface)
    path = tmp_path / "organ.stl"
    write_mesh(surface, path, name="organ")
    path.write_bytes(header.ljust(80) + path.read_bytes()[80:])
    read = read_reference(path, frame="LPS")
    assert depth(read.reference) == pytest.approx(-8.0, abs=0.1)
    assert len(read.reference.triangles) == len(mesh.triangles)


@pytest.mark.parametrize("noise", [1e-15, 1e-6])
def test_corners_that_differ_by_rounding_are_one(surface, tmp_path, noise):
    mesh = triangulate(surface)
    # As in STL: each triangle has corners of its own, here with other last digits, near 0 too.
    corners = mesh.points[mesh.triangles].reshape(-1, 3) - CENTER
    corners += np.random.default_rng(0).uniform(-noise, noise, corners.shape)
    path = written(tmp_path / "organ.vtk", corners, np.arange(len(corners)).reshape(-1, 3))
    reference = read_reference(path, frame="RAS").reference
    assert len(reference.points) == len(mesh.points)
    assert enclosed_volume(reference.points, reference.triangles) == pytest.approx(surface.volume(), rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_triangles_that_are_there_twice_count_once(surface, tmp_path, turned):
    mesh = triangulate(surface)
    again = mesh.triangles[:, ::-1] if turned else np.roll(mesh.triangles, 1, axis=1)
    path = written(tmp_path / "organ.stl", mesh.points, np.concatenate([mesh.triangles, again[::-1]]))
    reference = read_reference(path, frame="RAS").reference
    assert len(reference.triangles) == len(mesh.triangles)
    assert enclosed_volume(reference.points, reference.triangles) == pytest.approx(surface.volume(), rel=0.01)
    assert compare(surface, reference, n_points=500).volume_dice > 0.99


def test_some_triangles_that_are_there_twice_count_once(surface, tmp_path):
    mesh = triangulate(surface)
    path = written(tmp_path / "organ.stl", mesh.points, np.concatenate([mesh.triangles, mesh.triangles[10:30]]))
    assert len(read_reference(path, frame="RAS").reference.triangles) == len(mesh.triangles)


@pytest.mark.parametrize(
    ("signs", "sides"),
    [
        ((-1.0, -1.0, 1.0), "left and right, and front and back"),
        ((-1.0, 1.0, 1.0), "left and right"),
        ((1.0, 1.0, -1.0), "top and bottom"),
        ((1.0, 1.0, 1.0), ""),
    ],
)
def test_a_mirrored_mesh_is_suspected(surface, signs, sides):
    mesh = triangulate(surface)
    reference = closed_mesh(ReferenceMesh(mesh.points * signs, mesh.triangles))
    dice = compare(surface, reference, n_points=200).volume_dice
    found, better = mirrored(surface, reference, dice)
    assert found == sides
    assert better > 0.99


def test_a_mirrored_organ_that_is_nearly_symmetric_is_suspected():
    """As a bladder is: mirrored at the middle of the patient it has nine tenths of its volume in common with itself."""
    bladder = pelvic_organs()["bladder"]
    mesh = triangulate(bladder)
    for signs, sides in (((-1.0, 1.0, 1.0), "left and right"), ((1.0, 1.0, 1.0), "")):
        reference = closed_mesh(ReferenceMesh(mesh.points * signs, mesh.triangles))
        dice = volume_dice(ReferenceMesh(mesh.points, mesh.triangles), reference)
        assert dice > 0.85
        assert mirrored(bladder, reference, dice)[0] == sides


def test_a_label_image_that_was_turned_over_on_its_grid_is_suspected(surface, tmp_path):
    matrix = np.eye(4)
    # The organ is not in the middle of the grid, nor the grid at the origin.
    matrix[:3, 3] = CENTER - [10.0, 16.0, 15.0]
    k, j, i = np.indices((32, 32, 32))
    away = np.stack([i, j, k], axis=-1) + matrix[:3, 3] - CENTER
    mask = ((away / [8.0, 10.0, 12.0]) ** 2).sum(axis=-1) < 1.0
    found = []
    for name, array in (("right", mask), ("over", mask[:, :, ::-1])):
        write_image(Image(array, matrix), tmp_path / f"{name}.nii.gz")
        read = read_reference(tmp_path / f"{name}.nii.gz")
        dice = compare(surface, read.reference, n_points=200).volume_dice
        found.append(mirrored(surface, read.reference, dice, center=read.center)[0])
    assert found == ["", "left and right"]


# ------------------------------------------------------------------ label images and surfaces


def test_hollows_are_told(tmp_path):
    mask = np.zeros((12, 12, 12), dtype=np.uint8)
    mask[2:10, 2:10, 2:10] = 1
    mask[4:8, 4:8, 4:8] = 0
    path = tmp_path / "wall.nii.gz"
    write_image(Image(mask, np.eye(4)), path)
    values = {"reference": f"{path}, label 1", "count": 1}
    (diagnostic,) = read_reference(path).diagnostics
    assert (diagnostic.code, diagnostic.values) == ("reference_hollow", values)
    assert read_reference(path, largest=True).diagnostics == ()


def test_a_wall_that_is_open_in_its_last_slices_is_told(tmp_path):
    mask = np.zeros((12, 12, 12), dtype=np.uint8)
    mask[:, 2:10, 2:10] = 1
    mask[:, 4:8, 4:8] = 0
    path = tmp_path / "wall.nii.gz"
    write_image(Image(mask, np.eye(4)), path)
    (diagnostic,) = read_reference(path).diagnostics
    assert (diagnostic.code, diagnostic.values["share"]) == ("reference_open_wall", pytest.approx(16 / 64))


def test_stray_pieces_of_a_label_are_told_and_left_out(tmp_path):
    array = np.zeros((20, 20, 20), dtype=np.uint8)
    array[4:14, 4:14, 4:14] = 2
    array[8, 8, 8], array[17, 17, 17] = 0, 2
    path = tmp_path / "label.nii.gz"
    write_image(Image(array, np.eye(4)), path)
    read = read_reference(path)
    assert (read.kind, read.label) == ("label image", "2")
    values = {"reference": f"{path}, label 2"}
    pieces, hollow = read.diagnostics
    assert pieces == Diagnostic("reference_in_pieces", {**values, "count": 2})
    assert hollow == Diagnostic("reference_hollow", {**values, "count": 1})
    # Flying edges cut the corners of voxels: a lone one has a sixth of its volume, a block loses its edges.
    assert enclosed_volume(read.reference.points, read.reference.triangles) == pytest.approx(1000.0, rel=0.02)
    largest = read_reference(path, largest=True)
    assert largest.diagnostics == largest.notes == ()
    assert depth(largest.reference, [8.0, 8.0, 8.0]) == pytest.approx(-4.5, abs=1e-6)
    assert depth(largest.reference, [17.0, 17.0, 17.0]) > 3.0
    array[15:19, 15:19, 15:19] = 2
    write_image(Image(array, np.eye(4)), path)
    assert [found.code for found in read_reference(path, largest=True).diagnostics] == ["segmentation_in_pieces"]


def test_a_surface_is_read_as_it_is(surface, tmp_path):
    path = tmp_path / "organ.json"
    write_surface(surface, path, name="organ")
    read = read_reference(path)
    assert isinstance(read.reference, BSplineSurface)
    np.testing.assert_array_equal(read.reference.control_net, surface.control_net)


@pytest.mark.parametrize("name", ["organ.step", "ORGAN.VTU", "organ.glb"])
def test_shapes_of_other_programs_are_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(ValueError, match=r"is of a kind that is not read; save it as a closed mesh \(.stl, "):
        read_reference(tmp_path / name)


def test_options_of_other_kinds_are_refused(surface, tmp_path):
    path = tmp_path / "organ.json"
    write_surface(surface, path, name="organ")
    named = {"label": "--label", "frame": "The frame of a mesh", "largest": "--largest"}
    for option in ({"label": 1}, {"frame": "RAS"}, {"largest": True}):
        told = named[next(iter(option))]
        with pytest.raises(ValueError, match=rf"{told} was given, which does not fit .*surface"):
            read_reference(path, **option)


def test_the_experts_lumen_is_read_without_its_stray_pieces(shared_data):
    path = shared_data / "bladder_mri" / "full_p5_label.nii.gz"
    if not path.exists():
        pytest.skip("there are no images of bladders in ../shared/data")
    with pytest.raises(ValueError, match="holds 3 labels, 1, 2, 3; choose one"):
        read_reference(path)
    read = read_reference(path, label=3, largest=True)
    # What the experts' voxels have in all, less what the corners of voxels lose.
    assert enclosed_volume(read.reference.points, read.reference.triangles) / 1000.0 == pytest.approx(148.4, abs=0.5)
