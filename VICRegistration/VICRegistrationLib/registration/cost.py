"""The cost: how far the virtual image of a surface is from a real one, its weights, energies and derivatives.

A sample lies at x = S(u, v) + d n(u, v). Its residual is r = I(x) - L(d), the real image minus the virtual one in units
of the organ's contrast, and the cost is the mean of r^2 over the area of the surface and over d. Its derivative by a
degree of freedom is grad I . dS plus the part of the turning normal, d grad I . dn. Quadratic energies of the
displacement are added: bending, sliding within the surface, and leaving the surface where a stage began. An objective
is the sum of all that: over one image, or over several that show the same degrees of freedom.

Equations 4 to 7 of Jiang et al. (Strain 2019); the paper has no energies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.bending import bending_matrix
from ..geometry.parametrization import Parametrization
from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .sample_grid import Frame, SampledSurface
from .virtual_image import VirtualImage

# Residuals beyond so many scales count by their size, not by its square.
_HUBER = 2.0
# Scaled median absolute deviation of a normal distribution.
_MAD = 1.4826
_SMALLEST_SCALE = 0.02
# How much stronger the anchor is at most where the surface has a weak edge. Half and twice of it change the mean
# distances of the demo's organs and of four real bladders by 0.003 mm at most.
_STRONGEST_ANCHOR = 20.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Residuals (n, m), image gradients (n, m, 3) and weights (n, m), which sum to the share in the volume.

    Residuals and gradients are in units of the organ's contrast.
    """

    frame: Frame
    residuals: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray

    @property
    def cost(self) -> float:
        """Weighted mean of the squared residuals."""
        return float(np.vdot(self.weights, self.residuals**2))

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Find the edge that each normal line shows.

        Returns
        -------
        slopes : (n,) ndarray
            Mean squared derivative of the image along the normal, 1/mm^2.
        offsets : (n,) ndarray
            How far the edge is from the surface, to first order, mm.
        """
        along = np.einsum("nmk,nk->nm", self.gradients, self.frame.normals)
        slopes = np.mean(along**2, axis=1)
        return slopes, -np.mean(along * self.residuals, axis=1) / np.maximum(slopes, 1e-12)


@dataclass(frozen=True, eq=False)
class _Reading:
    """What the image shows along the normals of the surface at q: all that does not depend on the levels."""

    q: np.ndarray
    frame: Frame
    values: np.ndarray
    gradients: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class _Fixed:
    """What stays fixed while a step is computed.

    Parameters
    ----------
    step : (n,) ndarray
        Between the levels inside and outside on each normal line.
    grey : (n, m) ndarray
        Grey levels of the virtual image at the samples.
    contrast : float
        Unit of the residuals.
    weight : (n, 1) or (n, m) ndarray
    """

    step: np.ndarray
    grey: np.ndarray
    contrast: float
    weight: np.ndarray


class Correlation:
    """Compares the virtual image of a deforming surface with a real image.

    Parameters
    ----------
    sampler : Sampler
        The real image.
    virtual : VirtualImage
        The intensity profile, and where its levels come from.
    surface : SampledSurface
        The surface with its degrees of freedom, and where it is compared.
    depths : (m,) ndarray
        Distances d of the samples from the surface along the normal, mm, see :meth:`.IntensityProfile.depths`.
    loss : {"squares", "huber"}
        How much samples with large residuals count, see :func:`sample_shares`.
    share : (n,) ndarray, optional
        What each normal line keeps of its weight; all of it if not given.

    Notes
    -----
    Levels and weights depend on the surface, but are fixed while a step is computed and judged; :meth:`refresh` brings
    them up to date. Partial volumes are computed once, where the surface begins, and move along with it. Residuals are
    in units of the organ's contrast, so that the cost is dimensionless. Samples outside of the volume carry no weight.
    Where levels are estimated, a normal line counts as far as it shows the step between them.
    """

    def __init__(
        self,
        sampler: Sampler,
        virtual: VirtualImage,
        surface: SampledSurface,
        *,
        depths: np.ndarray,
        loss: str = "squares",
        share: np.ndarray | None = None,
    ):
        self.sampler = sampler
        self.virtual = virtual
        self.surface = surface
        self.depths = np.asarray(depths, dtype=float)
        self.loss = loss
        self.share = share
        self._fixed = None
        self._fresh = None
        self._shares = None
        self._reading = None

    @property
    def parametrization(self) -> Parametrization:
        """The surface's degrees of freedom."""
        return self.surface.parametrization

    # ------------------------------------------------------------------ residuals and weights

    def refresh(self, q: np.ndarray) -> None:
        """Bring levels and weights up to date with the surface at q."""
        if self._fresh is not None and np.array_equal(q, self._fresh):
            return
        self._fresh = q.copy()
        frame, virtual = self.surface.frame(q), self.virtual
        if self._shares is None:
            surface, axes = self.parametrization.deform(q), self.surface.grid.axes
            along_ramp = virtual.shares(surface, axes, self.depths)
            self._shares = along_ramp, virtual.shares(surface, axes, virtual.probes(along_ramp.wall))
        along_ramp, at_probes = self._shares
        weight = frame.area if self.share is None else self.share * frame.area
        if virtual.adaptive:
            probes = self.sampler.values(frame.along_normals(virtual.probes(along_ramp.wall)))
            inside, outside, behind = virtual.levels(
                *probes, at_probes, frame.normals, frame.length, self.surface.grid.shape
            )
            weight = weight * virtual.credibility(*probes, inside, outside)
        else:
            inside, outside, behind = (
                np.full(len(frame.points), float(v))
                for v in (virtual.profile.inside, virtual.profile.outside, virtual.profile.outside)
            )
        contrast = virtual.contrast(inside, outside, frame.length)
        grey = outside[:, None] + (inside - outside)[:, None] * along_ramp.inside
        if along_ramp.wall is not None:
            grey += (behind - outside)[:, None] * along_ramp.behind
        self._fixed = _Fixed(inside - outside, grey, contrast, weight[:, None])
        if self.loss != "squares":
            samples = self.sample(q)
            shares = sample_shares(self.loss, samples.residuals, samples.weights)
            self._fixed = replace(self._fixed, weight=shares * self._fixed.weight)

    def sample(self, q: np.ndarray) -> Samples:
        """Residuals, image gradients and weights at q, with the levels fixed by the last refresh."""
        if self._fixed is None:
            self.refresh(q)
        fixed, seen = self._fixed, self._read(q)
        residuals = np.where(seen.valid, (seen.values - fixed.grey) / fixed.contrast, 0.0)
        weights = np.where(seen.valid, fixed.weight / len(self.depths), 0.0)
        return Samples(seen.frame, residuals, seen.gradients / fixed.contrast, weights)

    def steps(self) -> np.ndarray:
        """Step between the levels inside and outside on each normal line, (n,) in units of the contrast."""
        return np.abs(self._fixed.step) / self._fixed.contrast

    def anchor_factors(self) -> np.ndarray:
        """How much stronger the anchor is on each normal line at q = 0 for its weak edge or the volume's end, (n,)."""
        q = np.zeros(self.surface.n_dof)
        self.refresh(q)
        factor = 1.0 / np.maximum(self.steps(), 1e-12) ** 4
        factor = np.where(self._read(q).valid.all(axis=1), factor, _STRONGEST_ANCHOR)
        return np.clip(factor, 1.0, _STRONGEST_ANCHOR)

    def _read(self, q: np.ndarray) -> _Reading:
        """Sample the image at q; kept, because an iteration starts where the last one ended."""
        if self._reading is None or not np.array_equal(q, self._reading.q):
            frame = self.surface.frame(q)
            positions = frame.along_normals(self.depths)
            self._reading = _Reading(q.copy(), frame, *self.sampler.values_and_gradients(positions))
        return self._reading

    # ------------------------------------------------------------------ derivatives

    def gradient(self, samples: Samples) -> np.ndarray:
        """Half the derivative of the cost by the degrees of freedom, (n_dof,), the turning normal included."""
        weighted = samples.weights * samples.residuals
        direct = np.einsum("nm,nmk->nk", weighted, samples.gradients)
        lever = np.einsum("nm,nmk->nk", weighted * self.depths, samples.gradients)
        return self.surface.gradient(samples.frame, direct, lever)

    def hessian(self, samples: Samples):
        """Gauss-Newton approximation J' W J of half the cost's second derivative, (n_dof, n_dof).

        The turning normal is left out here: it changes the path, not the minimum, and would cost nine times as much.
        """
        weighted = samples.weights[..., None] * samples.gradients
        return self.surface.quadratic_form(np.einsum("nma,nmb->nab", weighted, samples.gradients))

    # ------------------------------------------------------------------ energies

    def displacement_energy(self, *, tangential: float, normal: float, others: Sequence[Correlation] = ()):
        """Mean squared displacement of the surface from q = 0 as a quadratic form, (n_dof, n_dof) in mm^2.

        Parameters
        ----------
        tangential, normal : float
            Weights of the displacement within the tangent plane at q = 0 and along the normal. Where voxels are longer
            along the normal than at the finest, that along the normal is smaller by the square of how much: there the
            surface at q = 0 is known less, as it comes from whole voxels. Where the levels are estimated and differ
            less than elsewhere on the organ, it is up to `_STRONGEST_ANCHOR` times larger: a weak edge is easily
            mistaken for its neighbour. So it is where the volume ends: nothing else holds the surface there.
        others : sequence of Correlation
            Of the same surface with further images. Each counts by its part of a line's weight, so that none holds the
            surface where another one determines it.
        """
        q = np.zeros(self.surface.n_dof)
        frame = self.surface.frame(q)
        if self.virtual.adaptive and normal > 0.0:
            images = (self, *others)
            shares = [each.share for each in images] if others else [1.0]
            held = [each.anchor_factors() / each.virtual.blur(frame.normals) ** 2 for each in images]
            normal = normal * sum(share * each for share, each in zip(shares, held))[:, None, None]
        along = frame.normals[:, :, None] * frame.normals[:, None, :]
        outer = tangential * np.eye(3) + (normal - tangential) * along
        return self.surface.quadratic_form(frame.area[:, None, None] * outer)

    def energies(self, *, bending: float, sliding: float, anchor: float, others: Sequence[Correlation] = ()):
        """Energies of the displacement since q = 0, with weights as of :class:`.stages.Stage`.

        Parameters
        ----------
        bending, sliding, anchor : float
        others : sequence of Correlation
            As in :meth:`displacement_energy`.

        Returns
        -------
        (n_dof, n_dof) ndarray or sparse matrix
        """
        unit = self.virtual.profile.width**2
        total = self.displacement_energy(tangential=sliding / unit, normal=anchor / unit, others=others)
        if bending > 0.0:
            # One wave around the organ has second derivatives of (2 pi)^2 times its height.
            weight = bending / unit / (2.0 * np.pi) ** 4
            form = weight * self.parametrization.quadratic_form(bending_matrix(self.parametrization.surface))
            total = total + (form if self.surface.sparse else form.toarray())
        return total

    def cost_of(self, surface: BSplineSurface) -> float:
        """Cost of a surface that the degrees of freedom reach, with the levels found along the one at q = 0."""
        self.refresh(np.zeros(self.surface.n_dof))
        return self.sample(self.parametrization.fit(surface.control_net)).cost


class Objective:
    """What a stage minimises: costs over the same degrees of freedom, and a quadratic energy.

    Parameters
    ----------
    costs : sequence of Correlation
        All images, of one surface or of several ones that have their degrees of freedom in common.
    stiffness : (n_dof, n_dof) ndarray or sparse matrix, optional
        K of the energy (q - q_ref)' K (q - q_ref), dimensionless; none if not given.
    reference : (n_dof,) ndarray, optional
        q_ref, zero if not given.
    """

    def __init__(self, costs: Sequence[Correlation], *, stiffness=None, reference: np.ndarray | None = None):
        self.costs = tuple(costs)
        self.stiffness = stiffness
        self.n_dof = self.costs[0].surface.n_dof
        self.reference = np.zeros(self.n_dof) if reference is None else reference

    def refresh(self, q: np.ndarray) -> None:
        """Bring levels and weights of all images up to date with q, (n_dof,)."""
        for cost in self.costs:
            cost.refresh(q)

    def sample(self, q: np.ndarray) -> tuple[Samples, ...]:
        """Compare at q, (n_dof,), with every image."""
        return tuple(cost.sample(q) for cost in self.costs)

    def value(self, q: np.ndarray, samples: Sequence[Samples]) -> float:
        """Costs plus energy."""
        total = sum(part.cost for part in samples)
        if self.stiffness is None:
            return total
        offset = q - self.reference
        return total + float(offset @ (self.stiffness @ offset))

    def gradient(self, q: np.ndarray, samples: Sequence[Samples]) -> np.ndarray:
        """Half the derivative of the value, (n_dof,)."""
        gradient = sum(cost.gradient(part) for cost, part in zip(self.costs, samples))
        if self.stiffness is not None:
            gradient += self.stiffness @ (q - self.reference)
        return gradient

    def hessian(self, samples: Sequence[Samples]):
        """Half the Gauss-Newton second derivative of the value."""
        first, *others = (cost.hessian(part) for cost, part in zip(self.costs, samples))
        for hessian in (*others, *([] if self.stiffness is None else [self.stiffness])):
            first = first + hessian
        return first

    def cost_of(self, surface: BSplineSurface) -> float:
        """Costs of a surface that the degrees of freedom reach, added up, with the levels found along that at q = 0."""
        return sum(cost.cost_of(surface) for cost in self.costs)

    def displacement(self, step: np.ndarray) -> float:
        """Largest displacement of a control point by a step of the degrees of freedom, mm."""
        largest = 0.0
        for cost in self.costs:
            space = cost.parametrization
            moved = [matrix @ step[index] for matrix, index in zip(space.matrices, space.indices)]
            largest = max(largest, float(np.sqrt(sum(part**2 for part in moved)).max()))
        return largest

    def scales(self) -> np.ndarray:
        """Root mean square displacement of the control points by one unit of each degree of freedom, (n_dof,) mm."""
        return np.sqrt(sum(cost.parametrization.scales() ** 2 for cost in self.costs) / len(self.costs))


def sample_shares(loss: str, residuals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute what each sample keeps of its weight.

    Parameters
    ----------
    loss : {"squares", "huber"}
        "squares": all of it, as published (equations 4 and 7). "huber": less where the residual is large, as for
        samples that lie on another structure.
    residuals, weights : (n, m) ndarray
        In units of the contrast.

    Returns
    -------
    (n, m) ndarray
        From 0 to 1.

    Notes
    -----
    Iteratively reweighted least squares (Huber, 1981): with the weights fixed, a step is one of least squares.
    """
    size = np.abs(residuals)
    if loss == "squares":
        return np.ones_like(size)
    return np.minimum(1.0, _HUBER * _scale(size, weights) / np.maximum(size, 1e-12))


def _scale(size: np.ndarray, weights: np.ndarray) -> float:
    """Robust standard deviation of residuals by their sizes."""
    order = np.argsort(size, axis=None)
    passed = np.cumsum(weights.ravel()[order])
    if not passed[-1] > 0.0:
        return _SMALLEST_SCALE
    median = size.ravel()[order[np.searchsorted(passed, passed[-1] / 2.0)]]
    return max(_MAD * float(median), _SMALLEST_SCALE)
