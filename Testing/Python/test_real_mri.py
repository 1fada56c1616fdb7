"""Bladders in real MRI, against what experts have drawn; skipped where the images are not there."""

from __future__ import annotations

import numpy as np
import pytest
from bladders import BY_HAND, load_bladder

from VICRegistrationLib.analysis.deviation import deviation, mesh_of_mask
from VICRegistrationLib.imaging.reading import read_image
from VICRegistrationLib.registration.organ import FitOptions, finish, fit_organ


class Case:
    """A bladder with the surface of its lumen."""

    def __init__(self, folder, name):
        bladder = load_bladder(name, folder)
        self.image, self.seed, self.volume_ml = bladder.image, bladder.seed, bladder.lumen.volume_ml
        self.reference = mesh_of_mask(bladder.lumen.image)


@pytest.fixture(scope="module")
def load(shared_data):
    """Cases by name, each read once."""
    cases = {}

    def loaded(name):
        if name not in cases:
            cases[name] = Case(shared_data / "bladder_mri", name)
        return cases[name]

    return loaded


@pytest.mark.parametrize(
    ("name", "options", "bound"),
    # The bound asked for is 1.0 mm; measured are 0.73, 0.71, 0.62 and 0.66 mm.
    [
        ("crop_IM0465", BY_HAND["crop_IM0465"], 0.85),
        ("crop_IM0465", FitOptions(), 0.85),
        ("crop_IM0533", BY_HAND["crop_IM0533"], 0.75),
        ("crop_IM0533", FitOptions(), 0.75),
    ],
    ids=["IM0465-given", "IM0465-suggested", "IM0533-given", "IM0533-suggested"],
)
def test_a_bladder_is_within_a_millimetre_of_the_experts(load, name, options, bound):
    case = load(name)
    fit = finish(fit_organ(case.image, case.seed, options))
    found = deviation(fit.surface, case.reference)
    assert found.mean <= bound
    assert abs(found.mean_signed) <= 0.5
    assert fit.problems == ()
    assert fit.surface.volume() / 1000.0 == pytest.approx(case.volume_ml, rel=0.15)


@pytest.mark.parametrize("options", [BY_HAND["full_p5"], FitOptions()], ids=["given", "suggested"])
def test_a_bladder_in_fat_does_not_leak(load, options):
    case = load("full_p5")
    fit = finish(fit_organ(case.image, case.seed, options))
    found = deviation(fit.surface, case.reference)
    # Measured: 0.66 and 0.65 mm, and 3 % above the volume of the label, whose lower end stops early.
    assert found.mean <= 0.8
    assert found.maximum <= 5.0
    assert fit.surface.volume() / 1000.0 == pytest.approx(case.volume_ml, rel=0.15)
    assert fit.region.volume_ml == pytest.approx(case.volume_ml, rel=0.15)
    assert fit.region.touches_border == ()
    assert fit.problems == ()


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


def test_a_dicom_folder_and_a_file_give_the_same_surface(clipped, shared_data):
    _, fit = clipped
    series = read_image(shared_data / "prostatex" / "px0_sag_dicom")
    other = finish(fit_organ(series, SEED))
    # The file keeps its matrix in single precision, which moves the slices by some 1e-6 mm.
    assert np.abs(other.surface.control_net - fit.surface.control_net).max() < 1e-3
