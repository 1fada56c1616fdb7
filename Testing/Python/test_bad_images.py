"""Whatever is wrong with an image, a seed or a threshold, the message says what it is and what to do."""

from __future__ import annotations

import os
import re

import numpy as np
import pytest
import SimpleITK as sitk
from small_phantom import ellipsoid_image

from VICRegistrationLib.imaging import reading
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.moments import moments
from VICRegistrationLib.imaging.morphology import erode
from VICRegistrationLib.imaging.reading import read_image, write_image
from VICRegistrationLib.imaging.region import Region, region_from_mask
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.ray_edges import find_edges
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.threshold import threshold_between


@pytest.fixture
def image():
    """A bright block of 20 x 20 x 12 mm with a thin fin along i, in a darker volume of 1 mm voxels."""
    levels = np.full((20, 40, 50), 50, dtype=np.int16)
    levels[4:16, 10:30, 8:28] = 200
    levels[9:11, 20:22, 28:44] = 200
    return Image(levels, np.eye(4))


def refused(action, *needed):
    """Check that the action is refused in one line that holds the needed words."""
    with pytest.raises((ValueError, OSError)) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for words in needed:
        assert words in message
    return message


@pytest.mark.parametrize(
    ("array", "needed"),
    [
        (np.zeros((1, 30, 30)), ("30 x 30 x 1 voxels", "several slices")),
        (np.zeros((4, 4)), ("2 dimensions", "three")),
        (np.zeros((2, 3, 4, 5)), ("4 dimensions", "one frame")),
        (np.zeros((3, 3, 3), dtype=complex), ("complex128", "real numbers")),
        (np.full((3, 3, 3), "x"), ("real numbers",)),
    ],
)
def test_arrays_that_are_not_volumes(array, needed):
    refused(lambda: Image(array, np.eye(4)), *needed)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_voxels_without_a_grey_level_are_counted(value):
    array = np.zeros((3, 4, 5), dtype=np.float32)
    array[1, 1, 1:4] = value
    refused(lambda: Image(array, np.eye(4)), "3 of the image's 60 voxels", "not finite", "Replace")


@pytest.mark.parametrize(
    ("matrix", "needed"),
    [
        (np.eye(3), ("shape (3, 3)", "4 x 4")),
        (np.diag([1.0, 0.0, 1.0, 1.0]), ("cannot be inverted", "spacing")),
        ([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], ("cannot be inverted",)),
        (np.diag([1.0, np.nan, 1.0, 1.0]), ("not finite",)),
        (np.diag([1.0, 1.0, 1.0, 2.0]), ("last row",)),
        ("identity", ("4 x 4",)),
    ],
)
def test_matrices_that_place_nothing(matrix, needed):
    refused(lambda: Image(np.zeros((2, 2, 2)), matrix), *needed)


def test_a_file_that_is_not_there(tmp_path):
    refused(lambda: read_image(tmp_path / "none.nii"), "no file or folder", "none.nii")


@pytest.mark.parametrize("name", ["notes.txt", "notes.nii", "empty.nrrd", "empty.nii.gz", "notes.dcm"])
def test_a_file_that_is_no_image(tmp_path, name):
    (tmp_path / name).write_text("" if "empty" in name else "hello " * 100)
    refused(lambda: read_image(tmp_path / name), name, "cannot be read as an image", "complete")


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_a_file_cut_short(tmp_path, suffix):
    path = tmp_path / f"image{suffix}"
    noise = np.random.default_rng(0).integers(0, 1000, (20, 30, 40)).astype(np.int16)
    write_image(Image(noise, np.eye(4)), path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    refused(lambda: read_image(path), f"image{suffix}", "c")


def test_a_colour_image(tmp_path):
    sitk.WriteImage(sitk.Image([5, 5, 5], sitk.sitkVectorUInt8, 3), str(tmp_path / "colour.nrrd"))
    refused(lambda: read_image(tmp_path / "colour.nrrd"), "3 values per voxel", "colour", "--frame 1 to --frame 3")


def test_a_sequence_of_volumes(tmp_path):
    sitk.WriteImage(sitk.Image([5, 5, 5, 7], sitk.sitkInt16), str(tmp_path / "cine.nii"))
    refused(lambda: read_image(tmp_path / "cine.nii"), "holds 7 volumes", "one volume", "--frame 1 to --frame 7")


@pytest.mark.parametrize("size", [[9, 8], [9, 8, 1]])
def test_a_single_slice(tmp_path, size):
    sitk.WriteImage(sitk.Image(size, sitk.sitkInt16), str(tmp_path / "slice.nrrd"))
    refused(lambda: read_image(tmp_path / "slice.nrrd"), "single slice", "several slices")


def test_a_file_with_nan(tmp_path):
    array = np.zeros((3, 4, 5), dtype=np.float32)
    array[0, 0, 0] = np.nan
    sitk.WriteImage(sitk.GetImageFromArray(array), str(tmp_path / "nan.nrrd"))
    refused(lambda: read_image(tmp_path / "nan.nrrd"), "nan.nrrd", "1 of the image's 60 voxels")


def test_an_archive_is_to_be_unpacked(tmp_path):
    (tmp_path / "study.zip").write_bytes(b"PK\3\4" + bytes(100))
    refused(lambda: read_image(tmp_path / "study.zip"), "is an archive; unpack it", "study.zip")


def test_a_folder_without_dicom(tmp_path):
    (tmp_path / "readme.txt").write_text("nothing here")
    refused(lambda: read_image(tmp_path), "holds no DICOM slices")


def test_a_series_of_a_file(tmp_path):
    sitk.WriteImage(sitk.Image([4, 4, 4], sitk.sitkInt16), str(tmp_path / "image.nrrd"))
    refused(lambda: read_image(tmp_path / "image.nrrd", series="1.2"), "is a file", "folder")


def test_an_unknown_ending(image, tmp_path):
    refused(lambda: write_image(image, tmp_path / "image.png"), "image.png", ".nii.gz, .nii, .nrrd, .mha")


def test_a_folder_that_is_not_there(image, tmp_path):
    refused(lambda: write_image(image, tmp_path / "none" / "image.nii"), "does not exist", "create it")


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a user who may not write everywhere")
def test_a_folder_that_may_not_be_written_to(image, tmp_path):
    tmp_path.chmod(0o500)
    refused(lambda: write_image(image, tmp_path / "image.nrrd"), "cannot be written", "may be written to")


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd"])
def test_a_file_that_cannot_be_replaced_leaves_nothing_behind(image, tmp_path, suffix):
    target = tmp_path / f"image{suffix}"
    target.mkdir()
    refused(lambda: write_image(image, target), "cannot be written")
    assert list(tmp_path.iterdir()) == [target]


def test_a_full_disk_leaves_the_old_file(image, tmp_path, monkeypatch):
    path = tmp_path / "image.nii"
    write_image(image, path)
    before = path.read_bytes()

    def write_half(volume, name, **options):
        sitk.WriteImage(volume, name, **options)
        with open(name, "r+b") as file:
            file.truncate(len(before) // 2)

    class FullDisk:
        """SimpleITK on a full disk: its NIfTI writer cuts the file short and reports nothing."""

        def __getattr__(self, name):
            return write_half if name == "WriteImage" else getattr(sitk, name)

    monkeypatch.setattr(reading, "sitk", FullDisk())
    changed = Image(image.array + np.int16(1), image.ijk_to_ras)
    refused(lambda: write_image(changed, path), "not complete", "disk has room")
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_axes_that_are_not_perpendicular_are_not_written(tmp_path):
    sheared = np.eye(4)
    sheared[0, 2] = 0.3
    image = Image(np.zeros((3, 3, 3)), sheared)
    refused(lambda: write_image(image, tmp_path / "image.nrrd"), "not perpendicular", "resample")


@pytest.mark.parametrize(
    ("factor", "needed"),
    [(1e-3, ["0.05 x 0.04 x 0.02 mm, smaller", "holds metres", "1000 times"]), (1e3, ["larger", "micrometres"])],
)
def test_a_volume_in_another_unit(image, factor, needed):
    scaled = Image(image.array, np.diag([factor, factor, factor, 1.0]))
    refused(lambda: separate(scaled, np.array([18.0, 20.0, 10.0]) * factor), *needed, "millimetres")
    region = region_from_mask(scaled, image.array > 100)
    refused(lambda: finish(fit_region(scaled, region)), *needed, "millimetres")


@pytest.mark.parametrize(
    ("seeds", "needed"),
    [
        ([], ("at least one point",)),
        ([[1, 2]], ("shape (1, 2)", "R, A, S")),
        (np.zeros((2, 2, 3)), ("at least one point",)),
        ("bladder", ("at least one point",)),
        ([[np.nan, 0, 0]], ("not finite",)),
        ([[18, 20, 10], [70, 20, 10]], ("70.0, 20.0, 10.0", "outside the volume", "R -0.5 to 49.5")),
    ],
)
def test_seeds_that_are_not_in_the_volume(image, seeds, needed):
    refused(lambda: separate(image, seeds), *needed)
    refused(lambda: find_edges(image, seeds), *needed)


def test_a_seed_outside_the_threshold(image):
    refused(
        lambda: separate(image, [3, 3, 3], threshold=(100, 300)),
        "(3.0, 3.0, 3.0) mm is 50, outside the threshold 100 to 300",
        "move the seed",
    )


def test_seeds_that_no_suggested_threshold_holds():
    # They see nothing but their own voxels.
    seeds = [[-41.02, 3.46, -11.87], [-25.98, 25.37, -18.58], [-2.68, -15.4, 9.16]]
    refused(lambda: separate(ellipsoid_image(), seeds), "No threshold could be suggested", "move the seed")


def test_a_suggested_threshold_without_the_seed_is_not_the_users_fault(image):
    message = refused(
        lambda: separate(image, [[18, 20, 10], [24, 14, 8], [12, 26, 12], [44, 36, 3]]),
        "No threshold could be suggested that holds the seed (44.0, 36.0, 3.0) mm",
        "its grey level is 50",
        "give the threshold",
    )
    assert "widen" not in message


def test_a_threshold_beyond_the_voxels_type(image):
    levels = Image(image.array.astype(np.float32), np.eye(4))
    refused(lambda: separate(levels, [18, 20, 10], threshold=(-1e308, 1e308)), "fills most of the volume")


def test_grey_levels_too_great_to_be_worked_with():
    refused(lambda: Image(np.full((3, 3, 3), -1e200), np.eye(4)), "grey levels reach 1e+200", "scale them down")


@pytest.mark.parametrize(
    ("threshold", "needed"),
    [
        ((300, 100), ("300 to 100 is empty",)),
        ((np.nan, 100), ("nan to 100 is empty",)),
        ((100,), ("two grey levels",)),
        (100, ("two grey levels",)),
        ("bright", ("two grey levels",)),
        ((400, 500), ("outside the threshold 400 to 500",)),
    ],
)
def test_thresholds_that_hold_nothing(image, threshold, needed):
    refused(lambda: separate(image, [18, 20, 10], threshold=threshold), *needed)


def test_a_seed_lost_by_erosion(image):
    message = refused(
        lambda: separate(image, [40, 20, 10], threshold=(100, 300), erosion=3.0),
        "erosion of 3 mm leaves nothing around the seed (40.0, 20.0, 10.0) mm",
        "Use an erosion below",
    )
    below = float(message.split("below ")[1].split(" mm")[0])
    separate(image, [40, 20, 10], threshold=(100, 300), erosion=0.9 * below)


@pytest.mark.parametrize("option", ["erosion", "dilation"])
@pytest.mark.parametrize("radius", [-1, np.nan, np.inf])
def test_radii_that_are_no_lengths(image, option, radius):
    refused(lambda: separate(image, [18, 20, 10], **{option: radius}), option, "zero or a positive length")


def test_a_radius_that_is_no_length(image):
    refused(lambda: erode(image.array > 100, image.spacing, -2), "radius is -2 mm")


@pytest.mark.parametrize(("dtype", "level"), [(np.uint8, 77), (np.float32, 0)])
def test_a_constant_image(dtype, level):
    image = Image(np.full((10, 20, 20), level, dtype=dtype), np.eye(4))
    refused(lambda: threshold_between(find_edges(image, [10, 10, 5])), "No edge of an organ", "give the threshold")
    refused(lambda: separate(image, [10, 10, 5]), "No edge of an organ", f"grey level {level}")


def test_the_refusal_of_a_region_that_leaks_over_the_volume_names_a_threshold_that_works(image):
    seed = [18, 20, 10]
    with pytest.raises(ValueError, match=re.escape("fills most of the volume (100% of it)")) as refusal:
        separate(image, seed, threshold=(0, 300))
    found = re.search(r"With a threshold of ([\d.]+) to ([\d.]+) it is one piece of ([\d.]+) ml\.$", str(refusal.value))
    low, high, volume = map(float, found.groups())
    assert separate(image, seed, threshold=(low, high)).volume_ml == pytest.approx(volume, abs=0.05)


def test_the_refusal_of_a_region_that_touches_every_face_names_an_erosion_that_works():
    away = np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)
    levels = np.where(away < 12.0, 100.0, 0.0)
    for axis in range(3):
        bar = [slice(19, 22)] * 3
        bar[axis] = slice(None)
        levels[tuple(bar)] = 100.0
    image = Image(levels, np.eye(4))
    refused(
        lambda: separate(image, [20, 20, 20], threshold=(50, 150), erosion=1.0),
        "touches 6 of the six faces",
        "With an erosion of 2 mm it is one piece of 7.",
    )
    assert separate(image, [20, 20, 20], threshold=(50, 150), erosion=2.0).touches_border == ()


def test_a_region_that_touches_every_face():
    cross = np.zeros((21, 21, 21), dtype=np.uint8)
    cross[8:13, 8:13, :] = cross[8:13, :, 8:13] = cross[:, 8:13, 8:13] = 100
    image = Image(cross, np.eye(4))
    refused(lambda: separate(image, [10, 10, 10], threshold=(50, 150)), "touches 6 of the six faces", "Narrow")


def test_masks_that_are_no_segmentation_of_the_image(image):
    refused(lambda: region_from_mask(image, np.zeros(image.array.shape)), "mask is empty")
    refused(lambda: region_from_mask(image, np.ones((2, 3, 4))), "shape (2, 3, 4)", "one grid")


def test_a_region_without_voxels_has_no_moments():
    empty = Region(np.zeros((3, 3, 3), dtype=bool), (0, 0, 0), np.eye(4), None, ())
    refused(lambda: moments(empty), "region is empty")
