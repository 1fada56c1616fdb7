"""Surfaces that the tests of STEP files share."""

from __future__ import annotations

import numpy as np

from VICRegistrationLib.geometry.models import closed_organ

AXES = np.array([[18.0, 6.0, 0.0], [-7.0, 24.0, 3.0], [1.0, -4.0, 33.0]])
CENTER = (-12.3, 45.6, 7.8)


def organ(net=(9, 7), **kwargs):
    """An ellipsoid askew in space, off the origin."""
    return closed_organ(net, axes=AXES, center=CENTER, **kwargs)


def dented(net=(9, 7), **kwargs):
    """The same with a dent and knots that are not spread evenly, as no sphere would show what gets mixed up."""
    surface = organ(net, **kwargs)
    away = surface.control_net - np.array(CENTER)
    near = np.exp(-np.square(away - AXES[1]).sum(axis=-1, keepdims=True) / 15.0**2)
    (u_low, u_high), (v_low, v_high) = surface.domain
    moved = surface.with_control_net(surface.control_net - 0.35 * near * away)
    return moved.insert_knots(u=[u_low + 0.137 * (u_high - u_low)], v=[v_low + 0.71 * (v_high - v_low)])
