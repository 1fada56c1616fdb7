"""The cost: the difference between the virtual image of a surface and a real image, with weights and derivatives.

A sample lies at x = S(u, v) + d n(u, v). Its residual is r = I(x) - L(d), the real image minus the virtual one in units
of the organ's contrast, and the cost is the mean of r^2 over the area of the surface and over d. The derivative of r by
a degree of freedom is grad I . dS, plus d grad I . dn because the normal turns. Three quadratic energies of the
displacement are added: bending, sliding within the surface, and distance along the normal from the surface with which
the stage began. An objective is the sum of the costs of one or several images and of the energies.

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

# Huber's loss is linear for residuals beyond so many robust standard deviations.
_HUBER = 2.0
# Scaled median absolute deviation of a normal distribution.
_MAD = 1.4826
_SMALLEST_SCALE = 0.02
# Largest factor of the anchor's weight at a weak edge. Half and twice of it change the mean distances of the demo's
# organs and of four real bladders by 0.003 mm at most.
_STRONGEST_ANCHOR = 20.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Comparison of the virtual with the real image at m samples on each of n normal lines.

    Parameters
    ----------
    frame : Frame
        The surface.
    residuals : (n, m) ndarray
        In units of the organ's contrast.
    gradients : (n, m, 3) ndarray
        Of the real image, in units of the contrast per mm.
    weights : (n, m) ndarray
        They sum to 1 if all samples lie in the volume and no line's weight is lowered.
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
        """Locate the edge of the real image on each normal line.

        Returns
        -------
        slopes : (n,) ndarray
            Mean squared derivative of the image along the normal, 1/mm^2.
        offsets : (n,) ndarray
            Signed distance of the edge from the surface, to first order, mm.
        """
        along = np.einsum("nmk,nk->nm", self.gradients, self.frame.normals)
        slopes = np.mean(along**2, axis=1)
        return slopes, -np.mean(along * self.residuals, axis=1) / np.maximum(slopes, 1e-12)


@dataclass(frozen=True, eq=False)
class _ImageSamples:
    """Real image along the normals of the surface at q; independent of the levels."""

    q: np.ndarray
    frame: Frame
    values: np.ndarray
    gradients: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class _Fixed:
    """Virtual image and weights, fixed between two calls of refresh.

    Parameters
    ----------
    step : (n,) ndarray
        Level inside minus level outside on each normal line.
    grey : (n, m) ndarray
        Grey levels of the virtual image at the samples.
    contrast : float
        Unit of the residuals.
    weight : (n, 1) or (n, m) ndarray
        Of each line or sample.
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
        The intensity profile, and the rule for its levels.
    surface : SampledSurface
        The surface with its degrees of freedom, at the samples.
    depths : (m,) ndarray
        Distances d of the samples from the surface along the normal, mm, see :meth:`.IntensityProfile.depths`.
    loss : {"squares", "huber"}
        With "huber", samples with large residuals have less weight, see :func:`huber_shares`.
    share : (n,) ndarray, optional
        Factors, 0 to 1, of the normal lines' weights; 1 if not given.

    Notes
    -----
    Levels and weights depend on the surface, but are fixed while a step is computed and judged; :meth:`refresh` updates
    them. Partial volumes are computed once, for the first surface, and then move along with it. Residuals are in units
    of the organ's contrast, so that the cost is dimensionless. Samples outside of the volume have no weight. Where
    levels are estimated, a normal line that does not itself show the step between them has less weight, see
    :meth:`.VirtualImage.credibility`.
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
        self._refreshed_at = None
        self._shares = None
        self._image_samples = None

    @property
    def parametrization(self) -> Parametrization:
        """The surface's degrees of freedom."""
        return self.surface.parametrization

    # ------------------------------------------------------------------ residuals and weights

    def refresh(self, q: np.ndarray) -> None:
        """Update levels and weights for the surface at q, (n_dof,)."""
        if self._refreshed_at is not None and np.array_equal(q, self._refreshed_at):
            return
        self._refreshed_at = q.copy()
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
        if self.loss == "huber":
            samples = self.sample(q)
            shares = huber_shares(samples.residuals, samples.weights)
            self._fixed = replace(self._fixed, weight=shares * self._fixed.weight)

    def sample(self, q: np.ndarray) -> Samples:
        """Compare at q, (n_dof,), with the levels of the last refresh."""
        if self._fixed is None:
            self.refresh(q)
        fixed, image = self._fixed, self._sampled_image(q)
        residuals = np.where(image.valid, (image.values - fixed.grey) / fixed.contrast, 0.0)
        weights = np.where(image.valid, fixed.weight / len(self.depths), 0.0)
        return Samples(image.frame, residuals, image.gradients / fixed.contrast, weights)

    def steps(self) -> np.ndarray:
        """Absolute step between the levels inside and outside on each normal line, (n,) in units of the contrast."""
        return np.abs(self._fixed.step) / self._fixed.contrast

    def anchor_factors(self) -> np.ndarray:
        """Factors of the anchor's weight at q = 0, (n,): above 1 where the edge is weak or the volume ends."""
        q = np.zeros(self.surface.n_dof)
        self.refresh(q)
        factor = 1.0 / np.maximum(self.steps(), 1e-12) ** 4
        factor = np.where(self._sampled_image(q).valid.all(axis=1), factor, _STRONGEST_ANCHOR)
        return np.clip(factor, 1.0, _STRONGEST_ANCHOR)

    def _sampled_image(self, q: np.ndarray) -> _ImageSamples:
        """Sample the real image at q; cached, because an iteration starts where the last one ended."""
        if self._image_samples is None or not np.array_equal(q, self._image_samples.q):
            frame = self.surface.frame(q)
            positions = frame.along_normals(self.depths)
            self._image_samples = _ImageSamples(q.copy(), frame, *self.sampler.values_and_gradients(positions))
        return self._image_samples

    # ------------------------------------------------------------------ derivatives

    def gradient(self, samples: Samples) -> np.ndarray:
        """Half the derivative of the cost by the degrees of freedom, (n_dof,), the turning normal included."""
        weighted = samples.weights * samples.residuals
        direct = np.einsum("nm,nmk->nk", weighted, samples.gradients)
        lever = np.einsum("nm,nmk->nk", weighted * self.depths, samples.gradients)
        return self.surface.gradient(samples.frame, direct, lever)

    def hessian(self, samples: Samples):
        """Gauss-Newton approximation J' W J of half the cost's second derivative, (n_dof, n_dof).

        The derivative of the normal is left out: that changes the path, not the minimum, and would make the matrix nine
        times as expensive.
        """
        weighted = samples.weights[..., None] * samples.gradients
        return self.surface.quadratic_form(np.einsum("nma,nmb->nab", weighted, samples.gradients))

    # ------------------------------------------------------------------ energies

    def displacement_energy(self, *, tangential: float, normal: float, others: Sequence[Correlation] = ()):
        """Mean squared displacement of the surface from q = 0 as a quadratic form, (n_dof, n_dof) in mm^2.

        Parameters
        ----------
        tangential, normal : float
            Weights of the displacement within the tangent plane at q = 0 and along the normal. If levels are estimated,
            the weight along the normal varies: it is divided by the square of the voxel's length along the normal (in
            units of its shortest edge), because the surface at q = 0 comes from whole voxels and is less exact there.
            It is up to `_STRONGEST_ANCHOR` times larger where the edge is weaker than elsewhere on the organ, because a
            weak edge is easily mistaken for its neighbour, and where the volume ends.
        others : sequence of Correlation
            Of the same surface with further images. The factors of all images are averaged by the images' parts of a
            line's weight, so that no image holds the surface where another one determines it.
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
        """Sum up the energies of the displacement from q = 0, with weights as in :class:`.stages.Stage`.

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
        """Cost of another surface that the degrees of freedom reach, with the levels of the surface at q = 0."""
        self.refresh(np.zeros(self.surface.n_dof))
        return self.sample(self.parametrization.fit(surface.control_net)).cost


class Objective:
    """The function that a stage minimises: a sum of costs with common degrees of freedom, and a quadratic energy.

    Parameters
    ----------
    costs : sequence of Correlation
        One for each image of the surface, or of each of several surfaces that share their degrees of freedom.
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
        """Update the levels and weights of all images for q, (n_dof,)."""
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
        """Sum of the costs of another surface, see :meth:`Correlation.cost_of`."""
        return sum(cost.cost_of(surface) for cost in self.costs)

    def displacement(self, step: np.ndarray) -> float:
        """Largest displacement of a control point by a step of the degrees of freedom, mm."""
        largest = 0.0
        for cost in self.costs:
            parametrization = cost.parametrization
            moved = [matrix @ step[index] for matrix, index in zip(parametrization.matrices, parametrization.indices)]
            largest = max(largest, float(np.sqrt(sum(part**2 for part in moved)).max()))
        return largest

    def scales(self) -> np.ndarray:
        """Root mean square displacement of the control points by one unit of each degree of freedom, (n_dof,) mm."""
        return np.sqrt(sum(cost.parametrization.scales() ** 2 for cost in self.costs) / len(self.costs))


def huber_shares(residuals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute the factors by which Huber's loss lowers the weights of samples with large residuals.

    Parameters
    ----------
    residuals : (n, m) ndarray
        In units of the contrast.
    weights : (n, m) ndarray

    Returns
    -------
    (n, m) ndarray
        From 0 to 1.

    Notes
    -----
    Iteratively reweighted least squares (Huber, 1981): while the weights are fixed, the problem is a least-squares one.
    """
    size = np.abs(residuals)
    return np.minimum(1.0, _HUBER * _scale(size, weights) / np.maximum(size, 1e-12))


def _scale(size: np.ndarray, weights: np.ndarray) -> float:
    """Robust standard deviation of residuals, from the weighted median of their absolute values."""
    order = np.argsort(size, axis=None)
    cumulated = np.cumsum(weights.ravel()[order])
    if not cumulated[-1] > 0.0:
        return _SMALLEST_SCALE
    median = size.ravel()[order[np.searchsorted(cumulated, cumulated[-1] / 2.0)]]
    return max(_MAD * float(median), _SMALLEST_SCALE)
