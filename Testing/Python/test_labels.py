"""Labels out of images, by value and by the name of a segment."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.labels import few_values, read_label
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.imaging.region import region_from_label

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
    with pytest.raises(
        ValueError, match=r"holds 0\.5; a label image holds whole numbers.* save the voxels above one half as a mask"
    ):
        read_label(written(tmp_path / "fractions.nrrd", 0.5 * blocks()))
    with pytest.raises(ValueError, match="There is no file or folder"):
        read_label(tmp_path / "missing.nrrd")
    with pytest.raises(ValueError, match="has 2 values per voxel"):
        read_label(written(tmp_path / "colour.nrrd", [blocks(), blocks()]))
    gone = {"Name": "gone", "LabelValue": "9", "Layer": "1"}
    path = written(tmp_path / "gone.seg.nrrd", [blocks(), 0 * blocks()], (*SEGMENTS, gone))
    with pytest.raises(ValueError, match=r"the segment 9 \(gone\) has no voxels"):
        read_label(path, "gone")
    path = written(tmp_path / "gone_too.seg.nrrd", blocks(), (*SEGMENTS, {**gone, "Layer": "0"}))
    with pytest.raises(ValueError, match=r"the segment 9 \(gone\) has no voxels"):
        read_label(path, "gone")


def test_labels_of_one_name_are_chosen_by_their_values(tmp_path):
    path = written(tmp_path / "twins.seg.nrrd", blocks(), [{**each, "Name": "organ"} for each in SEGMENTS])
    with pytest.raises(ValueError, match=r"holds 2 labels organ: 1 \(organ\), 4 \(organ\); choose one by its value"):
        read_label(path, "organ")
    assert read_label(path, 4)[1].value == 4


def test_labels_that_resampling_has_put_off_are_read(tmp_path):
    noise = np.random.default_rng(0).uniform(-9e-4, 9e-4, blocks().shape)
    path = written(tmp_path / "label.nrrd", (blocks() + noise).astype(np.float32))
    np.testing.assert_array_equal(read_label(path, 4)[0].array, blocks() == 4)
    with pytest.raises(ValueError, match="holds 4.002; a label image holds whole numbers"):
        read_label(written(tmp_path / "far.nrrd", (blocks() * 1.0005).astype(np.float32)))


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("extent", [False, True])
def test_segments_of_slicer_before_4_11_are_layers_of_ones(tmp_path, spatial, extent):
    """A list of layers with the space, or (Slicer 4.5) four axes of one space without a name; ones without a value."""
    bladder, rectum = (blocks() == 1).astype(np.uint8), (blocks() == 4).astype(np.uint8)
    rectum[3, 3, 3] = 1
    head = ["NRRD0005", "type: uint8", "dimension: 4", "encoding: raw"]
    if spatial:
        data = np.stack([bladder, rectum]).tobytes()
        head += [
            "space dimension: 4",
            "sizes: 10 9 8 2",
            "space directions: (1,0,0,0) (0,1.5,0,0) (0,0,2,0) (0,0,0,1)",
            "kinds: domain domain domain domain",
            "space origin: (7,8,9,0)",
        ]
    else:
        data = np.stack([bladder, rectum], axis=-1).tobytes()
        head += [
            "space: left-posterior-superior",
            "sizes: 2 10 9 8",
            "space directions: none (1,0,0) (0,1.5,0) (0,0,2)",
            "kinds: list domain domain domain",
            "space origin: (7,8,9)",
        ]
    head += ["Segmentation_MasterRepresentation:=Binary labelmap"]
    head += ["Segmentation_Extent:=0 9 0 8 0 7"] * extent
    for number, name in enumerate(("bladder", "rectum")):
        head += [f"Segment{number}_ID:=Segment_{number + 1}", f"Segment{number}_Name:={name}"]
        head += [f"Segment{number}_Extent:=0 9 0 8 0 7"]
    path = tmp_path / "old.seg.nrrd"
    path.write_bytes("\n".join([*head, "", ""]).encode() + data)
    for name, expected in (("bladder", bladder), ("Rectum", rectum)):
        mask, segment = read_label(path, name, warn=lambda note: None)
        np.testing.assert_array_equal(mask.array, expected == 1)
        np.testing.assert_allclose(mask.ijk_to_ras[:3], np.column_stack([np.diag([-1, -1.5, 2]), [-7, -8, 9]]))
        assert (segment.value, segment.name) == (1, name.lower())
    with pytest.raises(ValueError, match=r"holds 2 labels, 1 \(bladder\), 1 \(rectum\); choose one"):
        read_label(path)


def test_one_segment_of_slicer_before_4_11_has_its_name(tmp_path):
    one = {"ID": "Segment_1", "Name": "bladder"}
    path = written(tmp_path / "old.seg.nrrd", (blocks() == 1).astype(np.uint8), (one,))
    assert str(read_label(path, "bladder")[1]) == "1 (bladder)"


def test_an_image_of_few_values_looks_like_a_label_map():
    matrix = np.eye(4)
    assert few_values(Image(blocks(), matrix)) == 3
    assert few_values(Image(blocks().astype(np.float32), matrix)) == 3
    # A constant image is something else, and so are an MRI of 8 bits and a map of fractions.
    assert few_values(Image(0 * blocks(), matrix)) == 0
    grey = np.random.default_rng(0).integers(0, 256, (20, 20, 20)).astype(np.uint8)
    assert few_values(Image(grey, matrix)) == 0
    assert few_values(Image(blocks() / 8.0, matrix)) == 0


def test_a_region_from_a_label_on_another_grid_has_its_volume():
    k, j, i = np.indices((40, 40, 40))
    ball = (k - 20) ** 2 + (j - 20) ** 2 + (i - 20) ** 2 < 12**2
    turned = np.eye(4)
    turned[:3, :3] = 1.5 * np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    label = Image((7 * ball).astype(np.uint8), turned)
    matrix = np.diag([0.7, 0.7, 3.0, 1.0])
    matrix[:3, 3] = label.to_ras(np.array([[20.0, 20.0, 20.0]]))[0] - [30.0, 30.0, 30.0]
    image = Image(np.zeros((21, 87, 87)), matrix)
    region = region_from_label(image, label)
    assert region.volume_ml == pytest.approx(ball.sum() * 1.5**3 / 1000.0, rel=0.02)
    assert region.touches_border == ()


def test_a_label_on_the_same_grid_is_taken_as_it_is():
    mask = np.zeros((10, 12, 14), dtype=np.uint8)
    mask[2:6, 3:9, 4:12] = 1
    image = Image(np.zeros(mask.shape), np.diag([0.5, 0.5, 2.0, 1.0]))
    region = region_from_label(image, Image(mask, image.ijk_to_ras))
    np.testing.assert_array_equal(region.mask[tuple(slice(1, -1) for _ in range(3))], np.ones((4, 6, 8), dtype=bool))


def test_a_label_beside_the_image_is_refused():
    image = Image(np.zeros((10, 10, 10)), np.eye(4))
    far = np.eye(4)
    far[:3, 3] = 100.0
    with pytest.raises(ValueError, match="outside of the image"):
        region_from_label(image, Image(np.ones((5, 5, 5)), far))
    with pytest.raises(ValueError, match="empty"):
        region_from_label(image, Image(np.zeros((5, 5, 5)), np.eye(4)))
