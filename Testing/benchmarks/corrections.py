"""Real bladders with bad starts, corrected by boundary points that are added one by one at the worst place."""

from __future__ import annotations

import numpy as np
from bladders import HARD, NAMES, bladders, drawn_image, seed_above
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
# The lower threshold is this share of the median grey level in the lumen: dark parts are left out. The seed is the
# deepest place that is not among them.
_TOO_HIGH = 0.9


def report(*, quick: bool) -> str:
    """Fit each bladder with a lower threshold that is too high, and correct it with up to 16 points."""
    refused = []
    rows = [["bladder", "points", "mean mm", "largest mm", "points met to mm", "valid"]]
    for bladder in bladders(names=NAMES[:1] if quick else NAMES + HARD):
        drawn = drawn_image(bladder)
        truth = points_on(mesh_of_mask(drawn), N_POINTS)
        lumen = bladder.image.array[drawn.array > 0]
        low = _TOO_HIGH * float(np.median(lumen))
        options = FitOptions(threshold=(low, float(lumen.max())))
        first = finish(fit_organ(bladder.image, seed_above(bladder, low), options)).surface
        surface, points = first, np.empty((0, 3))
        for count in range((4 if quick else max(CLICKS)) + 1):
            away = np.abs(closest_points(surface, truth).distances)
            if count in CLICKS:
                met = np.abs(boundary_deviations(surface, points)).max(initial=0.0)
                numbers = (f"{away.mean():.2f}", f"{away.max():.1f}", f"{met:.2f}")
                rows.append([bladder.name, str(count), *numbers, "no" if check_surface(surface) else "yes"])
            points = np.vstack([points, truth[away.argmax()]])
            try:
                surface = finish(refit(bladder.image, first, options, boundary_points=points)).surface
            except ValueError as error:
                refused.append(f"{bladder.name}, {count + 1} points: {error}")
                break
    if len(rows) == 1:
        return "  The real images are not here."
    return f"""\
  The start is wrong: the lower threshold is {_TOO_HIGH:g} of the median in the lumen, given by hand. Each point is
  that of the experts' surface from which the surface is farthest now; all points so far correct the first surface
  again.

{table(rows)}

  {"; ".join(refused) or "No point was refused."}"""
