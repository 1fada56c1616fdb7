"""Documented problems of linear elasticity: a material, and what acts on an organ.

Units are mm and kPa throughout: 1 kPa = 1 mN/mm^2, so that forces are in mN and energies in mN mm = uJ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Standard gravity, m/s^2.
GRAVITY = 9.80665
_STIFFEST_KPA = 1e9


@dataclass(frozen=True)
class Material:
    """Homogeneous isotropic linear-elastic tissue.

    Parameters
    ----------
    young : float
        Young's modulus, kPa. 300 is meant for a wall at small strains; stretched far, the human bladder's has 1000 to
        4100 kPa (Martins et al., International Urogynecology Journal 22, 2011). Give your own where you know it.
    poisson : float
        Poisson's ratio, above -1 and below 0.5. Soft tissue is nearly incompressible (Fung, *Biomechanics*, 1993); 0.45
        is as near to 0.5 as displacement elements go without locking.
    density : float
        kg/m^3. 1050 is muscle's (ICRU Report 44, 1989).

    Raises
    ------
    ValueError
        If a value makes no sense.
    """

    young: float = 300.0
    poisson: float = 0.45
    density: float = 1050.0

    def __post_init__(self) -> None:
        """Check every value by itself."""
        _check_positive("Young's modulus", self.young, "kPa", 300)
        if self.young > _STIFFEST_KPA:
            msg = (
                f"A Young's modulus of {self.young:g} kPa was given, and diamond has {_STIFFEST_KPA:g}; give it in kPa."
            )
            raise ValueError(msg)
        _check_positive("density", self.density, "kg/m³", 1050)
        if not -1.0 < self.poisson < 0.5:
            msg = f"A Poisson's ratio of {self.poisson:g} was given; it lies above -1 and below 0.5, such as 0.45."
            raise ValueError(msg)

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's constants lambda and mu, kPa."""
        mu = self.young / (2.0 * (1.0 + self.poisson))
        return 2.0 * mu * self.poisson / (1.0 - 2.0 * self.poisson), mu

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Stress of a strain by Hooke's law.

        Parameters
        ----------
        strain : (..., 6) ndarray
            Components XX, YY, ZZ, XY, YZ, XZ of the tensor.

        Returns
        -------
        (..., 6) ndarray
            kPa, the same components.
        """
        lame_lambda, mu = self.lame
        stress = 2.0 * mu * strain
        stress[..., :3] += lame_lambda * strain[..., :3].sum(axis=-1, keepdims=True)
        return stress


@dataclass(frozen=True)
class SelfWeight:
    """An organ's own weight, on an elastic foundation (Winkler springs) that stands for its surroundings.

    -div sigma(u) = rho g d in the organ, sigma(u) n = -k u on its outside, sigma(u) n = 0 on the walls of cavities.

    Parameters
    ----------
    direction : (r, a, s)
        Where gravity points to, RAS, of any length. The default is that of a patient on the back.
    foundation : float
        k, kPa/mm: pressure for each mm of displacement, the same in all directions. 0.3 is that of 10 mm of fat of 3.25
        kPa (Samani, Zubovits, Plewes, Physics in Medicine and Biology 52, 2007).

    Raises
    ------
    ValueError
        If a value makes no sense.
    """

    direction: tuple[float, float, float] = (0.0, -1.0, 0.0)
    foundation: float = 0.3

    def __post_init__(self) -> None:
        """Check every value by itself."""
        _check_positive("foundation", self.foundation, "kPa/mm", 0.3)
        length = math.sqrt(sum(part * part for part in self.direction))
        if len(self.direction) != 3 or not (math.isfinite(length) and length > 0.0):
            msg = f"The direction {self.direction} was given for gravity; give three numbers R,A,S, not all 0."
            raise ValueError(msg)

    def body_force(self, material: Material) -> np.ndarray:
        """Weight of a volume, (3,) kPa/mm."""
        # 1 N/m^3 = 1e-6 kPa/mm.
        unit = np.array(self.direction) / np.linalg.norm(self.direction)
        return 1e-6 * material.density * GRAVITY * unit


@dataclass(frozen=True)
class InnerPressure:
    """A pressure in the cavity of a hollow organ.

    -div sigma(u) = 0 in the wall, sigma(u) n = -p n on the cavity's surface, sigma(u) n = -k u on the outside. With
    k = 0 nothing holds the organ, and nothing needs to, as the pressure on a closed surface has no resultant: of all
    solutions, which differ by a rigid motion, the one without mean displacement and mean rotation is taken.

    Parameters
    ----------
    pressure : float
        p, kPa; negative for suction. 1 (10 cmH2O) is that of a filling bladder in a patient on the back (5 to 20 cmH2O:
        Schäfer et al., Good urodynamic practices, Neurourology and Urodynamics 21, 2002).
    foundation : float
        k, kPa/mm, 0 for a free outside.
    surface : str, optional
        Group of triangles that the pressure acts on, instead of the surfaces of all cavities.

    Raises
    ------
    ValueError
        If a value makes no sense.
    """

    pressure: float = 1.0
    foundation: float = 0.0
    surface: str | None = None

    def __post_init__(self) -> None:
        """Check every value by itself."""
        if not math.isfinite(self.pressure) or self.pressure == 0.0:
            msg = f"A pressure of {self.pressure:g} kPa was given; give a number such as 1, which is about 10 cmH2O."
            raise ValueError(msg)
        if not (math.isfinite(self.foundation) and self.foundation >= 0.0):
            msg = f"A foundation of {self.foundation:g} kPa/mm was given; give 0 for none, or a positive number."
            raise ValueError(msg)


def _check_positive(what: str, value: float, unit: str, example: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        msg = f"A {what} of {value:g} {unit} was given; give a positive number such as {example:g}."
        raise ValueError(msg)
