"""Segments of DICOM segmentations: by number or name, every voxel at its place, empty slices and overlaps."""

from __future__ import annotations

import numpy as np
import pytest

highdicom = pytest.importorskip("highdicom", reason="highdicom is not installed")

from dicom_files import AXIAL, COLUMNS, LPS_TO_RAS, ROWS, SAGITTAL, positions, single, write_series  # noqa: E402
from pydicom.sr.codedict import codes  # noqa: E402
from pydicom.uid import (  # noqa: E402
    ExplicitVRLittleEndian,
    JPEGLSLossless,
    RLELossless,
    generate_uid,
)

from VICRegistrationLib.analysis.references import read_reference  # noqa: E402
from VICRegistrationLib.cli.references import reference_paths  # noqa: E402
from VICRegistrationLib.geometry.triangles import enclosed_volume  # noqa: E402
from VICRegistrationLib.imaging.labels import read_label  # noqa: E402
from VICRegistrationLib.imaging.reading import read_image  # noqa: E402

COUNT = 10
# What highdicom asks of the images that are segmented.
_REQUIRED = dict.fromkeys(
    (
        "PatientBirthDate",
        "PatientSex",
        "AccessionNumber",
        "StudyID",
        "StudyDate",
        "StudyTime",
        "ReferringPhysicianName",
    ),
    "",
)


def source(orientation=AXIAL, shear=(0.0, 0.0)):
    places = positions(orientation, count=COUNT, shear=shear)
    return [
        single(
            place, orientation, InstanceNumber=1, PatientName="A^B", Manufacturer="x", SliceThickness=3.0, **_REQUIRED
        )
        for place in places
    ]


def masks():
    """Two blocks that overlap; neither is in all slices."""
    bladder, tumour = np.zeros((2, COUNT, ROWS, COLUMNS), dtype=np.uint8)
    bladder[2:7, 2:9, 2:8] = 1
    tumour[5:9, 4:10, 3:7] = 1
    return bladder, tumour


def segmentation(path, array, *, kind="BINARY", labels=("Bladder", "tumour"), images=None, **options):
    """Write a segmentation with highdicom."""
    descriptions = [
        highdicom.seg.SegmentDescription(
            segment_number=number + 1,
            segment_label=label,
            segmented_property_category=codes.SCT.Organ,
            segmented_property_type=codes.SCT.Bladder,
            algorithm_type="MANUAL",
        )
        for number, label in enumerate(labels)
    ]
    data = highdicom.seg.Segmentation(
        source_images=source() if images is None else images,
        pixel_array=array,
        segmentation_type=kind,
        segment_descriptions=descriptions,
        series_instance_uid=generate_uid(),
        series_number=9,
        sop_instance_uid=generate_uid(),
        instance_number=1,
        manufacturer="x",
        manufacturer_model_name="y",
        software_versions="1",
        device_serial_number="1",
        **options,
    )
    data.save_as(path)
    return path


def places_of(mask, images):
    """Centres of a mask's voxels, RAS mm, by the headers of the slices it was drawn in."""
    found = []
    for number, row, column in np.argwhere(mask):
        each = images[number]
        along, down = np.reshape(np.array(each.ImageOrientationPatient, dtype=float), (2, 3))
        rows, columns = each.PixelSpacing
        lps = np.array(each.ImagePositionPatient, dtype=float) + column * columns * along + row * rows * down
        found.append(lps * LPS_TO_RAS)
    return np.array(found)


def assert_placed(path, label, mask, images):
    found, segment = read_label(path, label)
    k, j, i = np.nonzero(found.array)
    ras = found.to_ras(np.stack([i, j, k], axis=-1))
    expected = places_of(mask, images)
    order, other = (np.lexsort(np.round(each, 2).T) for each in (ras, expected))
    np.testing.assert_allclose(ras[order], expected[other], atol=2e-3)
    # The volume of a voxel is right too: the distance of the slices.
    assert found.voxel_volume == pytest.approx(0.8 * 0.6 * 3.0, rel=1e-4)
    return segment


@pytest.mark.parametrize("orientation", [AXIAL, SAGITTAL])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("omit", [True, False])
def test_overlapping_segments_are_taken_by_number_and_name(tmp_path, orientation, order, omit):
    images = source(orientation)[::order]
    bladder, tumour = masks()
    both = np.stack([bladder, tumour], axis=-1)
    path = segmentation(tmp_path / "seg.dcm", both, images=images, omit_empty_frames=omit)
    for label, mask, told in (
        ("bladder", bladder, "1 (Bladder)"),
        ("TUMOUR", tumour, "2 (tumour)"),
        (2, tumour, "2 (tumour)"),
    ):
        assert str(assert_placed(path, label, mask, images)) == told


@pytest.mark.parametrize("kind", ["FRACTIONAL", "LABELMAP"])
@pytest.mark.parametrize("syntax", [ExplicitVRLittleEndian, RLELossless, JPEGLSLossless])
def test_all_kinds_and_compressions(tmp_path, kind, syntax):
    bladder, tumour = masks()
    tumour = tumour * (1 - bladder)
    array = 0.7 * np.stack([bladder, tumour], axis=-1) if kind == "FRACTIONAL" else bladder + 2 * tumour
    path = segmentation(tmp_path / "seg.dcm", array, kind=kind, transfer_syntax_uid=syntax)
    assert_placed(path, "bladder", bladder, source())
    assert_placed(path, "tumour", tumour, source())


def test_a_segment_with_slices_left_out_between_its_own(tmp_path):
    mask = np.zeros_like(masks()[0])
    mask[[2, 7], 3:8, 3:8] = 1
    path = segmentation(tmp_path / "seg.dcm", mask, labels=("organ",))
    assert_placed(path, None, mask, source())
    # Nothing tells that there are slices between them.
    data = highdicom.seg.segread(path)
    del data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices
    data.save_as(path)
    with pytest.raises(ValueError, match="does not give the distance of its slices"):
        read_label(path)


def test_a_reference_is_the_surface_around_a_segment(tmp_path):
    bladder, tumour = masks()
    path = segmentation(tmp_path / "seg.dcm", np.stack([bladder, tumour], axis=-1))
    read = read_reference(path, organ="bladder")
    assert (read.kind, read.label) == ("label image", "1 (Bladder)")
    # Flying edges cut the corners of the block.
    volume = bladder.sum() * 0.8 * 0.6 * 3.0
    assert enclosed_volume(read.reference.points, read.reference.triangles) == pytest.approx(volume, rel=0.05)
    middle = places_of(bladder, source()).mean(axis=0)
    np.testing.assert_allclose(
        read.reference.points.min(axis=0) / 2 + read.reference.points.max(axis=0) / 2, middle, atol=0.01
    )


def test_what_is_not_clear_or_not_there_is_listed(tmp_path):
    bladder, _ = masks()
    path = segmentation(tmp_path / "seg.dcm", np.stack([bladder, 0 * bladder], axis=-1))
    with pytest.raises(ValueError, match=r"holds 2 labels, 1 \(Bladder\), 2 \(tumour\); choose one with --label"):
        read_label(path)
    with pytest.raises(ValueError, match=r"holds no label uterus, but 1 \(Bladder\), 2 \(tumour\)"):
        read_label(path, "uterus")
    with pytest.raises(ValueError, match=r"the segment 2 \(tumour\) has no voxels"):
        read_label(path, "tumour")


@pytest.mark.parametrize("shift", [0.1, 0.8])
def test_frames_that_highdicom_would_straighten_are_refused(tmp_path, shift):
    """It takes stacks that are tilted by up to 2.5 degrees as upright: 1 mm off in ten slices here."""
    bladder, tumour = masks()
    images = source(shear=(0.0, shift))
    path = segmentation(tmp_path / "seg.dcm", np.stack([bladder, tumour], axis=-1), images=images)
    with pytest.raises(ValueError, match="The frames of .* (are shifted|are not in even steps)"):
        read_label(path, "bladder")


def test_a_folder_with_one_segmentation_is_a_reference(tmp_path):
    folder = write_series(tmp_path / "study", source())
    path = segmentation(folder / "seg.dcm", masks()[0], labels=("organ",))
    assert reference_paths(str(folder), ["bladder", "rectum"]) == {"bladder": path, "rectum": path}
    np.testing.assert_array_equal(read_label(folder)[0].array, read_label(path)[0].array)
    (folder / "again.dcm").write_bytes(path.read_bytes())
    for read in (read_label, lambda where: reference_paths(str(where), ["bladder"])):
        with pytest.raises(ValueError, match=r"holds 2 DICOM segmentations \(again.dcm, seg.dcm\); give the file"):
            read(folder)
    # Files that are named like the organs need none of them.
    (folder / "bladder.nii.gz").touch()
    assert reference_paths(str(folder), ["bladder"]) == {"bladder": folder / "bladder.nii.gz"}


def test_a_segmentation_is_no_image(tmp_path):
    path = segmentation(tmp_path / "seg.dcm", masks()[0], labels=("organ",))
    with pytest.raises(ValueError, match="is a DICOM segmentation, not an image"):
        read_image(path)
    # Beside its series, as archives export both.
    folder = write_series(tmp_path / "study", source())
    path.rename(folder / "seg.dcm")
    assert read_image(folder).array.shape == (COUNT, ROWS, COLUMNS)
