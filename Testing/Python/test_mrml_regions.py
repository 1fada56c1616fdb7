"""The region in its segment, as the preview shows it."""

from __future__ import annotations

import itertools

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion, reordered
from small_phantom import CENTER

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.segmentation import separation

pytestmark = pytest.mark.usefixtures("cached_fits")


@pytest.fixture
def separated(slicer_module):
    """Separate an organ as the panel's preview does."""
    from VICRegistrationLib.mrml.separating import separateOrgan

    return separateOrgan


ORDERS = list(itertools.product(itertools.permutations(range(3)), [(False,) * 3, (True, False, False), (True,) * 3]))


@pytest.mark.parametrize(("order", "flips"), ORDERS[1::4])
def test_the_segment_shows_the_voxels_of_the_region_on_every_grid(logic, separated, order, flips):
    matrix = motion(40, (1, 2, -1), (10, -5, 3))
    image = mrml_scenes.oblique(reordered(mrml_scenes.mri(), order, flips), matrix)
    volume = mrml_scenes.add_volume(image)
    organ = logic.addOrgan(volume, CENTER @ matrix[:3, :3].T + matrix[:3, 3], (600, 1000), erosion=2.0)
    region, _warnings = separated(organ, volume)
    found = mrml_scenes.segment_voxels(organ, volume)
    np.testing.assert_array_equal(found, region.in_box((0, 0, 0), image.array.shape))
    assert 4000 < found.sum() < 7000


@pytest.mark.parametrize("kind", ["none", "linear", "nonlinear"])
def test_the_segment_lies_on_the_grid_of_the_volume_whatever_its_transform(logic, kind):
    under, seed = None, CENTER
    if kind == "linear":
        matrix = motion(75, (1, 2, -1), (30, -60, 12))
        under, seed = mrml_scenes.add_linear_transform(matrix), matrix[:3, :3] @ CENTER + matrix[:3, 3]
    elif kind == "nonlinear":
        spline = mrml_scenes.thin_plate_spline()
        under, seed = mrml_scenes.add_nonlinear_transform(spline), spline.TransformPoint(CENTER)
    volume = mrml_scenes.add_volume(under=under)
    organ = logic.addOrgan(volume, seed)
    expected = separation.separate(mrml_scenes.mri(), CENTER)
    np.testing.assert_array_equal(
        mrml_scenes.segment_voxels(organ, volume), expected.in_box((0, 0, 0), mrml_scenes.mri().array.shape)
    )
    # The segment editor paints on the reference geometry: the voxels of the volume, as seen from the segmentation.
    name = slicer.vtkSegmentationConverter.GetReferenceImageGeometryParameterName()
    geometry = slicer.vtkOrientedImageData()
    text = organ.regions.GetSegmentation().GetConversionParameter(name)
    slicer.vtkSegmentationConverter.DeserializeImageGeometry(text, geometry, False)
    toWorld = slicer.util.vtkMatrixFromArray(np.eye(4))
    geometry.GetImageToWorldMatrix(toWorld)
    np.testing.assert_allclose(slicer.util.arrayFromVTKMatrix(toWorld), mrml_scenes.mri().ijk_to_ras, atol=1e-9)


def test_a_changed_threshold_changes_the_segment_in_place(logic, separated):
    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER])
    before, content = mrml_scenes.segment_voxels(organ, volume), mrml_scenes.content(slicer.mrmlScene)

    for thresholds in ((300, 1000), (780, 1000), (300, 1000), (700, 900)):
        organ.setSeparation(threshold=thresholds)
        region, _warnings = separated(organ, volume)
        found = mrml_scenes.segment_voxels(organ, volume)
        np.testing.assert_array_equal(found, region.in_box((0, 0, 0), found.shape))
        assert organ.volumeMl == pytest.approx(region.volume_ml)
    assert not np.array_equal(found, before)
    assert mrml_scenes.content(slicer.mrmlScene) == content


def two_organs():
    """The small phantom with a second organ of other grey levels beside it."""
    image = mrml_scenes.mri()
    array = image.array.copy()
    array[5:17, 14:42, 40:52] = 1500
    return Image(array, image.ijk_to_ras), image.to_ras([[45.0, 28.0, 11.0]])[0]


def test_overlapping_organs_keep_apart(logic, separated):
    image, other = two_organs()
    volume = mrml_scenes.add_volume(image)
    first = logic.addOrgan(volume, [CENTER], (600, 2000), name="both", erosion=0.0)
    alone = mrml_scenes.segment_voxels(first, volume)
    second = logic.addOrgan(volume, [other], (1400, 1600), name="one", erosion=0.0)
    third = logic.addOrgan(volume, [CENTER], (600, 1000), name="overlapping", erosion=0.0)
    assert len({organ.regionSegmentId for organ in (first, second, third)}) == 3
    assert first.regions is second.regions is third.regions
    overlap = mrml_scenes.segment_voxels(first, volume) & mrml_scenes.segment_voxels(third, volume)
    assert overlap.any()
    for organ in (second, first, third, second):
        region, _warnings = separated(organ, volume)
        expected = region.in_box((0, 0, 0), image.array.shape)
        np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, volume), expected)
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(first, volume), alone)


def test_a_failed_separation_empties_the_segment_and_only_that(logic, separated):
    volume = mrml_scenes.add_volume()
    organ, other = (logic.addOrgan(volume, [CENTER], name=name) for name in ("a", "b"))
    kept = mrml_scenes.segment_voxels(other, volume)
    organ.seeds.SetNthControlPointPositionWorld(0, 500, 0, 0)
    with pytest.raises(ValueError, match="outside the volume"):
        separated(organ, volume)
    assert not mrml_scenes.segment_voxels(organ, volume).any()
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(other, volume), kept)
    organ.seeds.SetNthControlPointPositionWorld(0, *CENTER)
    separated(organ, volume)
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, volume), kept)


def test_thresholds_and_erosion_are_suggested(logic):
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER])
    expected = separation.separate(mrml_scenes.mri(), CENTER)
    assert (organ.threshold.minimum, organ.threshold.maximum) == expected.threshold
    assert organ.erosionMm == expected.erosion
    assert organ.thresholdAutomatic
    assert organ.erosionAutomatic


def test_a_suggested_threshold_follows_the_seed(logic, separated):
    image, other = two_organs()
    volume = mrml_scenes.add_volume(image)
    organ = logic.addOrgan(volume, [CENTER])
    organ.seeds.SetNthControlPointPositionWorld(0, *other)
    separated(organ, volume)
    assert organ.threshold.minimum <= 1500 <= organ.threshold.maximum
    assert organ.threshold.minimum > 800


def test_given_thresholds_and_erosion_are_kept(logic, separated):
    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER], (650.5, 1000), erosion=1.5)
    for _again in range(2):
        separated(organ, volume)
        assert (organ.threshold.minimum, organ.threshold.maximum) == (650.5, 1000)
        assert organ.erosionMm == 1.5
        assert not organ.thresholdAutomatic
        assert not organ.erosionAutomatic


def test_warnings_tell_of_the_border_and_of_seeds_outside_of_a_segment(logic, separated):
    image = mrml_scenes.mri()
    volume = mrml_scenes.add_volume(image.crop((0, 0, 0), (13, 56, 52)))
    organ = logic.addOrgan(volume, [CENTER])
    _region, warnings = separated(organ, volume)
    assert any("border of the image (right)" in warning for warning in warnings)
    organ.seeds.AddControlPointWorld(*(CENTER + [0, 28, 0]))
    organ.inputSegmentation, organ.inputSegmentId = organ.regions, organ.regionSegmentId
    organ.source = type(organ.source).SEGMENT
    _region, warnings = separated(organ, volume)
    assert any("Not all seeds lie in the segment" in warning for warning in warnings)


def test_points_that_are_being_placed_do_not_count(logic, separated):
    volume = mrml_scenes.add_volume()
    organ = logic.addOrgan(volume, [CENTER])
    expected = mrml_scenes.segment_voxels(organ, volume)
    index = organ.seeds.AddControlPointWorld(900, 900, 900)
    organ.seeds.SetNthControlPointPositionMissing(index)
    separated(organ, volume)
    np.testing.assert_array_equal(mrml_scenes.segment_voxels(organ, volume), expected)


def test_an_organ_that_is_separated_in_another_volume_moves_there(logic, separated):
    first, second = mrml_scenes.add_volume(name="first"), mrml_scenes.add_volume(name="second")
    organ, other = (logic.addOrgan(first, [CENTER], name=name) for name in ("a", "b"))
    old, oldId = organ.regions, organ.regionSegmentId
    separated(organ, second)
    assert organ.regions is not old
    assert mrml_scenes.segment_voxels(organ, second).any()
    assert old.GetSegmentation().GetSegment(oldId) is None
    assert mrml_scenes.segment_voxels(other, first).any()
