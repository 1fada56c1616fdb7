"""NIfTI files are read as nibabel reads them, placed by their sform; what they leave open is told."""

from __future__ import annotations

import gzip
import re
import struct

import numpy as np
import pytest
import SimpleITK as sitk
from placed_levels import farthest, levels_of

from VICRegistrationLib.imaging.reading import read_image

nib = pytest.importorskip("nibabel", reason="nibabel is not installed")

SIZE = (10, 12, 6)
SHEAR = np.array([[1.0, 0.0, 0.1], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
# A rotation by 40 degrees about an oblique axis.
TURN = np.array(
    [[0.789, -0.5, 0.356], [0.5669, 0.8217, -0.1026], [-0.2409, 0.2829, 0.9285]],
)
TURN = np.linalg.svd(TURN)[0] @ np.linalg.svd(TURN)[2]


def affine(turn=None, flips=(-1, -1, 1)):
    """Matrix to RAS mm of voxels of 0.6 x 0.8 x 3 mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn) @ np.diag([0.6, 0.8, 3.0]) @ np.diag(flips)
    matrix[:3, 3] = [20.0, 15.0, -30.0]
    return matrix


def nifti(path, matrix, *, sform=1, qform=1, other=None, kind=nib.Nifti1Image, dtype=np.int16, order="<", **fields):
    """Write a file whose grey levels tell their places; `other` is its qform if it differs."""
    data = levels_of(matrix, SIZE).T.astype(dtype)
    image = kind(data, None, kind.header_class(endianness=order))
    image.header.set_data_dtype(dtype)
    image.header.set_zooms(np.linalg.norm(matrix[:3, :3], axis=0))
    image.set_sform(matrix if sform else None, sform)
    image.set_qform((matrix if other is None else other) if qform else None, qform)
    for name, value in fields.items():
        image.header[name] = value
    nib.save(image, path)
    return path


def patched(path, offset, content):
    """Replace bytes of a file."""
    whole = bytearray(path.read_bytes())
    whole[offset : offset + len(content)] = content
    path.write_bytes(whole)
    return path


def check(path, *, warn=None):
    """Read a file, and compare it with nibabel's reading and with its own grey levels."""
    notes = []
    found = read_image(path, warn=notes.append if warn is None else warn)
    other = nib.load(path)
    np.testing.assert_allclose(found.ijk_to_ras, other.affine, atol=1e-6)
    np.testing.assert_array_equal(found.array.T, np.asarray(other.dataobj))
    assert farthest(found) < 0.05
    return notes


# ------------------------------------------------------------------ what is read


@pytest.mark.parametrize(
    ("sform", "qform", "kind", "name"),
    [
        (1, 1, nib.Nifti1Image, "a.nii"),
        (2, 0, nib.Nifti2Image, "a.nii.gz"),
        (0, 1, nib.Nifti2Image, "a.nii"),
        (4, 0, nib.Nifti1Image, "a.nii.gz"),
    ],
)
@pytest.mark.parametrize("turn", [None, TURN])
@pytest.mark.parametrize("flips", [(-1, -1, 1), (1, 1, 1), (1, -1, 1), (-1, -1, -1)])
def test_a_file_is_where_its_matrix_says(tmp_path, kind, name, sform, qform, turn, flips):
    assert check(nifti(tmp_path / name, affine(turn, flips), sform=sform, qform=qform, kind=kind)) == []


def test_a_pair_of_files_is_read_by_either(tmp_path):
    path = nifti(tmp_path / "a.img", affine(TURN), kind=nib.Nifti1Pair)
    assert check(path) == []
    assert farthest(read_image(path.with_suffix(".hdr"))) < 0.05
    path.unlink()
    with pytest.raises(ValueError, match=r"its other half, \.hdr or \.img, is not beside it"):
        read_image(path.with_suffix(".hdr"))


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.float32, np.float64])
@pytest.mark.parametrize("order", ["<", ">"])
def test_all_types_in_both_orders(tmp_path, dtype, order):
    assert check(nifti(tmp_path / "a.nii", affine(), dtype=dtype, order=order)) == []


def test_slope_and_intercept_are_applied(tmp_path):
    path = nifti(tmp_path / "a.nii", affine())
    patched(path, 112, struct.pack("<2f", 0.25, -7.0))
    found = read_image(path)
    np.testing.assert_allclose(found.array.T, np.asarray(nib.load(path).dataobj), rtol=1e-6)
    assert found.array.min() != np.round(found.array.min())


def test_a_sheared_file_is_read_as_it_is(tmp_path):
    matrix = affine()
    matrix[:3, :3] = SHEAR @ matrix[:3, :3]
    notes = check(nifti(tmp_path / "a.nii", matrix))
    assert [re.sub(r".*: its", "its", note) for note in notes] == [
        "its qform places it up to 0.8 mm away from its sform; the sform was taken",
        "its axes are 5.7 degrees from perpendicular (a tilted gantry?); it is placed as it says",
    ]


def test_noise_of_a_rotation_is_read_as_it_is(tmp_path):
    matrix = affine(TURN)
    matrix[:3, :3] *= 1.0 + np.random.default_rng(0).uniform(-0.003, 0.003, (3, 3))
    assert check(nifti(tmp_path / "a.nii", matrix)) == []


def test_one_of_four_dimensions_is_chosen(tmp_path):
    # A left-handed grid, whose slices VTK turns round.
    matrix = affine(flips=(1, -1, 1))
    levels = levels_of(matrix, SIZE).T
    path = tmp_path / "a.nii.gz"
    nib.save(nib.Nifti1Image(np.stack([levels + np.int16(100 * time) for time in range(4)], axis=-1), matrix), path)
    with pytest.raises(
        ValueError, match="holds 4 volumes; one volume is needed. Choose it with --frame 1 to --frame 4"
    ):
        read_image(path)
    with pytest.raises(ValueError, match="Volume 5 was asked for, but .* holds 4 volumes"):
        read_image(path, frame=5)
    found = read_image(path, frame=3)
    np.testing.assert_array_equal(found.array.T, levels + 200)
    np.testing.assert_allclose(found.ijk_to_ras, matrix, atol=1e-6)


# ------------------------------------------------------------------ what contradicts itself


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.6, 0.8, 0.0), (np.nan, 0.8, 3.0), (0.6, 0.8, -3.0)])
def test_a_spacing_that_is_not_the_sforms_is_told(tmp_path, spacing):
    path = patched(nifti(tmp_path / "a.nii", affine(), qform=0), 80, struct.pack("<3f", *spacing))
    notes = []
    assert farthest(read_image(path, warn=notes.append)) < 0.05
    assert len(notes) == 1
    assert "its sform has voxels of 0.6 x 0.8 x 3 mm, its pixdim says " in notes[0]


def test_a_qform_elsewhere_is_told(tmp_path):
    notes = check(nifti(tmp_path / "a.nii", affine(), sform=4, other=affine(TURN)))
    assert len(notes) == 1
    assert "mm away from its sform; the sform was taken" in notes[0]


def test_a_file_without_both_is_placed_as_slicer_does(tmp_path):
    path = nifti(tmp_path / "a.nii", affine(), sform=0, qform=0)
    notes = []
    found = read_image(path, warn=notes.append)
    volume = sitk.ReadImage(str(path))
    np.testing.assert_allclose(found.ijk_to_ras, np.diag([-0.6, -0.8, 3.0, 1.0]), atol=1e-6)
    np.testing.assert_allclose(volume.GetSpacing(), [0.6, 0.8, 3.0], atol=1e-6)
    assert volume.GetDirection() == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    assert len(notes) == 1
    assert "(no sform, no qform)" in notes[0]


@pytest.mark.parametrize(("unit", "scale", "word"), [(1, 1e3, "metres"), (3, 1e-3, "micrometres")])
def test_other_units_are_converted(tmp_path, unit, scale, word):
    path = nifti(tmp_path / "a.nii", affine(), xyzt_units=unit)
    with pytest.warns(UserWarning, match=f"its lengths are in {word}; they were converted to mm"):
        found = read_image(path)
    np.testing.assert_allclose(found.ijk_to_ras[:3], scale * affine()[:3], rtol=1e-6, atol=1e-9)


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, name, value):
    data = np.zeros(SIZE, np.float32)
    data[3, 2, 1] = data[0, 0, 0] = value
    nib.save(nib.Nifti1Image(data, affine()), tmp_path / name)
    with pytest.raises(ValueError, match=f"{name}.*2 of .* 720 voxels are not finite"):
        read_image(tmp_path / name)


@pytest.mark.parametrize("code", ["sform", "qform"])
@pytest.mark.parametrize("step", [0.0, -1.0, np.nan])
def test_a_broken_spacing_that_counts_is_refused(tmp_path, code, step):
    path = nifti(tmp_path / "a.nii", affine(), sform=0, qform=1 if code == "qform" else 0)
    patched(path, 84, struct.pack("<f", step))
    with pytest.raises(ValueError, match=r"every spacing must be positive. Correct its header \(pixdim\)"):
        read_image(path)


@pytest.mark.parametrize("number", [np.nan, np.inf, 1.1])
def test_a_qform_of_no_numbers_is_refused_where_it_counts(tmp_path, number):
    broken = struct.pack("<f", number)
    path = patched(nifti(tmp_path / "a.nii", affine(), sform=0), 256, broken)
    with pytest.raises(ValueError, match="a.nii has a qform whose quaternion is no rotation .*, and no sform"):
        read_image(path)
    assert check(patched(nifti(tmp_path / "b.nii", affine()), 256, broken)) == []


@pytest.mark.parametrize("broken", [bytes(48), struct.pack("<12f", *[np.nan] * 12), struct.pack("<12f", *range(12))])
def test_a_sound_qform_is_taken_in_place_of_an_sform_that_places_nothing(tmp_path, broken):
    path = patched(nifti(tmp_path / "a.nii", affine()), 280, broken)
    notes = []
    assert farthest(read_image(path, warn=notes.append)) < 0.05
    assert ["its sform places no voxels" in note for note in notes] == [True]


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_file_cut_short_is_refused(tmp_path, name):
    path = nifti(tmp_path / name, affine())
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(ValueError, match="is cut short"):
        read_image(path)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("name", ["a.nii", "scan", "scan.img.1"])
def test_a_file_is_known_by_what_it_holds(tmp_path, name, packed):
    path = nifti(tmp_path / "b.nii", affine()).rename(tmp_path / name)
    if packed:
        path.write_bytes(gzip.compress(path.read_bytes()))
    assert farthest(read_image(path)) < 0.05


def test_numbers_too_great_are_refused_and_nothing_else_is_printed(tmp_path):
    path = patched(nifti(tmp_path / "a.nii", affine()), 112, struct.pack("<2f", 3e38, 0.0))
    with pytest.raises(ValueError, match="voxels are not finite"):
        read_image(path)


@pytest.mark.parametrize(
    ("offset", "content", "words"),
    [
        (70, struct.pack("<2h", 32, 64), "holds complex numbers"),
        (70, struct.pack("<2h", 128, 24), "holds colours"),
        (70, struct.pack("<2h", 1536, 128), "voxels of NIfTI type 1536"),
        (40, struct.pack("<8h", 5, 10, 4, 6, 1, 3, 1, 1), "holds vectors of 3 values"),
        (40, struct.pack("<8h", 2, 10, 72, 1, 1, 1, 1, 1), "holds a single slice"),
        (40, struct.pack("<8h", 3, 10, 72, 1, 1, 1, 1, 1), "holds a single slice"),
        # VTK's reader ends the process with these.
        (40, struct.pack("<8h", 3, 10, 0, 9, 1, 1, 1, 1), "10 x 0 x 9 voxels, so its header is damaged"),
        (108, struct.pack("<f", 0.0), "its voxels begin at byte 0, inside of its header"),
        (344, b"abc\0", "its header lacks the mark n+1"),
        (280, bytes(48), "has an sform that places no voxels (0 0 0 0; 0 0 0 0; 0 0 0 0), and no qform"),
        (292, struct.pack("<f", np.nan), "has an sform that places no voxels"),
    ],
)
def test_what_is_no_volume_is_refused(tmp_path, offset, content, words):
    path = patched(nifti(tmp_path / "a.nii", affine(), qform=0), offset, content)
    with pytest.raises(ValueError, match=re.escape(words)):
        read_image(path, warn=lambda note: None)
