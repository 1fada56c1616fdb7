"""NRRD, MetaImage and VTK files tell the distances of their voxels, or are refused; what else they do not is told."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
import SimpleITK as sitk
from placed_levels import farthest, levels_of

from VICRegistrationLib.imaging.library_messages import itk_warnings
from VICRegistrationLib.imaging.reading import read_image

SIZE = (6, 5, 4)
AXES = "which way its axes point"
ORIGIN = "where its first voxel is"


def grid(directions, origin):
    """Matrix to RAS mm of LPS columns and origin."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.transpose(directions)
    matrix[:3, 3] = origin
    return np.diag([-1.0, -1.0, 1.0, 1.0]) @ matrix


PLAIN = grid([(1, 0, 0), (0, 1, 0), (0, 0, 3)], (0, 0, 0))


def nrrd(path, *lines, matrix=PLAIN, sizes="6 5 4", repeat=1):
    head = ["NRRD0005", "type: short", "endian: little", f"dimension: {len(sizes.split())}"]
    if not any(line.startswith("encoding") for line in lines):
        head.append("encoding: raw")
    data = levels_of(matrix, SIZE).astype("<i2").tobytes() * repeat
    path.write_bytes("\n".join([*head, f"sizes: {sizes}", *lines, "", ""]).encode() + data)
    return path


def meta(path, *lines, matrix=PLAIN):
    head = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "BinaryDataByteOrderMSB = False"]
    tail = ["DimSize = 6 5 4", "ElementType = MET_SHORT", "ElementDataFile = LOCAL", ""]
    path.write_bytes("\n".join([*head, *lines, *tail]).encode() + levels_of(matrix, SIZE).astype("<i2").tobytes())
    return path


def vtk(path, *lines, matrix=PLAIN):
    head = ["# vtk DataFile Version 3.0", "x", "BINARY", "DATASET STRUCTURED_POINTS", "DIMENSIONS 6 5 4"]
    tail = ["POINT_DATA 120", "SCALARS s short 1", "LOOKUP_TABLE default", ""]
    path.write_bytes("\n".join([*head, *lines, *tail]).encode() + levels_of(matrix, SIZE).astype(">i2").tobytes())
    return path


def notes_of(path, **options):
    """Check the places of all voxels, and give what was told."""
    notes = []
    assert farthest(read_image(path, warn=notes.append, **options)) == 0.0
    return notes


def refusal(path, **options):
    with pytest.raises(ValueError, match=r"\.$") as caught:
        read_image(path, **options)
    return str(caught.value)


@pytest.mark.parametrize("third", [(0, 0, 3), (0.3, 0, 3), (0.3, -0.8, -3)])
@pytest.mark.parametrize("space", ["left-posterior-superior", "LPS", "right-anterior-superior", "RAS"])
def test_a_complete_nrrd_file_is_where_it_says(tmp_path, space, third):
    signs = np.array([1, 1, 1]) if space.lower().startswith("l") else np.array([-1, -1, 1])
    directions = np.array([(1, 0.1, 0), (0, 1, 0), third])
    matrix = grid(directions, (7, 8, 9))
    told = [" ".join(f"({x:.17g},{y:.17g},{z:.17g})" for x, y, z in rows * signs) for rows in (directions, [(7, 8, 9)])]
    lines = (
        f"space: {space}",
        f"space directions: {told[0]}",
        f"space origin: {told[1]}",
        'space units: "mm" "mm" "mm"',
    )
    notes = notes_of(nrrd(tmp_path / "a.nrrd", *lines, matrix=matrix))
    assert ["degrees from perpendicular" in note for note in notes] == [True]


def test_a_complete_metaimage_is_where_it_says(tmp_path):
    matrix = grid([(1, 0, 0), (0, 1, 0), (0.6, 0, 3)], (7, 8, 9))
    lines = ("Offset = 7 8 9", "TransformMatrix = 1 0 0 0 1 0 0.2 0 1", "ElementSpacing = 1 1 3")
    notes = notes_of(meta(tmp_path / "a.mha", *lines, matrix=matrix))
    assert ["11.3 degrees from perpendicular" in note for note in notes] == [True]


VECTORS = "space directions: (1,0,0) (0,1,0) (0,0,3)"


@pytest.mark.parametrize(
    ("write", "name", "lines", "told"),
    [
        (nrrd, "a.nrrd", ["spacings: 1 1 3"], [AXES, ORIGIN]),
        (nrrd, "a.nrrd", ["space dimension: 3", VECTORS, "space origin: (0,0,0)"], [AXES]),
        (nrrd, "a.nrrd", ["space: scanner-xyz", VECTORS, "space origin: (0,0,0)"], [AXES]),
        (nrrd, "a.nrrd", ["space: LPS", VECTORS], [ORIGIN]),
        (meta, "a.mha", ["ElementSpacing = 1 1 3"], [AXES, ORIGIN]),
        (meta, "a.mha", ["ElementSize = 1 1 3", "Offset = 0 0 0"], [AXES]),
        (vtk, "a.vtk", ["SPACING 1 1 3", "ORIGIN 0 0 0"], [AXES]),
        (vtk, "a.vtk", ["ASPECT_RATIO 1 1 3"], [AXES]),
    ],
)
def test_what_a_file_leaves_open_is_told(tmp_path, write, name, lines, told):
    notes = notes_of(write(tmp_path / name, *lines))
    assert len(notes) == len(told)
    assert all(words in note for words, note in zip(told, notes)), notes


@pytest.mark.parametrize(
    ("write", "name", "lines", "words"),
    [
        (nrrd, "a.nrrd", [], "no space directions for each of its three axes"),
        (nrrd, "a.nrrd", ["spacings: 1 1 nan"], "no space directions for each of its three axes"),
        (nrrd, "a.nrrd", ["space: LPS", "space directions: (1,0,0) (0,1,0) none"], "no space directions"),
        (nrrd, "a.nrrd", ["space: LPS", "space directions: (1,0,0) (0,1,0) (0,0,0)"], "every spacing must be positive"),
        (nrrd, "a.nrrd", ["space: RAS", VECTORS, 'space units: "m" "m" "m"'], "gives its lengths in m; millimetres"),
        (meta, "a.mha", [], "no ElementSpacing for each of its three axes"),
        (meta, "a.mha", ["ElementSpacing = 1 1 0"], "every spacing must be positive"),
        (meta, "a.mha", ["ElementSpacing = 1 1 -3"], "every spacing must be positive"),
        (meta, "a.mha", ["ElementSpacing = 1 1 3", "DistanceUnits = um"], "gives its lengths in um; millimetres"),
        (vtk, "a.vtk", [], "no SPACING for each of its three axes"),
        (vtk, "a.vtk", ["ORIGIN 0 0 0"], "no SPACING for each of its three axes"),
    ],
)
def test_distances_are_not_invented(tmp_path, write, name, lines, words):
    assert words in refusal(write(tmp_path / name, *lines))


@pytest.mark.parametrize(
    ("write", "name", "lines", "keep", "words"),
    [
        (nrrd, "a.nrrd", ["space: LPS", VECTORS], -9, "its data end too soon"),
        (meta, "a.mha", ["ElementSpacing = 1 1 3"], -9, "its data end too soon"),
        (nrrd, "a.nrrd", [VECTORS, "space: LPS"], None, "directions, an origin or units above its space"),
        (nrrd, "a.nrrd", ["space: LPS", "space directions: (1,0,0) (1,0,0) (0,0,3)"], None, "axes have one direction"),
        (nrrd, "a.nhdr", ["space: LPS", VECTORS, "data file: gone.raw"], None, "gone.raw, is not beside it"),
        (nrrd, "a.nrrd", ["space: LPS", VECTORS, "encoding: bzip2"], None, "compressed by bzip2, which ITK cannot"),
        (nrrd, "a.nrrd", ["space: up-left-banana", VECTORS], None, "its space is none that NRRD knows"),
        (nrrd, "a.nrrd", ["space: LPS", VECTORS, "space origin: (nan,0,0)"], None, "its origin are no numbers"),
        (meta, "a.mha", ["ElementSpacing = 1 1 3", "NDims = 3"], -9, "its data end too soon"),
    ],
)
def test_why_a_file_cannot_be_read_is_reported(tmp_path, write, name, lines, keep, words):
    path = write(tmp_path / name, *lines)
    path.write_bytes(path.read_bytes()[:keep])
    assert words in refusal(path)


def test_why_packed_voxels_cannot_be_read_is_reported(tmp_path):
    data = levels_of(PLAIN, SIZE).astype("<i2").tobytes()
    path = nrrd(tmp_path / "a.nrrd", "space: LPS", VECTORS, "encoding: gzip")
    head = path.read_bytes()[: -len(data)]
    path.write_bytes(head + gzip.compress(data)[:-30])
    assert "its data end too soon" in refusal(path)
    path.write_bytes(head.replace(b"endian: little\n", b"") + gzip.compress(data))
    assert "does not give the order of bytes" in refusal(path)


def test_a_field_above_those_that_it_needs_is_named(tmp_path):
    path = meta(tmp_path / "a.mha", "ElementSpacing = 1 1 3")
    first = b"Offset = 1 2 3\n"
    path.write_bytes(first + path.read_bytes())
    assert "has Offset above NDims, which has to come first" in refusal(path)


def test_an_axis_of_time_is_no_slice(tmp_path):
    path = nrrd(tmp_path / "cine.nrrd", "spacings: 1 1 3", "kinds: domain domain time")
    assert "one of its three axes is time (kinds: domain domain time)" in refusal(path)


def test_directions_that_scale_the_voxels_are_told(tmp_path):
    matrix = grid([(2, 0, 0), (0, 1, 0), (0, 0, 3)], (0, 0, 0))
    lines = ("Offset = 0 0 0", "TransformMatrix = 2 0 0 0 1 0 0 0 1", "ElementSpacing = 1 1 3")
    notes = notes_of(meta(tmp_path / "a.mha", *lines, matrix=matrix))
    assert ["lengths 2 x 1 x 1 instead of 1" in note for note in notes] == [True]


@pytest.mark.parametrize(
    ("write", "name", "line", "words"),
    [
        (meta, "a.mha", "NDims = -1", "says that it has -1 dimensions"),
        (meta, "a.mha", "NDims = 99999", "says that it has 99999 dimensions"),
        (meta, "a.mha", "Offset = 1 2", "has the offset 1 2; 3 numbers are needed"),
        (meta, "a.mha", "Offset = 1 nan 2", "has the offset 1 nan 2; 3 numbers are needed"),
        (meta, "a.mha", "TransformMatrix = 1 0 0 0 1 0 0 0", "has the transformmatrix 1 0 0 0 1 0 0 0; 9 numbers"),
        (vtk, "a.vtk", "ORIGIN 1 x 2", "has the origin 1 x 2; 3 numbers are needed"),
        (vtk, "a.vtk", "ORIGIN 1 2", "has the origin 1 2; 3 numbers are needed"),
    ],
)
def test_numbers_that_are_missing_are_not_taken_for_zeros(tmp_path, write, name, line, words):
    spacing = "SPACING 1 1 3" if write is vtk else "ElementSpacing = 1 1 3"
    assert words in refusal(write(tmp_path / name, spacing, line))


def test_voxels_without_values_are_refused(tmp_path):
    path = vtk(tmp_path / "a.vtk", "SPACING 1 1 3", "ORIGIN 0 0 0")
    path.write_bytes(path.read_bytes().replace(b"short 1", b"short 0"))
    assert "has no values in its voxels" in refusal(path)


@pytest.mark.parametrize("name", ["a.vtk", "a.gipl", "a.gipl.gz"])
def test_images_that_itk_would_fill_up_are_refused(tmp_path, name):
    path = tmp_path / name
    levels = np.random.default_rng(0).integers(0, 1000, (20, 30, 40)).astype(np.int16)
    sitk.WriteImage(sitk.GetImageFromArray(levels), str(path))
    np.testing.assert_array_equal(read_image(path, warn=lambda note: None).array, levels)
    path.write_bytes(path.read_bytes()[:-500])
    assert "is cut short (its data end too soon)" in refusal(path)


def test_a_vtk_image_of_text_that_is_cut_short_is_refused(tmp_path):
    path = vtk(tmp_path / "a.vtk", "SPACING 1 1 3", "ORIGIN 0 0 0")
    head = path.read_bytes().partition(b"LOOKUP_TABLE default\n")[0].replace(b"BINARY", b"ASCII").decode()
    for count, words in ((120, ""), (100, "is cut short")):
        path.write_text(f"{head}LOOKUP_TABLE default\n" + "\n".join(map(str, range(1, count + 1))) + "\n")
        if not words:
            assert read_image(path, warn=lambda note: None).array.ravel().tolist() == list(range(1, 121))
        else:
            assert words in refusal(path)


def test_voxels_in_a_file_that_is_gone(tmp_path):
    volume = sitk.GetImageFromArray(np.zeros((4, 5, 6), np.uint8))
    sitk.WriteImage(volume, str(tmp_path / "a.mhd"))
    (tmp_path / "a.raw").unlink()
    assert "the file of its voxels, a.raw, is not beside it" in refusal(tmp_path / "a.mhd")


@pytest.mark.parametrize(("factor", "warned"), [(0.1, True), (1.0, False)])
def test_lengths_in_centimetres_get_a_warning(tmp_path, factor, warned):
    volume = sitk.GetImageFromArray(np.zeros((20, 200, 200), np.uint8))
    volume.SetSpacing([1.0 * factor, 1.0 * factor, 4.0 * factor])
    sitk.WriteImage(volume, str(tmp_path / "a.nii.gz"), True)
    notes = []
    read_image(tmp_path / "a.nii.gz", warn=notes.append)
    assert ["its longest side is 20 mm, with voxels of 0.1 x 0.1 x 0.4 mm" in note for note in notes] == [True] * warned


def test_a_fourth_axis_that_itk_takes_for_space_is_refused(tmp_path):
    lines = ["space: LPS", f"{VECTORS} none", "space origin: (0,0,0)", "kinds: domain domain domain time"]
    path = nrrd(tmp_path / "a.nrrd", *lines, sizes="6 5 4 2", repeat=2)
    assert "more axes than its space, such as time; save one volume of it" in refusal(path)


@pytest.mark.parametrize(
    ("sizes", "kinds", "vectors"),
    [
        ("6 5 4 3", "domain domain domain list", "(1,0,0) (0,1,0) (0,0,3) none"),
        ("6 5 4 3", "domain domain domain domain", ""),
    ],
)
def test_one_of_several_volumes_is_chosen(tmp_path, sizes, kinds, vectors):
    lines = (
        ["space: LPS", f"space directions: {vectors}", "space origin: (0,0,0)"] if vectors else ["spacings: 1 1 3 1"]
    )
    path = nrrd(tmp_path / "a.nrrd", *lines, f"kinds: {kinds}", sizes=sizes, repeat=3)
    assert "--frame 1 to --frame 3" in refusal(path)
    for frame in (1, 2, 3):
        notes_of(path, frame=frame)
    assert f"Volume 4 was asked for, but {path} holds 3 volumes" in refusal(path, frame=4)


def test_a_space_that_itk_does_not_turn_is_refused(tmp_path):
    lines = ["space: right-anterior-superior-time", "space directions: (1,0,0,0) (0,1,0,0) (0,0,3,0) (0,0,0,1)"]
    path = nrrd(tmp_path / "a.nrrd", *lines, sizes="6 5 2 2")
    assert "space right-anterior-superior-time, which is not understood" in refusal(path)


@pytest.mark.parametrize(
    ("name", "shape"),
    [(name, (20, 20)) for name in ("a.tif", "a.png", "a.jpg", "a.bmp")] + [("a.tif", (5, 20, 20))],
)
def test_pictures_have_no_slice_distance(tmp_path, name, shape):
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros(shape, np.uint8)), str(tmp_path / name))
    assert "does not give the distance of its slices in mm; give the DICOM series" in refusal(tmp_path / name)


@pytest.mark.parametrize("name", ["a.mrc", "a.mnc"])
def test_formats_that_itk_may_misplace_are_refused(tmp_path, name):
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 5, 6), np.uint8)), str(tmp_path / name))
    assert "of which ITK does not know the place in the patient for certain" in refusal(tmp_path / name)


@pytest.mark.parametrize("name", ["a.h5", "a.mhd", "a.nrrd"])
def test_other_formats_keep_the_grid(tmp_path, name):
    matrix = grid([(0, 1, 0), (1, 0, 0), (0, 0, -3)], (7, 8, 9))
    volume = sitk.GetImageFromArray(levels_of(matrix, SIZE))
    volume.SetSpacing([1, 1, 3])
    volume.SetOrigin([7, 8, 9])
    volume.SetDirection([0, 1, 0, 1, 0, 0, 0, 0, -1])
    sitk.WriteImage(volume, str(tmp_path / name))
    assert notes_of(tmp_path / name) == []


def test_warnings_of_itk_are_collected_in_lines(tmp_path, capfd):
    path = tmp_path / "a.nii"
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 5, 6), np.int16)), str(path))
    content = bytearray(path.read_bytes())
    # Slices of 2 mm in pixdim, of 1 mm in the sform.
    struct.pack_into("<f", content, 88, 2.0)
    path.write_bytes(content)
    with itk_warnings() as lines:
        sitk.ReadImage(str(path))
    assert lines == [f"{path} has unexpected scales in sform"]
    assert capfd.readouterr().err == ""
