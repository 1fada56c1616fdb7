"""The result of an organ's fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.surface import BSplineSurface
from ..geometry.validity import Problem, check_surface
from ..imaging.image import Image
from ..imaging.region import Region
from .choices import Choice
from .confidence import Confidence, confidence_of
from .nets import net_text
from .options import FitOptions
from .stacks import StackUse
from .stages import Step


@dataclass(frozen=True, eq=False)
class OrganFit:
    """A fitted organ.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm, outward normals.
    region : Region or None
        The separated region; None after :func:`.refit.refit` without one. If the organ was separated again through
        boundary points, that region.
    history : tuple of Step
        All iterations.
    converged : bool
        Whether the last stage on the grey levels ended by its tolerances, and the stage of the boundary points too.
    cost_initial, cost_final : float
        Mean squared residual in units of the contrast between inside and outside: of the generic model as placed (of
        the given surface after :func:`.refit.refit`), with the levels of the last stage on the grey levels, and of the
        last step.
    seconds : float
        Computing time, without the separation of the region.
    options : FitOptions
        As used, with automatic choices filled in. ``net`` is that of `surface`, which is finer than asked for if
        boundary points needed it.
    boundary_points : (n, 3) ndarray
        The points that were used, RAS mm; none if their weight is 0.
    uncorrected : BSplineSurface
        The surface before the correction by boundary points; to start from when one of them is removed.
    choices : tuple of Choice
        The net, tau and smoothness that were chosen, with the reasons.
    image : Image
        The grey levels to which it was fitted.
    stacks : tuple of StackUse
        Motion and use of each further stack, in the given order.
    whole_region : Region or None
        The region together with what further stacks show beyond the border of the first one, on the grid of the first
        one extended beyond its border; None if nothing was added.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> fit = vic.fit(image, [[23, 23, 23]], net=(9, 7))
    >>> print(f"{fit.surface.volume() / 1000.0:.1f} ml")
    17.2 ml
    >>> fit.problems
    ()
    >>> bool(fit.confidence.volume_sd_ml < 1.0)
    True
    """

    surface: BSplineSurface
    region: Region | None
    history: tuple[Step, ...]
    converged: bool
    cost_initial: float
    cost_final: float
    seconds: float
    options: FitOptions
    boundary_points: np.ndarray
    uncorrected: BSplineSurface
    choices: tuple[Choice, ...]
    image: Image
    stacks: tuple[StackUse, ...] = ()
    whole_region: Region | None = None

    def __repr__(self) -> str:
        """Show the result in one line."""
        end = "converged" if self.converged else "not converged"
        return (
            f"OrganFit({self.surface.volume() / 1000.0:.3g} ml, net {net_text(self.options.net)}, {end} after "
            f"{self.iterations} iterations, cost {self.cost_final:.3g}, {self.seconds:.2g} s)"
        )

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong with the surface; empty when it is a valid solid."""
        return check_surface(self.surface)

    @cached_property
    def confidence(self) -> Confidence:
        """Standard deviation of the surface, point by point."""
        return confidence_of(self.image, self.surface, self.options, stacks=self.stacks)

    @property
    def iterations(self) -> int:
        """Number of iterations of all stages."""
        return len(self.history)
