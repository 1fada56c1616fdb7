"""How exactly the patches of a model's organs follow their closed surfaces."""

from __future__ import annotations

import numpy as np

from VICRegistrationLib.multipatch.model import MultiPatchModel


def distance_from_surfaces(model: MultiPatchModel, samples: int) -> float:
    """Largest distance of an organ's patches from its surface at the same parameters, mm."""
    worst = 0.0
    for organ, parent in model.parents.items():
        for patch in model.patches_of(organ):
            piece = patch.surface(model.points)
            u, v = piece.midpoints(samples, samples)
            worst = max(worst, np.abs(piece.points(u, v) - parent.points(u % 1.0, v)).max())
    return worst


def angle_along_borders(model: MultiPatchModel, samples: int) -> float:
    """Largest angle between the normals of an organ's patches along their common borders in v, degrees."""
    worst = 0.0
    for organ in model.organs:
        patches = model.patches_of(organ)
        for one in patches:
            for other in patches:
                if np.array_equal(one.indices[-1], other.indices[0]):
                    here, there = one.surface(model.points), other.surface(model.points)
                    v, ones = here.midpoints(1, samples)[1], np.ones(samples)
                    ends = here.normals(here.domain[0][1] * ones, v), there.normals(there.domain[0][0] * ones, v)
                    worst = max(worst, np.linalg.norm(np.cross(*ends), axis=1).max())
    return float(np.degrees(np.arcsin(worst)))
