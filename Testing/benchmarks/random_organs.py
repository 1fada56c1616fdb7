"""Organs of random shape: the generic model, stretched, turned and pushed at random."""

from __future__ import annotations

import numpy as np

from VICRegistrationLib.geometry import models, parametrization
from VICRegistrationLib.geometry.surface import BSplineSurface


def random_organ(seed: int) -> BSplineSurface:
    """Smooth and closed; most of them are valid, some pass through themselves."""
    random = np.random.default_rng(seed)
    net = [(9, 7), (13, 9), (9, 7), (17, 13)][random.integers(4)]
    axes = np.diag(random.uniform(12.0, 40.0, 3))
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    model = models.closed_organ(net, axes=axes @ turn.T, center=random.normal(size=3) * 50.0)
    points, length = model.control_net, axes.max()
    pushed = np.zeros_like(points)
    for _ in range(6):
        center = points.reshape(-1, 3)[random.integers(points[..., 0].size)]
        reach = random.uniform(0.3, 0.8) * length
        fading = np.exp(-np.square(points - center).sum(axis=-1, keepdims=True) / (2.0 * reach**2))
        pushed += fading * random.normal(size=3) * length * random.uniform(0.05, 0.35)
    smooth = parametrization.closed_organ(model)
    return smooth.deform(smooth.fit(points + pushed))
