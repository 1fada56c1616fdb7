"""What a user is told to look at."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from small_phantom import CENTER, ellipsoid_image

from VICRegistrationLib.registration.diagnostics import border_sides, warnings_about
from VICRegistrationLib.registration.organ import FitOptions, finish, fit_region
from VICRegistrationLib.segmentation.separation import separate


def test_a_sound_fit_gives_no_warning():
    image = ellipsoid_image()
    assert warnings_about(image, finish(fit_region(image, separate(image, CENTER)))) == []


def test_a_thin_part_that_the_surface_leaves_out_is_told_with_its_side():
    image = ellipsoid_image()
    found = finish(fit_region(image, separate(image, CENTER)))
    mask = found.region.mask
    k, j, i = np.argwhere(mask)[np.argmax(np.argwhere(mask)[:, 0])]
    # A tail of 2 x 2 voxels at the last slice, as long as the mask is deep.
    tail = np.zeros((len(mask), *mask.shape[1:]), dtype=bool)
    tail[:, j : j + 2, i : i + 2] = True
    longer = replace(found, region=replace(found.region, mask=np.concatenate([mask, tail])))
    (told,) = warnings_about(image, longer)
    length = round(len(mask) * float(image.spacing[2]))
    reach = int(re.search(r"reaches (\d+) mm beyond the surface", told)[1])
    assert abs(reach - length) <= 4
    # A larger net leaves thin parts out as well.
    assert "place points on the wall" in told
    assert f"at its {border_sides(image, replace(found.region, touches_border=('k+',)))[0]} side" in told


def test_the_sides_of_the_border_are_those_of_the_patient():
    # Slices run from left to right (k), pixels from front to back (i) and from top to bottom (j).
    whole = ellipsoid_image()
    region = separate(whole, CENTER)
    assert border_sides(whole, region) == []
    touching = replace(region, touches_border=("k+", "j-", "i+"))
    assert border_sides(whole, touching) == ["right", "superior", "posterior"]


def test_what_looks_wrong_about_a_fit_is_told_in_plain_words():
    image = ellipsoid_image()
    options = FitOptions()
    region = separate(image, CENTER)
    found = finish(fit_region(image, region, options))
    inside_out = found.surface.transformed(np.diag([-2.0, 1.0, 1.0, 1.0]))
    bad = replace(
        found,
        surface=inside_out,
        converged=False,
        cost_final=0.7,
        region=replace(region, warnings=("The region leaks.",)),
        history=(*found.history[:-1], replace(found.history[-1], stopped_by="no better point")),
    )
    told = warnings_about(image, bad)
    for words in (
        "inside out",
        "no further step lowered the cost",
        "The region leaks.",
        "follows no clear edge",
        "but the separated region",
    ):
        assert sum(words in sentence for sentence in told) == 1, words
    assert not [sentence for sentence in told if "control net" in sentence or "weight" in sentence]
