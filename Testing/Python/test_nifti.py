"""NIfTI files that ITK would repair in silence are refused."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
import SimpleITK as sitk

from VICRegistrationLib.imaging.reading import read_image


def nifti(path, dtype=np.float32, **changes):
    """Write a NIfTI file; numbers in `changes` replace voxels, or fields of the header by offset."""
    array = np.arange(60, dtype=dtype).reshape(3, 4, 5)
    for place, value in changes.get("voxels", {}).items():
        array[place] = value
    content = bytearray(348 + 4 + array.nbytes)
    struct.pack_into("<i", content, 0, 348)
    struct.pack_into("<8h", content, 40, 3, 5, 4, 3, 1, 1, 1, 1)
    code, bits = {"f4": (16, 32), "f8": (64, 64), "i2": (4, 16)}[array.dtype.str[1:]]
    struct.pack_into("<2h", content, 70, code, bits)
    struct.pack_into("<8f", content, 76, 1.0, *changes.get("spacing", (0.5, 0.5, 4.0)), 0, 0, 0, 0)
    struct.pack_into("<f", content, 108, 352.0)
    struct.pack_into("<2h", content, 252, 1, 0)
    content[344:348] = b"n+1\0"
    content[352:] = array.tobytes()
    path.write_bytes(gzip.compress(content) if path.name.endswith(".gz") else content)
    return path


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_a_sound_file_is_read(tmp_path, name, dtype):
    image = read_image(nifti(tmp_path / name, dtype))
    np.testing.assert_array_equal(image.array.ravel(), np.arange(60))
    np.testing.assert_allclose(image.spacing, [0.5, 0.5, 4.0])


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_that_are_not_finite_are_refused(tmp_path, name, value, dtype):
    path = nifti(tmp_path / name, dtype, voxels={(1, 2, 3): value, (0, 0, 0): value})
    with pytest.raises(ValueError, match=f"{name}.*2 of .* 60 voxels are not finite"):
        read_image(path)


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan])
def test_a_broken_spacing_is_refused(tmp_path, step):
    path = nifti(tmp_path / "a.nii", spacing=(0.5, step, 4.0))
    with pytest.raises(ValueError, match="every spacing must be positive. Correct the file's header"):
        read_image(path)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_file_cut_short_is_refused(tmp_path, name):
    path = nifti(tmp_path / name)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(ValueError, match="is cut short"):
        read_image(path)


def test_what_simpleitk_writes_is_read(tmp_path):
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((3, 4, 5), np.float32)), str(tmp_path / "b.nii.gz"))
    assert read_image(tmp_path / "b.nii.gz").array.shape == (3, 4, 5)
