"""Real MRI against what experts have drawn, with default options; skipped where the images are not there."""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
import pytest
from accuracy import MEAN_MM, P95_MM, of_contour, of_surface, real_case
from bladders import NAMES, load_bladder
from hippocampus import NAMES as HIPPOCAMPI
from hippocampus import farthest_from_start, load_hippocampus

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.analysis.reference_meshes import mesh_of_mask
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.imaging.region import dice_coefficient
from VICRegistrationLib.registration.diagnostics import fit_diagnostics
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate


class Fitted:
    """A bladder, and its fit from one seed."""

    def __init__(self, bladder, region):
        self.case = real_case(bladder)
        self.volume_ml = bladder.lumen.volume_ml
        self.fit = finish(fit_region(bladder.image, region))

    @cached_property
    def measured(self):
        """The fit against what experts have drawn."""
        return of_surface(self.fit.surface, self.case)


@pytest.fixture(scope="module")
def drawn(shared_data):
    """Function that reads a bladder and what experts have drawn, each once."""
    return cache(lambda name: load_bladder(name, shared_data / "bladder_mri"))


@pytest.fixture(scope="module")
def separated(drawn):
    """Function that separates a bladder from its one seed: the bladder and its region, each once."""

    @cache
    def separated(name):
        bladder = drawn(name)
        return bladder, separate(bladder.image, bladder.seed)

    return separated


@pytest.fixture(scope="module")
def load(separated):
    """Function that gives a fitted bladder by its name, each fitted once."""
    return cache(lambda name: Fitted(*separated(name)))


@pytest.mark.parametrize(
    # The expert's outline runs about half a voxel outside of half height, 0.97 for such an organ.
    ("name", "least"),
    [("full_p5", 0.93), ("crop_IM1383", 0.978)],
)
def test_a_bladder_is_separated_from_one_seed(separated, name, least):
    """Lobes beside IM1383 have less of an edge than its wall."""
    bladder, region = separated(name)
    assert dice_coefficient(region, bladder.lumen) > least


def test_a_click_near_the_wall_is_as_good_as_one_in_the_middle(drawn):
    bladder = drawn("crop_IM1523")
    region = separate(bladder.image, [[-110.5, -139.0, -21.0]])
    assert dice_coefficient(region, bladder.lumen) > 0.96


@pytest.mark.parametrize("name", NAMES)
def test_a_bladder_is_within_two_pixels_of_the_experts(load, name):
    bladder = load(name)
    found = bladder.measured.distances
    # Asked for: 0.8 and 2.5 mm. Measured: 0.71 and 2.34, 0.68 and 2.11, 0.65 and 2.09 mm.
    assert found.mean <= MEAN_MM
    assert found.p95 <= P95_MM
    assert abs(found.mean_signed) <= 0.4
    assert bladder.fit.problems == ()
    assert bladder.fit.surface.volume() / 1000.0 == pytest.approx(bladder.volume_ml, rel=0.15)


@pytest.mark.parametrize("name", NAMES)
def test_smoothed_triangles_of_the_same_region_are_rougher(load, name):
    bladder = load(name)
    ours, theirs = bladder.measured, of_contour(bladder.fit.region, bladder.case)
    # Measured: 1.4 to 1.8 times. Distances are about the same, within 0.10 mm: they are those of the region.
    assert theirs.angle > 1.25 * ours.angle
    assert ours.distances.mean < theirs.distances.mean + 0.15


def test_a_bladder_in_fat_does_not_leak(load):
    bladder = load("full_p5")
    assert bladder.measured.distances.maximum <= 6.0
    assert bladder.fit.region.volume_ml == pytest.approx(bladder.volume_ml, rel=0.15)
    assert bladder.fit.region.touches_border == ()


# ------------------------------------------------------------------ a hippocampus, of which a box is all that is known


@pytest.mark.parametrize("name", HIPPOCAMPI)
def test_an_organ_without_an_edge_is_neither_folded_nor_lost_nor_believed(shared_data, name):
    case = load_hippocampus(name, shared_data / "hippocampus")
    fit = finish(fit_region(case.image, case.box))
    assert fit.problems == ()
    # Measured: 0.8 to 1.1 mm; half the radius of a ball of its volume is 5 mm.
    assert farthest_from_start(fit) < 5.0
    assert np.median(fit.confidence.deviations) > 1.5
    assert any(found.code.startswith("no_edge") for found in fit_diagnostics(case.image, fit))


@pytest.mark.parametrize("name", HIPPOCAMPI)
def test_a_fit_from_a_hippocampus_s_label_stays_there(shared_data, name):
    case = load_hippocampus(name, shared_data / "hippocampus")
    fit = finish(fit_region(case.image, case.label))
    assert fit.problems == ()
    # Measured: 0.4 to 0.5 mm, in voxels of 1 mm; 0.5 to 1.5 mm.
    assert deviation(fit.surface, mesh_of_mask(case.label.image)).mean <= 1.0
    assert np.median(fit.confidence.deviations) > 0.4


# ------------------------------------------------------------------ a bladder cut by the field of view

SEED = np.array([[-57.0, -12.6, 4.0]])


@pytest.fixture(scope="module")
def clipped(shared_data):
    image = read_image(shared_data / "prostatex" / "px0_sag.nii.gz")
    return image, finish(fit_organ(image, SEED))


def test_a_bladder_cut_by_the_field_of_view_stays_sane(clipped):
    image, fit = clipped
    assert len(fit.region.touches_border) > 0
    assert fit.converged
    assert fit.problems == ()
    assert fit.surface.volume() / 1000.0 == pytest.approx(fit.region.volume_ml, rel=0.15)
    points = fit.surface.grid(np.linspace(0.0, 1.0, 80), np.linspace(0.0, 1.0, 50)).reshape(-1, 3)
    ijk = image.to_ijk(points)
    beyond = np.maximum(np.maximum(-0.5 - ijk, ijk - (image.size - 0.5)), 0.0) * image.spacing
    # Nothing is known beyond the volume: the surface closes there within one slice of 3.6 mm. Measured: 0.8 mm.
    assert beyond.max() < 3.6


def test_what_one_stack_cuts_off_is_completed_from_another_one(clipped, shared_data):
    image, alone = clipped
    fit = finish(fit_organ(image, SEED, further=[shared_data / "prostatex" / "px0_tra.nii.gz"]))
    (axial,) = fit.stacks
    assert axial.used
    assert 0.5 < np.linalg.norm(axial.translation_mm) < 2.5
    # Measured: 1.2 mm and 0.7 degrees, known to 0.3 mm and 0.9 degrees.
    assert axial.translation_sd_mm < 0.6
    assert axial.rotation_degrees < 3.0 * axial.rotation_sd_degrees < 6.0
    assert fit.problems == ()
    # The sagittal slices end at R -7 mm; in the axial ones the bladder goes on for some 5 mm.
    right = [each.surface.points(*each.surface.midpoints(80, 50))[:, 0].max() for each in (alone, fit)]
    assert right[1] > right[0] + 3.0
    assert fit.whole_region.touches_border == ()


def test_a_dicom_folder_and_a_file_give_the_same_surface(clipped, shared_data):
    _, fit = clipped
    series = read_image(shared_data / "prostatex" / "px0_sag_dicom")
    other = finish(fit_organ(series, SEED))
    # The file keeps its matrix in single precision, which moves the slices by some 1e-6 mm. Of the parts into which
    # voxels are cut, some lie on the other side of the surface then. Measured: 0.014 mm at one control point.
    assert np.abs(other.surface.control_net - fit.surface.control_net).max() < 0.03


def test_a_click_into_a_dark_part_finds_the_bladder(drawn):
    # All small surfaces around this place cost less than the bladder's, seen from there.
    bladder = drawn("crop_IM0228")
    region = separate(bladder.image, [-142.5, -67.0, -21.0])
    assert dice_coefficient(region, bladder.lumen) > 0.94


def test_a_rectum_in_thick_slices_is_separated_from_three_clicks(shared_data):
    image = read_image(shared_data / "prostatex" / "px0_tra.nii.gz")
    clicks = np.array([[190.0, 268.0, 10.0], [195.0, 295.0, 14.0], [190.0, 310.0, 17.0]])
    region = separate(image, image.to_ras(clicks))
    # A star-shaped surface leaves out half of the highest slice. The one along the axis goes on through the anal canal,
    # as no edge ends the rectum there.
    assert all(region.mask[tuple(voxel)] for voxel in clicks[:, ::-1].astype(int) - region.offset)
    assert region.mask[-1].sum() * np.prod(region.spacing[:2]) > 600.0
    assert 60.0 < region.volume_ml < 80.0
    assert region.touches_border == ("k-", "k+")
    assert [found.code for found in region.diagnostics] == ["surfaces_differ"]
