"""Labels out of images, by value and by the name of a segment."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.labels import read_label
from VICRegistrationLib.imaging.reading import write_image

SEGMENTS = ({"Name": "Bladder", "LabelValue": "1", "Layer": "0"}, {"Name": "rectum", "LabelValue": "4", "Layer": "0"})


def blocks():
    """Two blocks with the values 1 and 4."""
    array = np.zeros((8, 9, 10), dtype=np.uint8)
    array[2:5, 2:5, 2:5], array[5:7, 5:8, 5:9] = 1, 4
    return array


def written(path, array, segments=(), *, spacing=(1.0, 1.5, 2.0)):
    """Write an image with segments in its header in Slicer's manner; several arrays are layers."""
    arrays = array if isinstance(array, (list, tuple)) else [array]
    layers = [sitk.GetImageFromArray(each) for each in arrays]
    volume = layers[0] if len(layers) == 1 else sitk.Compose(layers)
    volume.SetSpacing(spacing)
    for number, segment in enumerate(segments):
        for key, text in segment.items():
            volume.SetMetaData(f"Segment{number}_{key}", text)
    sitk.WriteImage(volume, str(path))
    return path


def test_a_label_is_chosen_by_its_value(tmp_path):
    path = tmp_path / "label.nii.gz"
    write_image(Image(blocks(), np.diag([-1.0, 1.5, 2.0, 1.0])), path)
    mask, segment = read_label(path, 4)
    np.testing.assert_array_equal(mask.array, blocks() == 4)
    np.testing.assert_allclose(mask.ijk_to_ras, np.diag([-1.0, 1.5, 2.0, 1.0]), atol=1e-6)
    assert (segment.value, segment.name, str(segment)) == (4, "", "4")


def test_the_only_label_needs_no_choice(tmp_path):
    path = written(tmp_path / "label.nrrd", np.where(blocks() == 4, 7.0, 0.0))
    assert read_label(path)[1].value == 7


def test_a_segment_is_chosen_by_its_name(tmp_path):
    path = written(tmp_path / "organs.seg.nrrd", blocks(), SEGMENTS)
    for label, organ, value in (("rectum", "", 4), ("bladder", "", 1), (None, "bladder", 1), ("4", "bladder", 4)):
        mask, segment = read_label(path, label, organ=organ)
        assert segment.value == value
        np.testing.assert_array_equal(mask.array, blocks() == value)
    assert str(segment) == "4 (rectum)"


@pytest.mark.parametrize("kind", ["vector", "list"])
def test_overlapping_segments_are_taken_from_their_layers(tmp_path, kind):
    other = np.zeros_like(blocks())
    other[3:6, 3:6, 3:6] = 1
    third = {"Name": "lesion", "LabelValue": "1", "Layer": "1"}
    path = written(tmp_path / "organs.seg.nrrd", [blocks(), other], (*SEGMENTS, third))
    # What Slicer calls the axis of the layers.
    path.write_bytes(path.read_bytes().replace(b"kinds: vector", b"kinds: " + kind.encode()))
    np.testing.assert_array_equal(read_label(path, "lesion")[0].array, other == 1)
    np.testing.assert_array_equal(read_label(path, "Bladder")[0].array, blocks() == 1)
    with pytest.raises(ValueError, match=r"holds 2 labels 1: 1 \(Bladder\), 1 \(lesion\); choose one by its name"):
        read_label(path, 1)


def test_what_is_not_clear_is_listed(tmp_path):
    path = written(tmp_path / "organs.seg.nrrd", blocks(), SEGMENTS)
    with pytest.raises(ValueError, match=r"holds 2 labels, 1 \(Bladder\), 4 \(rectum\); choose one"):
        read_label(path, organ="uterus")
    with pytest.raises(ValueError, match=r"holds no label 3, but 1 \(Bladder\), 4 \(rectum\); choose one of these"):
        read_label(path, 3)
    many = np.arange(1000, dtype=np.int16).reshape(10, 10, 10)
    with pytest.raises(ValueError, match="holds 999 different values; give a segmentation, not the image"):
        read_label(written(tmp_path / "mri.nrrd", many))


def test_what_is_no_label_image_is_refused(tmp_path):
    with pytest.raises(ValueError, match="holds no label: all of its voxels are 0"):
        read_label(written(tmp_path / "empty.nrrd", 0 * blocks()))
    with pytest.raises(ValueError, match=r"holds 0\.5; a label image holds whole numbers"):
        read_label(written(tmp_path / "fractions.nrrd", 0.5 * blocks()))
    with pytest.raises(ValueError, match="There is no file or folder"):
        read_label(tmp_path / "missing.nrrd")
    with pytest.raises(ValueError, match="has 2 values per voxel"):
        read_label(written(tmp_path / "colour.nrrd", [blocks(), blocks()]))
    gone = {"Name": "gone", "LabelValue": "9", "Layer": "1"}
    path = written(tmp_path / "gone.seg.nrrd", [blocks(), 0 * blocks()], (*SEGMENTS, gone))
    with pytest.raises(ValueError, match=r"the segment 9 \(gone\) has no voxels"):
        read_label(path, "gone")
