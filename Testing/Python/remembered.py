"""Separations and fits that are worked out once per process, and told again to tests that ask for the same ones."""

from __future__ import annotations

import hashlib

import numpy as np

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import Region
from VICRegistrationLib.registration import organ
from VICRegistrationLib.segmentation import separation

# By what was asked for.
_KNOWN = {}


def remember(patch):
    """Let what the module asks for be remembered; where a fit was cut off or failed, nothing is."""
    patch.setattr(separation, "separate", _remembered(separation.separate))
    for name in ("fit_region", "refit"):
        patch.setattr(organ, name, _remembered_steps(getattr(organ, name)))


def _remembered(function):
    def told(*arguments, **options):
        key = _key(function, arguments, options)
        if key not in _KNOWN:
            _KNOWN[key] = function(*arguments, **options)
        return _KNOWN[key]

    return told


def _remembered_steps(function):
    def told(*arguments, **options):
        key = _key(function, arguments, options)
        if key in _KNOWN:
            yield from _KNOWN[key].history
        else:
            _KNOWN[key] = yield from function(*arguments, **options)
        return _KNOWN[key]

    return told


def _key(function, arguments, options):
    """Digest of all numbers that go into a function."""
    digest = hashlib.blake2b(function.__name__.encode())
    for value in (*arguments, *(part for item in sorted(options.items()) for part in item)):
        _add(digest, value)
    return digest.digest()


def _add(digest, value):
    if isinstance(value, Image):
        parts = (value.array, value.ijk_to_ras)
    elif isinstance(value, Region):
        parts = (value.mask, value.ijk_to_ras, value.offset, value.threshold, value.erosion)
    elif isinstance(value, BSplineSurface):
        parts = (value.control_net, value.knots_u, value.knots_v, value.degrees)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
        return
    else:
        digest.update(repr(value).encode())
        return
    for part in parts:
        _add(digest, part)
