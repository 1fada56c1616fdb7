"""What further stacks show of an organ beyond the border of the first one is added to its region."""

from __future__ import annotations

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid
from stack_phantom import stack_of

from VICRegistrationLib.imaging.region import Region
from VICRegistrationLib.registration.completion import completed_region
from VICRegistrationLib.segmentation.separation import separate


@pytest.fixture(scope="module")
def half():
    """A sagittal stack that ends 5 mm right of the organ's centre, and the organ's region in it."""
    image = stack_of(ellipsoid(), "sagittal")
    cut = image.crop((0, 0, 0), (10, *image.array.shape[1:]))
    return cut, separate(cut, CENTER[None])


def reach(region: Region, *, above: float) -> float:
    """How far a region reaches to the right of the organ's centre at a height above it, mm."""
    points = region.image.to_ras(np.argwhere(region.mask)[:, ::-1]) - CENTER
    return points[np.abs(points[:, 2] - above) < 1.0, 0].max()


def test_what_another_stack_shows_is_added(half):
    image, region = half
    whole = completed_region(image, region, [(stack_of(ellipsoid(), "axial"), np.eye(4))])
    assert whole.volume_ml == pytest.approx(ellipsoid().volume() / 1000.0, rel=0.07)
    assert whole.touches_border == ()
    assert completed_region(image, region, []) is region


def test_what_no_stack_shows_is_bridged_from_one_that_ends_below_to_the_border_of_the_first(half):
    image, region = half
    axial = stack_of(ellipsoid(), "axial")
    # It ends 4 mm above the organ's centre; there the organ reaches 14 mm to the right, and the first stack 5 mm.
    lower = axial.crop((0, 0, 0), (10, *axial.array.shape[1:]))
    whole = completed_region(image, region, [(lower, np.eye(4))])
    there, higher, highest = (reach(whole, above=height) for height in (0.0, 9.0, 20.0))
    assert there > 11.0
    assert reach(region, above=9.0) + 2.0 < higher < there
    assert highest < 7.0
