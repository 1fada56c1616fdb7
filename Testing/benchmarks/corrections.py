"""Real bladders with bad starts, corrected by boundary points that are added one by one at the worst place."""

from __future__ import annotations

import numpy as np
from bladders import HARD, NAMES, Bladder, bladders, drawn_image
from measuring import table

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.analysis.reference_meshes import mesh_of_mask
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish

N_POINTS = 4000
# Numbers of points after which distances are printed.
CLICKS = (0, 1, 2, 4, 8, 16)
# The lower threshold is this share of the median grey level in the lumen: dark parts are left out.
_TOO_HIGH = 0.9
# Missed without that; the seed of the second one is too dark for such a threshold.
_BY_DEFAULT = ("crop_IM0228", "crop_IM1523")


def report(*, quick: bool) -> str:
    """Fit each bladder with a lower threshold that is too high, or by default, and correct it with up to 16 points."""
    refused = []
    rows = [["bladder", "threshold", "points", "mean mm", "largest mm", "points met to mm", "valid"]]
    for bladder in bladders(names=NAMES[:1] if quick else NAMES + HARD):
        drawn = drawn_image(bladder)
        truth = points_on(mesh_of_mask(drawn), N_POINTS)
        options, start = _start(bladder, bladder.image.array[drawn.array > 0])
        first = finish(fit_organ(bladder.image, bladder.seed, options)).surface
        surface, points = first, np.empty((0, 3))
        for count in range((4 if quick else max(CLICKS)) + 1):
            away = np.abs(closest_points(surface, truth).distances)
            if count in CLICKS:
                met = np.abs(boundary_deviations(surface, points)).max(initial=0.0)
                numbers = (f"{away.mean():.2f}", f"{away.max():.1f}", f"{met:.2f}")
                rows.append([bladder.name, start, str(count), *numbers, "no" if check_surface(surface) else "yes"])
            points = np.vstack([points, truth[away.argmax()]])
            try:
                surface = finish(refit(bladder.image, first, options, boundary_points=points)).surface
            except ValueError as error:
                refused.append(f"{bladder.name}, {count + 1} points: {error}")
                break
    if len(rows) == 1:
        return "  The real images are not here."
    return f"""\
  Threshold: too high is a lower one of {_TOO_HIGH:g} of the median in the lumen, given by hand. Each point is that of
  the experts' surface from which the surface is farthest now; all points so far correct the first surface again.

{table(rows)}

  {"; ".join(refused) or "No point was refused."}"""


def _start(bladder: Bladder, lumen: np.ndarray) -> tuple[FitOptions, str]:
    """Options of a fit with a bad start, from the grey levels in the lumen, and the name of its threshold."""
    if bladder.name in _BY_DEFAULT:
        return FitOptions(), "automatic"
    return FitOptions(threshold=(_TOO_HIGH * float(np.median(lumen)), float(lumen.max()))), "too high"
