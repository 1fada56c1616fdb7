"""Choices for fitting an organ."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np

from ..geometry.models import GENERIC_MODELS
from ..geometry.parametrization import CLOSURES
from .cost import LOSSES
from .solvers import SOLVERS
from .virtual_image import LEVEL_MODES

# The paper: a ramp of 2 to 3 pixels suits the MRI used. To start with, and the least and the most that are chosen.
TAU_PIXELS, LEAST_TAU_PIXELS, MOST_TAU_PIXELS = 2.5, 2.0, 3.0
MAX_ITERATIONS = {"gauss-newton": 50, "gradient-descent": 300}
STOPPINGS = ("settled", "published")


@dataclass(frozen=True)
class FitOptions:
    """Choices for fitting an organ; the defaults need no tuning.

    Parameters
    ----------
    net : (rows, columns), optional
        Size of the control net in the paper's counting; if not given it is chosen, see :mod:`.finer_nets`: 9x7, 17x11
        or 33x19, the finest one that lowers the cost by more than noise explains.
    closure : {"smooth", "paper"}
        How the surface is kept closed, see :func:`..geometry.parametrization.closed_organ`.
    model : str
        Name of the generic model to start from, see :data:`..geometry.models.GENERIC_MODELS`.
    threshold : (low, high), optional
        Grey levels of the organ, for separating it; suggested from the seeds if not given.
    erosion : float, optional
        Erosion that cuts bridges to neighbours, mm; that of :func:`..segmentation.separation.separate` if not given.
    dilation : float, optional
        Dilation of the separated organ back to its edge, mm; as far as the erosion if not given.
    solver : {"gauss-newton", "gradient-descent"}
    tau : float, optional
        Width of the intensity profile's ramp in mm; as wide as the edge in the image if not given.
    centered : bool
        Whether the surface lies at half height of the ramp, or as published at its inner foot.
    levels : {"local", "organ", "given"}
        Grey levels inside and outside: estimated along the surface, once for the organ, or given.
    inside, outside : float, optional
        Grey levels for ``levels="given"``.
    smoothness : float, optional
        Weight of the thin-plate energy on the grey levels, dimensionless, see :class:`.stages.Stage`; larger is
        stiffer. If not given, it is chosen by the noise.
    loss : {"squares", "huber"}
        How much samples on the grey levels count that are far from the virtual image's: their squares, as published, or
        less, where small clots lie at the wall.
    tolerance : float
        Largest displacement of a control point at which the last stage stops, mm.
    stopping : {"settled", "published"}
        "settled": a stage ends at its tolerance or when its cost has settled, gradient descent at a twentieth of both.
        "published": at its tolerance alone, which is 0.01 for the parameters of the global scaling.
    max_iterations : int, optional
        For each stage; 50 for Gauss-Newton and 300 for gradient descent if not given.
    boundary_weight : float
        Weight of the boundary points, dimensionless, see :func:`.correction.correct`: 0 leaves them out; with 1 the
        surface passes a point that was 5 mm off at 0.1 mm, with 0.1 at about 1 mm.
    """

    net: tuple[int, int] | None = None
    closure: str = "smooth"
    model: str = "automatic"
    threshold: tuple[float, float] | None = None
    erosion: float | None = None
    dilation: float | None = None
    solver: str = "gauss-newton"
    tau: float | None = None
    centered: bool = True
    levels: str = "local"
    inside: float | None = None
    outside: float | None = None
    smoothness: float | None = None
    loss: str = "squares"
    tolerance: float = 0.1
    stopping: str = "settled"
    max_iterations: int | None = None
    boundary_weight: float = 1.0

    def __post_init__(self) -> None:
        """Check what can be checked without an image."""
        if self.net is not None:
            object.__setattr__(self, "net", _checked_net(self.net))
        words = {
            "solver": tuple(SOLVERS),
            "levels": LEVEL_MODES,
            "closure": CLOSURES,
            "model": tuple(GENERIC_MODELS),
            "stopping": STOPPINGS,
            "loss": LOSSES,
        }
        for name, choices in words.items():
            if getattr(self, name) not in choices:
                msg = f"The option {name} is {getattr(self, name)!r}; choose one of {', '.join(choices)}."
                raise ValueError(msg)
        if self.levels == "given" and (self.inside is None or self.outside is None):
            msg = "Given levels were asked for without them; give the grey levels inside and outside too."
            raise ValueError(msg)
        for name in ("tau", "tolerance", "smoothness", "max_iterations", "boundary_weight"):
            value = getattr(self, name)
            if value is None and name in ("tau", "smoothness", "max_iterations"):
                continue
            is_number = isinstance(value, Real) and not isinstance(value, bool) and np.isfinite(value)
            if not is_number or value < 0 or (value == 0 and name not in ("smoothness", "boundary_weight")):
                msg = f"The option {name} is {value!r}; a finite positive number is needed."
                raise ValueError(msg)

    @classmethod
    def as_published(cls) -> FitOptions:
        """Choices of the paper (Jiang et al., Strain 2019), where it makes one.

        Returns
        -------
        FitOptions
            - ``net`` 9x7, section 2.1.
            - ``closure`` "paper": midpoints at the seam, poles that move with their rings, figures 2 and 3.
            - ``solver`` "gradient-descent", section 2.2, and at most 300 iterations for each stage; the paper's run
              took 140 for the scaling and about 150 for the control points (figure 16).
            - ``centered`` False: equation 3 puts the surface at the inner foot of the ramp, about half a ramp inside of
              the edge.
            - ``tau`` automatic: 2 to 3 pixels suit the paper's MRI.
            - ``levels`` "organ": one grey level inside and one outside, as A_max and A_min of equation 3.
            - ``smoothness`` 0: there is no bending energy.
            - ``stopping`` "published": the global scaling ends when its parameters vary by less than 0.01, the control
              points when none moves by more than ``tolerance``, a small number that the paper does not tell, here
              0.01 mm.

        Notes
        -----
        What the paper has nothing of stays: the stage on the separated region, coarse before fine, and the small
        weights against sliding and against leaving the region.
        """
        return cls(
            net=(9, 7),
            closure="paper",
            solver="gradient-descent",
            tau=None,
            centered=False,
            levels="organ",
            smoothness=0.0,
            tolerance=0.01,
            stopping="published",
            max_iterations=MAX_ITERATIONS["gradient-descent"],
        )


def _checked_net(net) -> tuple[int, int]:
    """Return the net's size as two whole numbers."""
    try:
        rows, columns = (int(size) for size in net)
        whole = (rows, columns) == tuple(net)
    except (TypeError, ValueError):
        whole = False
    if not whole:
        msg = f"The option net is {net!r}; two whole numbers are needed, such as (9, 7)."
        raise ValueError(msg)
    return rows, columns
