"""Options of a fit, each declared once: name, type, default, label, help, range and unit.

Flags of the command line, keys of a configuration file, parameters in Slicer with their ranges, labels and tooltips of
the panel, and the table in docs/command-line.md follow from these rows, see `OPTIONS`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, fields

from ..messages import marked as _
from .option_row import Option

# Width of the profile's ramp in pixels: before the edge is measured, and the limits for the measured width. The paper
# takes 2 to 3 pixels for its MRI.
TAU_PIXELS, LEAST_TAU_PIXELS, MOST_TAU_PIXELS = 2.5, 2.0, 3.0
MAX_ITERATIONS = {"gauss-newton": 50, "gradient-descent": 300}
# Largest number of rows and of columns of a control net.
LARGEST_NET = 65
# Wide enough for images, and narrow enough for the fields of Slicer's panel.
_GREY_LEVELS = (-1e6, 1e6)

# Tooltips of the panel.
WITH_DEFAULT = _("{help}. Default: {default}.")
AUTOMATIC = _("Automatic (default): {default}. Untick to choose yourself.")
IN_POWERS_OF_TEN = _("Shown as a power of ten; the left end means 0.")


def _row(default: object, label: str, help: str, automatic: str = "", **values: object):
    return field(default=default, metadata={"option": Option(label, help, automatic, **values)})


def _generic_models():
    """Return the table of generic models; imported late, because Slicer loads this file when it starts."""
    from ..geometry.models import GENERIC_MODELS

    return GENERIC_MODELS


@dataclass(frozen=True)
class FitOptions:
    """Options for fitting an organ; the defaults need no tuning.

    Each option is one row: its default, label, help text, the meaning of None, and the allowed values. `OPTIONS` holds
    the rows by the options' names.

    Raises
    ------
    ValueError
        If a value is not allowed, or if grey levels are given without ``levels="given"`` or the other way round.

    Notes
    -----
    In the paper's counting of a control net, the last row is the first one again, and the first and the last column are
    the poles.

    References
    ----------
    .. [1] Z. Jiang et al.: Virtual image correlation of magnetic resonance images for 3D geometric modelling of pelvic
       organs. Strain 55(3):e12305, 2019. doi:10.1111/str.12305. Its choices: :meth:`as_published`.

    Examples
    --------
    >>> import VICRegistrationLib as vic
    >>> vic.FitOptions(net=(17, 11)).tau is None
    True
    >>> vic.FitOptions.as_published().solver
    'gradient-descent'
    >>> vic.FitOptions(net=(3, 3))
    Traceback (most recent call last):
    ValueError: The control net is (3, 3); it must be two whole numbers ROWSxCOLUMNS from 5 to 65.
    """

    net: tuple[int, int] | None = _row(
        None,
        _("control net"),
        _("Rows of control points around the organ and columns from pole to pole, in the paper's counting"),
        _("9x7, 17x11 or 33x19, the finest that lowers the cost by more than noise explains"),
        limits=(5, LARGEST_NET),
        whole=True,
        pair="ROWSxCOLUMNS",
    )
    closure: str = _row(
        "smooth",
        _("closure"),
        _("How the surface closes at its seam and its poles"),
        choices={"smooth": _("Smooth (tangent plane at the poles)"), "paper": _("As published (midpoints)")},
    )
    model: str = _row(
        "automatic",
        _("generic model"),
        _("The surface that the fit starts from"),
        choices={
            "automatic": _("Automatic: an ellipsoid, or a tube where the organ is bent"),
            "ellipsoid": _("Ellipsoid"),
            "tube": _("Tube with two ends"),
        },
        known=_generic_models,
    )
    threshold: tuple[float, float] | None = _row(
        None,
        _("threshold"),
        _("Lowest and highest grey level of the organ, the same everywhere"),
        _("half-way between organ and surroundings, varying over the image with the signal"),
        limits=_GREY_LEVELS,
        pair="LOW,HIGH",
        ascending=True,
    )
    erosion: float | None = _row(
        None,
        _("erosion"),
        _("Depth of erosion of the region; cuts bridges to other tissue of up to twice this width"),
        _("2 mm, more if the region leaks, less if the organ is too thin"),
        limits=(0.0, 20.0),
        unit="mm",
    )
    dilation: float | None = _row(
        None,
        _("dilation"),
        _("How far the eroded region grows back, within the threshold"),
        _("the same as the erosion"),
        limits=(0.0, 20.0),
        unit="mm",
    )
    solver: str = _row(
        "gauss-newton",
        _("solver"),
        _("How the cost is minimised: Gauss-Newton takes tens of iterations, gradient descent hundreds"),
        choices={"gauss-newton": _("Gauss-Newton"), "gradient-descent": _("Gradient descent (as published)")},
    )
    tau: float | None = _row(
        None,
        _("edge width (tau)"),
        _("Width of the intensity profile's ramp; wider finds edges from farther away, narrower is more exact"),
        _("the width of the edge in the image, limited to 2 to 3 pixels"),
        limits=(0.01, 20.0),
        unit="mm",
    )
    profile: str = _row(
        "centered",
        _("place on the edge"),
        _("Where the surface lies on the ramp of the intensity profile"),
        choices={"centered": _("Half-way up the edge"), "paper": _("Inner foot of the edge (as published)")},
    )
    levels: str = _row(
        "local",
        _("profile level"),
        _("How the grey levels inside and outside of the edge are found"),
        choices={
            "local": _("Automatic, along the surface"),
            "organ": _("Automatic, one for the organ"),
            "given": _("Given"),
        },
    )
    inside: float | None = _row(
        None,
        _("grey level inside"),
        _("Grey level inside of the edge, if the profile level is given"),
        _("measured in the image"),
        limits=_GREY_LEVELS,
    )
    outside: float | None = _row(
        None,
        _("grey level outside"),
        _("Grey level outside of the edge, if the profile level is given"),
        _("measured in the image"),
        limits=_GREY_LEVELS,
    )
    smoothness: float | None = _row(
        None,
        _("smoothness"),
        _("Weight of the bending energy, without unit; 0 is none"),
        _("from the residuals and the number of voxels along the surface"),
        limits=(1e-8, 1.0),
        or_zero=True,
    )
    loss: str = _row(
        "squares",
        _("loss"),
        _("How residuals count; Huber's loss lowers the weight of large ones, as from small clots at the wall"),
        choices={"squares": _("By their squares (as published)"), "huber": _("Large ones less (Huber)")},
    )
    tolerance: float = _row(
        0.1,
        _("tolerance"),
        _("The fit has converged when no control point moves by more than this in an iteration"),
        limits=(0.001, 5.0),
        unit="mm",
    )
    stopping: str = _row(
        "settled",
        _("stop rule"),
        _("When a stage of the fit ends"),
        choices={
            "settled": _("At the tolerance, or when the cost settles"),
            "published": _("At the tolerance (as published)"),
        },
    )
    max_iterations: int | None = _row(
        None,
        _("iteration limit"),
        _("Largest number of iterations in each stage of the fit"),
        _("50 for Gauss-Newton, 300 for gradient descent"),
        limits=(1, 10000),
        whole=True,
    )
    boundary_weight: float = _row(
        1.0,
        _("weight of points"),
        _("Weight of boundary points against the image, without unit; 0 ignores them"),
        limits=(0.0, 10.0),
    )

    def __post_init__(self) -> None:
        """Check the values."""
        for name, option in OPTIONS.items():
            object.__setattr__(self, name, option.checked(getattr(self, name)))
        if self.levels == "given" and (self.inside is None or self.outside is None):
            msg = "The profile level is 'given', so both grey levels, inside and outside, are needed; give them too."
            raise ValueError(msg)
        if self.levels != "given" and not (self.inside is None and self.outside is None):
            msg = (
                f"A grey level inside or outside was given, but the profile level is {self.levels!r}; make it 'given', "
                "or leave the grey levels out."
            )
            raise ValueError(msg)

    def filled_in(self, **values: object) -> FitOptions:
        """Copy these options with values that a fit has chosen; they may lie outside of the limits for users.

        Parameters
        ----------
        **values
            By the options' names.

        Returns
        -------
        FitOptions
        """
        found = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(found, name, value)
        return found

    @classmethod
    def as_published(cls) -> FitOptions:
        """Make the choices of the paper (Jiang et al., Strain 2019).

        Returns
        -------
        FitOptions
            - ``net`` 9x7, section 2.1.
            - ``closure`` "paper": midpoints at the seam, poles that move with their rings, figures 2 and 3.
            - ``solver`` "gradient-descent", section 2.2, and at most 300 iterations for each stage; the paper's run
              took 140 for the scaling and about 150 for the control points (figure 16).
            - ``profile`` "paper": equation 3 puts the surface at the inner foot of the ramp, about half a ramp inside
              of the edge.
            - ``tau`` automatic: 2 to 3 pixels suit the paper's MRI.
            - ``levels`` "organ": one grey level inside and one outside, as A_max and A_min of equation 3.
            - ``smoothness`` 0: there is no bending energy.
            - ``stopping`` "published": the global scaling ends when its parameters vary by less than 0.01, the control
              points when none moves by more than ``tolerance``, a small number that the paper does not give, here
              0.01 mm.

        Notes
        -----
        Three things that the paper does not have remain: the stage on the separated region, the coarse stage before the
        fine one, and the small weights against sliding and against leaving the region.
        """
        return cls(
            net=(9, 7),
            closure="paper",
            solver="gradient-descent",
            profile="paper",
            levels="organ",
            smoothness=0.0,
            tolerance=0.01,
            stopping="published",
            max_iterations=MAX_ITERATIONS["gradient-descent"],
        )


OPTIONS: dict[str, Option] = {each.name: each.metadata["option"] for each in fields(FitOptions)}
