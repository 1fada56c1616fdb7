"""Files give the volume that was written, in RAS, and nothing is written by halves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import read_image, write_image

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "prostatex"


@pytest.fixture
def oblique():
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * [0.6, 0.7, 3.5]
    matrix[:3, 3] = [10, -20, 30]
    return Image(np.random.default_rng(1).integers(0, 900, (4, 6, 5)).astype(np.int16), matrix)


def write_dicom(folder, *, uid="1.2.3.4", description="T2 sag", positions=(0.0, 4.0, 8.0, 12.0), first=0):
    folder.mkdir(exist_ok=True)
    for number, position in enumerate(positions):
        slice_ = sitk.GetImageFromArray(np.full((1, 5, 6), 10 * number + 1, dtype=np.int16))
        slice_.SetSpacing([0.6, 0.6, 4.0])
        tags = {
            "0008|0060": "MR",
            "0008|103e": description,
            "0008|0018": f"{uid}.{number + 1}",
            "0020|000d": "1.2.3",
            "0020|000e": uid,
            "0020|0013": str(number),
            "0020|0032": f"0\\0\\{position}",
            "0020|0037": "1\\0\\0\\0\\1\\0",
        }
        for tag, value in tags.items():
            slice_.SetMetaData(tag, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(str(folder / f"{first + number:03d}.dcm"))
        writer.Execute(slice_)
    return folder


def test_left_and_posterior_of_the_file_become_negative(tmp_path):
    volume = sitk.GetImageFromArray(np.arange(60, dtype=np.int16).reshape(3, 4, 5))
    volume.SetSpacing([0.5, 0.6, 4.0])
    volume.SetOrigin([10.0, 20.0, 30.0])
    sitk.WriteImage(volume, str(tmp_path / "image.nrrd"))
    image = read_image(tmp_path / "image.nrrd")
    expected = np.diag([-0.5, -0.6, 4.0, 1.0])
    expected[:3, 3] = [-10, -20, 30]
    np.testing.assert_allclose(image.ijk_to_ras, expected)
    assert image.array[2, 3, 4] == 59


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_what_is_written_is_read_again(oblique, tmp_path, suffix):
    write_image(oblique, tmp_path / f"image{suffix}")
    image = read_image(tmp_path / f"image{suffix}")
    np.testing.assert_array_equal(image.array, oblique.array)
    assert image.array.dtype == oblique.array.dtype
    # NIfTI keeps the matrix in single precision.
    np.testing.assert_allclose(image.ijk_to_ras, oblique.ijk_to_ras, atol=1e-5)
    assert [path.name for path in tmp_path.iterdir()] == [f"image{suffix}"]


def test_masks_and_views_are_written(oblique, tmp_path):
    mask = Image(oblique.array > 400, oblique.ijk_to_ras).canonical()
    write_image(mask, tmp_path / "mask.nii.gz")
    again = read_image(tmp_path / "mask.nii.gz")
    assert again.array.dtype == np.uint8
    np.testing.assert_array_equal(again.array, mask.array)


def test_one_frame_in_four_dimensions_is_a_volume(tmp_path):
    volume = sitk.Image([5, 6, 7, 1], sitk.sitkInt16)
    sitk.WriteImage(volume, str(tmp_path / "one.nrrd"))
    notes = []
    assert read_image(tmp_path / "one.nrrd", warn=notes.append).array.shape == (7, 6, 5)
    # ITK names no space for four dimensions.
    assert len(notes) == 1
    assert "does not say which way its axes point" in notes[0]


def test_a_dicom_folder_is_a_volume(tmp_path):
    image = read_image(write_dicom(tmp_path / "series"))
    assert image.array.shape == (4, 5, 6)
    np.testing.assert_allclose(image.spacing, [0.6, 0.6, 4.0])
    assert image.array[:, 0, 0].tolist() == [1, 11, 21, 31]


@pytest.mark.parametrize("series", ["1.2.3.5", "DWI"])
def test_one_of_several_series_is_chosen_by_uid_or_description(tmp_path, series):
    write_dicom(tmp_path / "study")
    write_dicom(tmp_path / "study", uid="1.2.3.5", description="DWI", positions=(0.0, 5.0), first=10)
    assert read_image(tmp_path / "study", series=series).array.shape == (2, 5, 6)


def test_several_series_are_listed(tmp_path):
    write_dicom(tmp_path / "study")
    write_dicom(tmp_path / "study", uid="1.2.3.5", description="DWI", positions=(0.0, 5.0), first=10)
    with pytest.raises(ValueError, match="holds 2 DICOM series") as caught:
        read_image(tmp_path / "study")
    message = str(caught.value)
    assert "1.2.3.4 'T2 sag', 4 files" in message
    assert "1.2.3.5 'DWI', 2 files" in message
    assert "--series" in message
    with pytest.raises(ValueError, match="none of them match 'T1'"):
        read_image(tmp_path / "study", series="T1")


@pytest.mark.skipif(not DATA.is_dir(), reason="the prostate MRI are not beside the checkout")
def test_a_real_series_is_the_same_from_dicom_and_from_nifti():
    nifti, dicom = read_image(DATA / "px0_sag.nii.gz"), read_image(DATA / "px0_sag_dicom")
    np.testing.assert_array_equal(nifti.array, dicom.array)
    # NIfTI keeps the matrix in single precision.
    np.testing.assert_allclose(nifti.ijk_to_ras, dicom.ijk_to_ras, atol=1e-4)
