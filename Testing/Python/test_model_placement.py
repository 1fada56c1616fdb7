"""A generic model is placed by the moments of its organs' regions, and not in another unit or frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.multipatch.pelvis import pelvis
from VICRegistrationLib.multipatch.placement import SolidMoments, place, transport_map
from VICRegistrationLib.phantoms.organs import pelvic_organs

PELVIS = pelvis()
AXES = np.diag([10.0, 20.0, 30.0])


def solids(matrix=None, names=("bladder", "vagina", "rectum")):
    """Moments of the demo's organs, moved by a matrix, as those of regions would be."""
    matrix = np.eye(4) if matrix is None else matrix
    return {name: SolidMoments.of_surface(pelvic_organs()[name].transformed(matrix)) for name in names}


def motion(*, scale=1.0, degrees=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def test_the_moments_of_an_ellipsoid():
    turn = Rotation.from_euler("xyz", (20, 30, 40), degrees=True).as_matrix()
    found = SolidMoments.of_surface(closed_organ((17, 13), axes=AXES @ turn.T, center=(5.0, -40.0, 7.0)))
    # The net's ellipsoid is one within a thousandth.
    assert found.volume == pytest.approx(4.0 / 3.0 * np.pi * 6000.0, rel=2e-3)
    assert np.allclose(found.center, (5.0, -40.0, 7.0), atol=1e-9)
    assert np.allclose(found.covariance, turn @ AXES**2 @ turn.T / 5.0, atol=0.4)


def test_the_moments_of_a_region_are_those_of_its_surface():
    surface = closed_organ((17, 13), axes=AXES, center=(3.0, 4.0, 5.0))
    image = Image.from_array(
        np.zeros((80, 56, 40)), np.array([[1, 0, 0, -17], [0, 1, 0, -24], [0, 0, 1, -35], [0, 0, 0, 1.0]])
    )
    k, j, i = np.indices(image.array.shape)
    away = (image.to_ras(np.stack([i, j, k], axis=-1)) - (3.0, 4.0, 5.0)) / np.diag(AXES)
    region = region_from_mask(image, np.einsum("...k,...k->...", away, away) <= 1.0)
    found, expected = SolidMoments.of_region(region), SolidMoments.of_surface(surface)
    assert found.volume == pytest.approx(expected.volume, rel=0.01)
    assert np.allclose(found.center, expected.center, atol=0.05)
    assert np.allclose(found.covariance, expected.covariance, rtol=0.01, atol=0.5)


def test_a_transport_map_takes_moments_to_moments_and_turns_nothing():
    source, target = (solids()[name] for name in ("vagina", "rectum"))
    matrix = transport_map(source, target)
    moved = source.moved(matrix)
    assert np.allclose(moved.center, target.center)
    assert np.allclose(moved.covariance, target.covariance)
    assert np.allclose(matrix[:3, :3], matrix[:3, :3].T)
    assert np.linalg.eigvalsh(matrix[:3, :3]).min() > 0.0


@pytest.mark.parametrize("names", [("bladder", "vagina", "rectum"), ("bladder", "vagina")])
def test_a_model_moved_as_a_whole_is_found(names):
    expected = motion(scale=1.2, degrees=(20, -10, 15), shift=(30, -200, 90))
    parents = PELVIS.parents
    targets = {name: SolidMoments.of_surface(parents[name].transformed(expected)) for name in names}
    found = place(parents, targets)
    # The similarity is repeated until it changes by less than 1e-5.
    assert np.allclose(found.matrix[:3, :3], expected[:3, :3], atol=3e-4)
    center = targets["vagina"].center
    assert np.allclose(found.matrix @ np.linalg.inv(expected) @ [*center, 1.0], [*center, 1.0], atol=0.01)
    assert found.scale == pytest.approx(1.2, abs=1e-3)
    assert found.degrees == pytest.approx(
        np.degrees(Rotation.from_euler("xyz", (20, -10, 15), degrees=True).magnitude()), abs=0.05
    )
    assert all(np.allclose(matrix[:3, :3], np.eye(3), atol=1e-3) for matrix in found.maps.values())


def test_a_model_that_is_stretched_as_a_whole_is_found_by_the_affine_map():
    stretch = np.diag([1.15, 0.93, 1.05, 1.0])
    targets = {name: SolidMoments.of_surface(surface.transformed(stretch)) for name, surface in PELVIS.parents.items()}
    found = place(PELVIS.parents, targets)
    # Transport maps of single organs turn nothing, so that their least squares are off by a few thousandths.
    assert np.allclose(found.matrix[:3, :3], stretch[:3, :3], atol=0.01)
    assert all(np.allclose(matrix[:3, :3], np.eye(3), atol=0.01) for matrix in found.maps.values())


def test_balls_in_a_row_are_not_given_half_a_turn():
    parents = {str(x): closed_organ(axes=10.0 * np.eye(3), center=(x, 0.0, 0.0)) for x in (-30.0, 0.0, 40.0)}
    # Half a turn about the row explains as much as none; for six of these angles rounding made it explain more.
    for degrees in range(1, 40):
        expected = motion(degrees=(0, 0, degrees), shift=(degrees, 2 * degrees, -degrees))
        targets = {name: SolidMoments.of_surface(ball.transformed(expected)) for name, ball in parents.items()}
        assert place(parents, targets).degrees == pytest.approx(degrees, abs=1e-3)


def test_each_organ_s_own_map_takes_it_to_its_region():
    parents, targets = PELVIS.parents, solids(motion(degrees=(5, 5, 5)))
    found = place(parents, targets)
    for name, target in targets.items():
        moved = SolidMoments.of_surface(parents[name].transformed(found.maps[name] @ found.matrix))
        assert np.allclose(moved.center, target.center, atol=1e-6)
        assert np.allclose(moved.covariance, target.covariance, atol=1e-6)


@pytest.mark.parametrize(("scale", "told"), [(0.1, "0.1 times"), (10.0, "10 times")])
def test_another_unit_is_refused(scale, told):
    with pytest.raises(ValueError, match=rf"{told} as large as the model's.*Check the unit \(mm\)"):
        place(PELVIS.parents, solids(motion(scale=scale)))


@pytest.mark.parametrize("degrees", [(0, 0, 180), (60, 0, 0)], ids=["LPS", "turned"])
def test_another_frame_is_refused(degrees):
    with pytest.raises(ValueError, match=r"turned by \d+ degrees against the model.*RAS or LPS"):
        place(PELVIS.parents, solids(motion(degrees=degrees)))


@pytest.mark.parametrize("signs", [(1, -1, 1), (1, 1, -1)], ids=["front and back", "top and bottom"])
def test_an_image_mirrored_front_to_back_or_upside_down_is_refused(signs):
    with pytest.raises(ValueError, match="turned by"):
        place(PELVIS.parents, solids(np.diag([*signs, 1.0])))


def test_an_image_mirrored_left_to_right_looks_like_any_patient():
    # Nothing in these organs says which side is left: the header of the image is trusted.
    assert place(PELVIS.parents, solids(np.diag([-1.0, 1.0, 1.0, 1.0]))).degrees < 10.0


def test_organs_that_were_exchanged_are_refused():
    found = solids()
    with pytest.raises(ValueError, match="which organ is which"):
        place(PELVIS.parents, {"bladder": found["rectum"], "rectum": found["bladder"], "vagina": found["vagina"]})
