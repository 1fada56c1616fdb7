"""Enhanced DICOM files: frames at their places, alone or in a folder, with their own slopes; or refused."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

pytest.importorskip("highdicom", reason="highdicom is not installed")

from dicom_files import AXIAL, MR, SAGITTAL, image, item, multiframe, pixels, positions, save, write_series  # noqa: E402
from placed_levels import farthest  # noqa: E402

from VICRegistrationLib.imaging.image import Image  # noqa: E402
from VICRegistrationLib.imaging.reading import read_image  # noqa: E402


def refusal(path, **options):
    with pytest.raises(ValueError, match=r"\.$") as caught:
        read_image(path, **options)
    return str(caught.value)


@pytest.mark.parametrize(("orientation", "shared"), [(AXIAL, True), (SAGITTAL, False)])
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), [3, 0, 5, 1, 4, 2]])
@pytest.mark.parametrize("shear", [(0.0, 0.0), (0.8, 0.0), (0.1, -0.5)])
def test_frames_are_where_they_say(tmp_path, orientation, order, shared, shear):
    places = positions(orientation, shear=shear)
    data = multiframe(places[order], orientation, shared=shared)
    notes = []
    alone = read_image(save(data, tmp_path / "one.dcm"), warn=notes.append)
    assert alone.array.shape == (6, 12, 10)
    assert farthest(alone) == 0.0
    assert ["tilted gantry" in note for note in notes] == [True] * (shear != (0.0, 0.0))
    # In a folder, as archives export it.
    within = read_image(write_series(tmp_path / "folder", [data]), warn=notes.append)
    np.testing.assert_array_equal(within.array, alone.array)
    np.testing.assert_allclose(within.ijk_to_ras, alone.ijk_to_ras)


def test_every_frame_has_its_own_slope(tmp_path):
    slopes = (1.0, 2.0, 0.5, 1.0, 4.0, 1.0)
    places = positions()
    groups = [{"PixelValueTransformationSequence": item(RescaleSlope=slope, RescaleIntercept=0.0)} for slope in slopes]
    arrays = [np.rint(pixels(place) / slope) for place, slope in zip(places, slopes)]
    path = save(multiframe(places, groups=groups, arrays=arrays), tmp_path / "one.dcm")
    # Grey levels are rounded by the slope of 4 to 2 levels.
    assert farthest(read_image(path)) < 0.11


def test_frames_of_several_files_are_one_series(tmp_path):
    places = positions()
    folder = write_series(tmp_path / "folder", [multiframe(places[:4]), multiframe(places[4:])])
    found = read_image(folder)
    assert found.array.shape == (6, 12, 10)
    assert farthest(found) == 0.0


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (np.delete(positions(), 2, axis=0), "3.00 to 6.00 mm apart, so 1 slice may be missing"),
        (positions() + np.outer(np.arange(6) > 2, [5, 0, 0]), "shifted sideways"),
        (positions()[:1], "holds a single slice"),
        (np.repeat(positions()[:1], 5, axis=0), "holds 5 images that are all at one place"),
    ],
)
def test_frames_that_are_no_volume(tmp_path, places, words):
    path = save(multiframe(places), tmp_path / "one.dcm")
    assert words in refusal(path)


def content(**values):
    return {"FrameContentSequence": item(**values)}


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ([content(TemporalPositionIndex=time) for time in (1, 2)], "(TemporalPositionIndex: 1, 2)"),
        (
            [{"MRDiffusionSequence": item(DiffusionBValue=b)} for b in (0.0, 500.0, 1000.0)],
            "(DiffusionBValue: 0.0, 500",
        ),
        (
            [{"MREchoSequence": item(EffectiveEchoTime=echo)} for echo in (80.0, 10.0)],
            "(EffectiveEchoTime: 10.0, 80.0)",
        ),
        ([content(DimensionIndexValues=[1, time]) for time in (1, 2)], "(dimension 2 index: 1, 2)"),
        ([{}, {}], "distinguished by their numbers only"),
    ],
)
@pytest.mark.parametrize("by_volume", [True, False])
def test_several_frames_at_each_place_are_counted_and_chosen(tmp_path, groups, words, by_volume):
    places = positions()
    pairs = [(place, number) for place in range(6) for number in range(len(groups))]
    if by_volume:
        pairs.sort(key=lambda pair: pair[1])
    data = multiframe(
        [places[place] for place, _ in pairs],
        groups=[groups[number] for _, number in pairs],
        levels=[100 * number for _, number in pairs],
    )
    path = save(data, tmp_path / "one.dcm")
    message = refusal(path)
    assert f"holds {len(groups)} images at each of its 6 places" in message
    assert words in message
    levels = []
    for frame in range(1, len(groups) + 1):
        found = read_image(path, frame=frame)
        off = round((found.array[0, 0, 0] - pixels(places[0])[0, 0]) / 100)
        levels.append(off)
        assert farthest(Image(found.array - np.float32(100 * off), found.ijk_to_ras)) == 0.0
    # Echoes are in the order of their times.
    assert levels == ([1, 0] if "Echo" in words else list(range(len(groups))))


@pytest.mark.parametrize(
    ("sequence", "keyword"),
    [
        ("PlanePositionSequence", "ImagePositionPatient"),
        ("PlaneOrientationSequence", "ImageOrientationPatient"),
        ("PixelMeasuresSequence", "PixelSpacing"),
    ],
)
def test_what_is_missing_is_not_invented(tmp_path, sequence, keyword):
    data = multiframe(positions(), shared=False)
    del data.PerFrameFunctionalGroupsSequence[2][sequence]
    path = save(data, tmp_path / "one.dcm")
    assert f"Frame 3 of {path} has no {keyword}, so that its place in the patient is not known" in refusal(path)


def test_frames_that_have_no_place_are_not_left_out(tmp_path):
    data = multiframe(positions())
    del data.PerFrameFunctionalGroupsSequence[4:]
    assert "holds 6 frames, but a place for 4 of them only" in refusal(save(data, tmp_path / "one.dcm"))


def test_frames_without_places_are_refused(tmp_path):
    stack = np.zeros((6, 12, 10))
    path = save(image(stack, sop=MR, NumberOfFrames=6, PixelSpacing=[1, 1]), tmp_path / "one.dcm")
    assert "holds 6 frames without a place for each of them" in refusal(path)


def test_a_file_that_is_no_image(tmp_path):
    data = image(np.zeros((2, 2)), sop="1.2.840.10008.5.1.4.1.1.481.3")
    for keyword in ("PixelData", "Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation"):
        delattr(data, keyword)
    path = save(data, tmp_path / "structures.dcm")
    assert "is a DICOM file without an image (RT Structure Set Storage)" in refusal(path)


def test_damaged_files_in_a_folder_are_told(tmp_path):
    folder = write_series(tmp_path / "folder", [multiframe(positions())])
    (folder / "notes.txt").write_text("nothing")
    (folder / "cut").write_bytes((folder / "IM000_0").read_bytes()[:150])
    (folder / "empty").write_bytes(b"")
    with pytest.warns(UserWarning, match=r"files that are damaged and were left out \(2\): cut, empty"):
        assert farthest(read_image(folder)) == 0.0


def test_a_damaged_file_is_refused(tmp_path):
    path = save(multiframe(positions()), tmp_path / "one.dcm")
    # The kind of an ImagePositionPatient.
    path.write_bytes(path.read_bytes().replace(b"\x20\x00\x32\x00DS", b"\x20\x00\x32\x00ZZ", 1))
    assert f"{path} is damaged (Unknown Value Representation" in refusal(path)


def test_without_highdicom_it_says_what_to_install(tmp_path, monkeypatch):
    path = save(multiframe(positions()), tmp_path / "one.dcm")
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "highdicom" else find(name))
    assert "needs the package highdicom (Python 3.10 or newer); install it with: pip install highdicom" in refusal(path)


def test_a_compression_that_cannot_be_decoded_is_told(tmp_path):
    from pydicom.encaps import encapsulate
    from pydicom.uid import JPEGLosslessSV1

    data = multiframe(positions())
    data.file_meta.TransferSyntaxUID = JPEGLosslessSV1
    data.PixelData = encapsulate([b"\xff\xd8 no picture \xff\xd9"] * 6)
    data["PixelData"].VR = "OB"
    message = refusal(save(data, tmp_path / "one.dcm"))
    assert "cannot be decoded" in message
    assert "gdcmconv" in message
