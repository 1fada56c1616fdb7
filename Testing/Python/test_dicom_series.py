"""Series of DICOM slices are volumes by their positions, or refused with the cause."""

from __future__ import annotations

import numpy as np
import pytest

pydicom = pytest.importorskip("pydicom", minversion="3", reason="pydicom is not installed")

from dicom_files import (  # noqa: E402
    AXIAL,
    COLUMNS,
    CORONAL,
    LPS_TO_RAS,
    ROWS,
    SAGITTAL,
    image,
    pixels,
    positions,
    single,
    write_series,
)
from placed_levels import farthest  # noqa: E402

from VICRegistrationLib.imaging.reading import read_image  # noqa: E402

OBLIQUE = (0.8, 0.36, -0.48, 0.0, 0.8, 0.6)


def stack(places, orientation=AXIAL, **tags):
    return [single(place, orientation, **tags) for place in places]


def by_pydicom(folder):
    """Matrix from column, row and slice to RAS of a whole series, after part 3 of the standard, C.7.6.2.1.1."""
    found = [pydicom.dcmread(path) for path in folder.iterdir()]
    along, down = np.reshape(np.array(found[0].ImageOrientationPatient, dtype=float), (2, 3))
    found.sort(key=lambda each: np.dot(np.cross(along, down), each.ImagePositionPatient))
    first, last = (np.array(each.ImagePositionPatient, dtype=float) for each in (found[0], found[-1]))
    row, column = found[0].PixelSpacing
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([along * column, down * row, (last - first) / (len(found) - 1), first])
    return np.diag([*LPS_TO_RAS, 1.0]) @ matrix, np.array([each.pixel_array for each in found])


def refusal(path, **options):
    with pytest.raises(ValueError, match=r"\.$") as caught:
        read_image(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


# ------------------------------------------------------------------ what is a volume


@pytest.mark.parametrize("orientation", [AXIAL, SAGITTAL, CORONAL, OBLIQUE])
@pytest.mark.parametrize(
    ("order", "shear"),
    [(1, (0.0, 0.0)), (-1, (0.8, 0.0)), (1, (-0.8, 0.0)), (-1, (0.0, 0.8)), (1, (0.3, -0.8)), (-1, (0.0, 0.1))],
)
def test_a_stack_is_where_its_slices_are(tmp_path, orientation, order, shear):
    folder = write_series(tmp_path / "series", stack(positions(orientation, shear=shear)[::order], orientation))
    notes = []
    found = read_image(folder, warn=notes.append)
    assert farthest(found) < 0.05
    matrix, array = by_pydicom(folder)
    np.testing.assert_allclose(found.ijk_to_ras, matrix, atol=1e-5)
    np.testing.assert_array_equal(found.array, array)
    # A tilt is told; ITK straightens it, and so does highdicom up to 2.5 degrees.
    assert [("tilted gantry" in note) for note in notes] == [True] * (shear != (0.0, 0.0))


def test_rounded_positions_are_still_even(tmp_path):
    places = positions(count=40, step=3.25) + np.random.default_rng(0).uniform(-0.02, 0.02, (40, 3))
    found = read_image(write_series(tmp_path / "series", stack(places)))
    np.testing.assert_allclose(found.ijk_to_ras[:3, 2], [0.0, 0.0, 3.25], atol=2e-3)


def test_every_slice_has_its_own_slope(tmp_path):
    slopes = (1.0, 2.0, 0.5, 1.0, 4.0, 1.0)
    places = positions()
    images = [single(place, RescaleSlope=slope, RescaleIntercept=0) for place, slope in zip(places, slopes)]
    for each, place, slope in zip(images, places, slopes):
        each.PixelData = np.rint(pixels(place) / slope).astype("<i2").tobytes()
    # Grey levels are rounded by the slope of 4 to 2 levels.
    assert farthest(read_image(write_series(tmp_path / "series", images))) < 0.11


def test_grey_levels_of_two_scales_are_refused(tmp_path):
    places = positions()
    images = [single(place) for place in places]
    for each in images[::2]:
        each.PhotometricInterpretation = "MONOCHROME1"
    words = "differ in their PhotometricInterpretation (3 MONOCHROME1, 3 MONOCHROME2)"
    assert words in refusal(write_series(tmp_path / "mixed", images))
    # One of two volumes is of one scale.
    images = [single(place, EchoTime=80.0, PhotometricInterpretation="MONOCHROME1") for place in places]
    folder = write_series(tmp_path / "echoes", [*(single(place, EchoTime=20.0) for place in places), *images])
    assert farthest(read_image(folder, frame=1)) == 0.0


@pytest.mark.parametrize("slope", ["0", "1e999"])
def test_a_slope_that_is_none_is_refused_where_others_have_one(tmp_path, slope):
    places = positions()
    images = [single(place, RescaleSlope="2", RescaleIntercept="0") for place in places]
    images[2].RescaleSlope = slope
    words = f"has the RescaleSlope {slope}, and other slices another one"
    assert words in refusal(write_series(tmp_path / "series", images))
    images = [single(place, RescaleSlope="0", RescaleIntercept="0") for place in places]
    assert farthest(read_image(write_series(tmp_path / "all", images))) == 0.0


# ------------------------------------------------------------------ what is none


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (np.delete(positions(), 3, axis=0), "3.00 to 6.00 mm apart, so 1 slice may be missing"),
        (positions(count=9)[[0, 1, 3, 4, 6, 7, 8]], "3.00 to 6.00 mm apart, so 2 slices may be missing"),
        (positions(count=4)[[0, 1, 3]], "so 1 slice may be missing"),
        (np.delete(positions(shear=(0.8, 0.0)), 3, axis=0), "so 1 slice may be missing"),
        (positions() + np.outer(np.arange(6) > 2, [0, 0, 0.5]), "3.00 to 3.50 mm apart; even distances are needed"),
        # Two time points that are 0.05 mm apart: no 290 slices are missing.
        (np.vstack([positions(), positions() + [0, 0, 0.05]]), "0.05 to 2.95 mm apart; even distances are needed"),
        (positions(count=30) + np.outer(np.arange(30) > 14, [12, 0, 0]), "shifted sideways .* by up to 12.0 mm"),
        (positions(count=30) + np.outer(np.arange(30) > 14, [0, 0.4, 0]), "shifted sideways .* by up to 0.4 mm"),
        # Half of the gaps 2 % larger: the last slice would be 0.9 mm off.
        (positions(count=30) + np.outer(np.maximum(np.arange(30) - 15, 0), [0, 0, 0.06]), "even distances are needed"),
    ],
)
def test_uneven_stacks(tmp_path, places, words):
    folder = write_series(tmp_path / "series", stack(places))
    with pytest.raises(ValueError, match=words):
        read_image(folder)


@pytest.mark.parametrize("keyword", ["PixelSpacing", "ImagePositionPatient", "ImageOrientationPatient"])
@pytest.mark.parametrize("value", [None, ""])
@pytest.mark.parametrize("which", [slice(None), slice(2, 3)])
def test_what_is_missing_is_not_invented(tmp_path, keyword, value, which):
    images = stack(positions())
    for each in images[which]:
        if value is None:
            del each[keyword]
        else:
            setattr(each, keyword, value)
    message = refusal(write_series(tmp_path / "series", images))
    assert f"has no {keyword}, so that its place in the patient is not known" in message


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({"PixelSpacing": [0.0, 0.0]}, ["pixel spacing 0, 0 mm", "positive lengths"]),
        ({"PixelSpacing": [0.8, -0.6]}, ["pixel spacing 0.8, -0.6 mm", "positive lengths"]),
        ({"ImageOrientationPatient": [0.0] * 6}, ["directions 0, 0, 0, 0, 0, 0", "perpendicular"]),
        ({"ImageOrientationPatient": [1, 0, 0, 0.6, 0.8, 0]}, ["perpendicular directions of length 1"]),
        ({"ImageType": ["ORIGINAL", "PRIMARY", "M", "MOSAIC"]}, ["Siemens mosaic", "dcm2niix"]),
        ({"PhotometricInterpretation": "PALETTE COLOR"}, ["in colour"]),
    ],
)
def test_what_places_no_image(tmp_path, tags, words):
    message = refusal(write_series(tmp_path / "series", stack(positions(), **tags)))
    assert all(each in message for each in words), message


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (lambda place: single(place, spacing=(0.9, 0.6)), "pixel spacings from 0.8, 0.6 mm to 0.9, 0.6 mm"),
        (lambda place: single(place, FrameOfReferenceUID="1.2.7"), "2 different frames of reference"),
        (
            lambda place: image(
                np.zeros((8, 8)),
                ImagePositionPatient=list(place),
                ImageOrientationPatient=list(AXIAL),
                PixelSpacing=[0.8, 0.6],
            ),
            f"images of 8 x 8, {COLUMNS} x {ROWS} pixels",
        ),
    ],
)
def test_slices_that_do_not_belong_together(tmp_path, other, words):
    places = positions()
    images = [single(place) for place in places[:3]] + [other(place) for place in places[3:]]
    assert words in refusal(write_series(tmp_path / "series", images))


# ------------------------------------------------------------------ several volumes


def test_a_time_series_of_one_slice_is_no_volume(tmp_path):
    images = [single(positions()[0], TriggerTime=30.0 * number) for number in range(10)]
    message = refusal(write_series(tmp_path / "series", images))
    assert "holds 10 images that are all at one place" in message
    # There is no volume to choose.
    assert "--frame" not in message


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ([{"EchoTime": 10.0}, {"EchoTime": 80.0}], "(EchoTime: 10.0, 80.0)"),
        ([{"TemporalPositionIdentifier": number + 1} for number in range(3)], "(TemporalPositionIdentifier: 1, 2, 3)"),
        ([{"DiffusionBValue": value} for value in (0.0, 1000.0)], "(DiffusionBValue: 0, 1000)"),
        ([{"ImageType": ["DERIVED", "PRIMARY", kind]} for kind in "MP"], "(ImageType: DERIVED\\PRIMARY\\M, "),
        (
            [{"EchoTime": time, "ImageType": ["ORIGINAL", kind]} for time in (5.0, 9.0) for kind in "MP"],
            "(EchoTime and ImageType: 5.0 and ORIGINAL\\M, ",
        ),
    ],
)
def test_several_images_at_each_place_are_counted_and_chosen(tmp_path, tags, words):
    places = positions()
    images = [single(place, level=100 * number, **each) for place in places for number, each in enumerate(tags)]
    folder = write_series(tmp_path / "series", images)
    message = refusal(folder)
    assert f"holds {len(tags)} images at each of its 6 places {words}" in message
    assert f"--frame 1 to --frame {len(tags)}" in message
    for number in range(len(tags)):
        found = read_image(folder, frame=number + 1)
        assert found.array.shape == (6, ROWS, COLUMNS)
        assert farthest(type(found)(found.array - np.int16(100 * number), found.ijk_to_ras)) < 0.05
    assert f"but the DICOM series in {folder} holds {len(tags)} volumes" in refusal(folder, frame=len(tags) + 1)


@pytest.mark.parametrize("by_volume", [True, False])
def test_images_that_only_numbers_tell_apart_are_taken_in_their_order(tmp_path, by_volume):
    places = positions()
    images = []
    for time in range(4):
        for number, place in enumerate(places):
            instance = time * len(places) + number if by_volume else number * 4 + time
            images.append(single(place, level=100 * time, InstanceNumber=instance + 1))
    folder = write_series(tmp_path / "series", images)
    assert "4 images at each of its 6 places, distinguished by their numbers only" in refusal(folder)
    found = read_image(folder, frame=3)
    assert farthest(type(found)(found.array - np.int16(200), found.ijk_to_ras)) < 0.05


def test_a_slice_that_is_damaged_is_named(tmp_path):
    folder = write_series(tmp_path / "series", stack(positions()))
    (third,) = folder.glob("*_2")
    third.write_bytes(b"")
    message = refusal(folder)
    assert "so 1 slice may be missing" in message
    assert f"The folder also holds files that are damaged and were left out (1): {third.name}." in message


def test_folders_below_that_hold_slices_are_listed(tmp_path):
    for name in ("sagittal", "axial"):
        write_series(tmp_path / "study" / name, stack(positions()))
    (tmp_path / "study" / "readme.txt").write_text("two series")
    (tmp_path / "study" / "axial" / ".DS_Store").write_text("of macOS")
    below = tmp_path / "study"
    assert f"holds the slices themselves ({below / 'axial'}, {below / 'sagittal'}), or" in refusal(below)


def test_slices_of_no_series_are_reported(tmp_path):
    folder = write_series(tmp_path / "series", [single(place, series="") for place in positions()])
    message = refusal(folder)
    assert "holds no DICOM slices" in message
    assert "damaged and were left out (6): IM000_0 (no SeriesInstanceUID), " in message


def test_a_slice_that_is_missing_in_one_of_several_volumes(tmp_path):
    pairs = [(place, echo) for place in positions() for echo in (10.0, 80.0)]
    folder = write_series(tmp_path / "series", [single(place, EchoTime=echo) for place, echo in pairs[:7] + pairs[8:]])
    assert "holds up to 2 images at each of its 6 places (EchoTime: 10.0, 80.0)" in refusal(folder)
    read_image(folder, frame=1)
    message = refusal(folder, frame=2)
    assert message.startswith("Frame 2 of the DICOM series in ")
    assert "so 1 slice may be missing" in message


def test_a_slice_that_is_there_twice(tmp_path):
    images = stack(positions())
    folder = write_series(tmp_path / "series", [*images, single(positions()[2])])
    message = refusal(folder)
    assert "holds 7 images at 6 places" in message
    assert message.count(str(folder)) == 3


def test_orientations_in_one_series_are_chosen_by_their_size(tmp_path):
    images = stack(positions(), AXIAL) + stack(positions(SAGITTAL, count=1), SAGITTAL)
    folder = write_series(tmp_path / "series", images)
    assert "2 orientations (a localizer?): 6 axial, 1 sagittal" in refusal(folder)
    assert farthest(read_image(folder, frame=1)) < 0.05
    assert "holds a single slice" in refusal(folder, frame=2)
    more = write_series(tmp_path / "series", stack(positions(CORONAL, count=4), CORONAL))
    assert farthest(read_image(more, frame=2)) < 0.05


def test_planes_about_an_axis_are_no_volume(tmp_path):
    turns = [(np.cos(angle), np.sin(angle), 0.0, 0.0, 0.0, -1.0) for angle in np.pi * np.arange(9) / 9.0]
    folder = write_series(tmp_path / "series", [single((0.0, 0.0, 0.0), turn) for turn in turns])
    assert "holds 9 images, each of another orientation (planes about an axis?)" in refusal(folder)
    write_series(tmp_path / "series", [single((0.0, 1.0, 0.0), turn) for turn in turns])
    assert "images of 9 orientations (a localizer?): 2 coronal, " in refusal(folder)
    assert " and 3 more; one volume is needed" in refusal(folder)


def test_a_localizer_of_another_size_is_left_out(tmp_path):
    wide = image(
        np.zeros((8, 8)),
        ImagePositionPatient=[0, 0, 0],
        ImageOrientationPatient=list(SAGITTAL),
        PixelSpacing=[2.0, 2.0],
    )
    folder = write_series(tmp_path / "series", [*stack(positions(), AXIAL), wide])
    assert "2 orientations (a localizer?): 6 axial, 1 sagittal" in refusal(folder)
    assert farthest(read_image(folder, frame=1)) < 0.05


def test_a_single_file_is_refused(tmp_path):
    folder = write_series(tmp_path / "series", stack(positions()))
    assert "holds a single slice; a surface needs several slices, so give the folder" in refusal(folder / "IM000_0")
    folder = write_series(tmp_path / "mosaic", stack(positions(), ImageType=["ORIGINAL", "PRIMARY", "MOSAIC"]))
    assert "is a Siemens mosaic" in refusal(folder / "IM000_0")


def test_a_series_is_chosen_by_its_number(tmp_path):
    folder = write_series(tmp_path / "study", stack(positions(), SeriesNumber=3))
    write_series(folder, stack(positions(count=4), series="1.2.3.5", SeriesNumber=5))
    assert "1.2.3.4 'T2', number 3, 6 files; 1.2.3.5 'T2', number 5, 4 files" in refusal(folder)
    assert read_image(folder, series="5").array.shape[0] == 4
