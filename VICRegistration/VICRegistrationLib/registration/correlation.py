"""Correlation of a virtual image with a real one: residuals, cost, analytic derivatives (equations 5 to 7).

A sample lies at x = S(u, v) + d n(u, v); its residual is r = I(x) - L(d), and the cost is the mean of r^2 over the area
of the surface and over d. Its derivative by a degree of freedom is grad I . dS plus the part of the turning normal,
d grad I . dn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..geometry.parametrization import Parametrization
from ..imaging.sampling import Sampler
from .levels import PROBE_DEPTHS, Levels
from .losses import sample_shares
from .sample_grid import SampleGrid

# Below this number of control points dense matrices are faster than sparse ones.
_DENSE_LIMIT = 400
# The same for degrees of freedom, where they are fewer than the control points.
_DENSE_DOF = 200
# How much more the surface is held where its edge is weak.
_LARGEST_DOUBT = 20.0


@dataclass(frozen=True, eq=False)
class Frame:
    """Position of the surface at the samples: points, tangents S_u and S_v, their cross product, unit normals."""

    points: np.ndarray
    tangents: tuple[np.ndarray, np.ndarray]
    cross: np.ndarray
    length: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True, eq=False)
class Samples:
    """Residuals (n, m), image gradients (n, m, 3) and weights (n, m), which sum to the share in the volume."""

    frame: Frame
    residuals: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray

    @property
    def cost(self) -> float:
        """Weighted mean of the squared residuals."""
        return float(np.vdot(self.weights, self.residuals**2))


@dataclass(frozen=True, eq=False)
class _Reading:
    """What the image says along the normals of the surface at q: all that does not depend on the levels."""

    q: np.ndarray
    frame: Frame
    values: np.ndarray
    gradients: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class _Held:
    """What is held while a step is computed: sample distances (n, m), levels, contrast, weights (n, 1) or (n, m)."""

    offsets: np.ndarray
    inside: np.ndarray
    outside: np.ndarray
    contrast: float
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class Support:
    """What each normal line of a surface says about the edge, (n,) but where told.

    Parameters
    ----------
    points, normals : (n, 3) ndarray
        Where the lines cross the surface.
    area : ndarray
        Share of the surface's area, sum 1.
    weight : ndarray
        How much of an edge the line shows, 0 to 1; 0 outside of the volume.
    variance : ndarray
        Mean squared residual, in units of the squared contrast.
    slope : ndarray
        Mean squared derivative of the image along the normal, 1/mm^2.
    offset : ndarray
        How far the line's own edge is from the surface, to first order, mm.
    """

    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray
    weight: np.ndarray
    variance: np.ndarray
    slope: np.ndarray
    offset: np.ndarray


class Correlation:
    """Compares the virtual image of a deforming surface with a real image.

    Parameters
    ----------
    sampler : Sampler
        The real image.
    parametrization : Parametrization
        How the surface deforms.
    grid : SampleGrid
        Where it is compared.
    depths : (m,) ndarray
        Distances d of the samples along the normal, in units of the ramp's width.
    ramp : (m,) ndarray
        The profile's ramp from 1 (inside) to 0 (outside) at these depths.
    levels : Levels
        Grey levels inside and outside and the width of the ramp, given or estimated from the image.
    loss : {"squares", "huber"}
        How much samples with large residuals count, see :func:`.losses.sample_shares`.
    sparse : bool, optional
        Whether to use sparse matrices; for large control nets if not given.

    Attributes
    ----------
    sparse : bool

    Notes
    -----
    Levels, widths and weights depend on the surface, but are held while a step is computed and judged;
    :meth:`refresh` brings them up to date. Residuals are in units of the organ's contrast, so that the cost is
    dimensionless.
    """

    def __init__(
        self,
        sampler: Sampler,
        parametrization: Parametrization,
        grid: SampleGrid,
        *,
        depths: np.ndarray,
        ramp: np.ndarray,
        levels: Levels,
        loss: str = "squares",
        sparse: bool | None = None,
    ):
        self.loss = loss
        self.sampler = sampler
        self.parametrization = parametrization
        self.grid = grid
        self.depths = np.asarray(depths, dtype=float)
        self.ramp = np.asarray(ramp, dtype=float)
        self.levels = levels
        flat = parametrization.surface.control_net.reshape(-1, 3)
        self._start = tuple(basis @ flat for basis in grid.bases[:3])
        self.sparse = len(flat) > _DENSE_LIMIT if sparse is None else sparse
        motions = [grid.motion(matrix, dense=not self.sparse) for matrix in parametrization.matrices]
        self._motion = tuple(zip(*motions))
        # Coordinates that move alike are computed at once.
        self._alike = all(motion is motions[0] for motion in motions)
        self._held = None
        self._settled = False
        self._fresh = None
        self._shift = None
        self._reading = None

    def restricted(self, parametrization: Parametrization, lines: np.ndarray, *, share: np.ndarray) -> Correlation:
        """Compare on some of the lines only, with the levels held now for good.

        Parameters
        ----------
        parametrization : Parametrization
            Another way to deform the same surface.
        lines : (n_lines,) ndarray of int
            Which lines of the grid, in its order.
        share : (n_lines,) ndarray
            What each keeps of its weight.

        Returns
        -------
        Correlation
            Its levels are not estimated again: neither lines nor surroundings are those of a whole organ.
        """
        grid = SampleGrid((len(lines), 1), tuple(basis[lines] for basis in self.grid.bases))
        part = Correlation(
            self.sampler,
            parametrization,
            grid,
            depths=self.depths,
            ramp=self.ramp,
            levels=self.levels,
            loss=self.loss,
            sparse=parametrization.n_dof > _DENSE_DOF,
        )
        held = self._held
        part._held = _Held(
            held.offsets[lines],
            held.inside[lines],
            held.outside[lines],
            held.contrast,
            share[:, None] * held.weight[lines],
        )
        part._settled = True
        return part

    def frame(self, q: np.ndarray) -> Frame:
        """Points, tangents and normals at the samples for degrees of freedom (n_dof,)."""
        if self._reading is not None and np.array_equal(q, self._reading.q):
            return self._reading.frame
        indices = self.parametrization.indices
        parts = []
        for start, motion in zip(self._start, self._motion):
            if self._alike:
                moved = motion[0] @ np.stack([q[index] for index in indices], axis=1)
            else:
                moved = np.stack([matrix @ q[index] for matrix, index in zip(motion, indices)], axis=1)
            parts.append(start + moved)
        points, along_u, along_v = parts
        cross = _cross(along_u, along_v)
        length = np.sqrt(np.einsum("nk,nk->n", cross, cross))
        normals = cross / np.maximum(length, 1e-12 * length.max())[:, None]
        return Frame(points, (along_u, along_v), cross, length, normals)

    def refresh(self, q: np.ndarray) -> None:
        """Bring levels, ramp widths and area weights up to date with the surface at q."""
        if self._settled or (self._fresh is not None and np.array_equal(q, self._fresh)):
            return
        self._fresh = q.copy()
        frame = self.frame(q)
        width = self.levels.width
        if self._shift is None:
            self._shift = self.levels.shifts(self._curvature(q, frame))
        shift = self._shift
        weight = frame.length / frame.length.sum()
        if self.levels.adaptive:
            # As published, the surface lies at the inner foot of the ramp and not in its middle.
            middle = (self.depths[0] + self.depths[-1]) / 2.0
            offsets = shift[:, None] + width * (PROBE_DEPTHS + middle)
            probes = self.sampler.values(_along_normals(frame, offsets))
            inside, outside = self.levels.estimate(*probes, frame.normals, frame.length, self.grid.shape)
            weight = weight * self.levels.credibility(*probes, inside, outside)
        else:
            inside = np.full(len(shift), float(self.levels.inside))
            outside = np.full(len(shift), float(self.levels.outside))
        contrast = self.levels.contrast(inside, outside, frame.length)
        self._held = _Held(shift[:, None] + width * self.depths, inside, outside, contrast, weight[:, None])
        if self.loss != "squares":
            samples = self.sample(q)
            shares = sample_shares(self.loss, samples.residuals, samples.weights)
            self._held = replace(self._held, weight=shares * self._held.weight)

    def sample(self, q: np.ndarray) -> Samples:
        """Residuals, image gradients and weights at q, with the levels held since the last refresh."""
        if self._held is None:
            self.refresh(q)
        held, seen = self._held, self._read(q)
        virtual = held.outside[:, None] + (held.inside - held.outside)[:, None] * self.ramp
        residuals = np.where(seen.valid, (seen.values - virtual) / held.contrast, 0.0)
        weights = np.where(seen.valid, held.weight / len(self.depths), 0.0)
        return Samples(seen.frame, residuals, seen.gradients / held.contrast, weights)

    def support(self, q: np.ndarray) -> Support:
        """Tell what each normal line says about the edge, with the levels brought up to date."""
        self.refresh(q)
        samples, held = self.sample(q), self._held
        frame = samples.frame
        area = frame.length / frame.length.sum()
        along = np.einsum("nmk,nk->nm", samples.gradients, frame.normals)
        slope = np.mean(along**2, axis=1)
        step = np.minimum(np.abs(held.inside - held.outside) / held.contrast, 1.0)
        return Support(
            frame.points,
            frame.normals,
            area,
            step * samples.weights.sum(axis=1) / np.maximum(area, 1e-300),
            np.mean(samples.residuals**2, axis=1),
            slope,
            -np.mean(along * samples.residuals, axis=1) / np.maximum(slope, 1e-12),
        )

    def normal_motion(self, normals: np.ndarray) -> np.ndarray:
        """Displacement of the samples along normals (n, 3) by each degree of freedom, (n, n_dof)."""
        result = np.zeros((len(normals), self.parametrization.n_dof))
        for k, index in enumerate(self.parametrization.indices):
            motion = self._motion[0][k]
            result[:, index] += normals[:, k, None] * (motion.toarray() if self.sparse else motion)
        return result

    def _read(self, q: np.ndarray) -> _Reading:
        """Sample the image at q; kept, because an iteration starts where the last one ended."""
        if self._reading is None or not np.array_equal(q, self._reading.q):
            frame = self.frame(q)
            positions = _along_normals(frame, self._held.offsets)
            self._reading = _Reading(q.copy(), frame, *self.sampler.values_and_gradients(positions))
        return self._reading

    def _curvature(self, q: np.ndarray, frame: Frame) -> np.ndarray:
        """Second derivatives of the signed distance from the surface, (n, 3, 3), 1/mm."""
        if self.levels.voxel is None:
            return np.zeros((len(frame.points), 3, 3))
        net = self.parametrization.control_net(q).reshape(-1, 3)
        uu, uv, vv = (-np.einsum("nk,nk->n", frame.normals, basis @ net) for basis in self.grid.bases[3:])
        # Dual tangents: S_u . D_u = 1, S_u . D_v = 0 and so on.
        along_u, along_v = frame.tangents
        dual_u = _cross(along_v, frame.normals) / frame.length[:, None]
        dual_v = _cross(frame.normals, along_u) / frame.length[:, None]
        mixed = dual_u[:, :, None] * dual_v[:, None, :]
        return (
            uu[:, None, None] * dual_u[:, :, None] * dual_u[:, None, :]
            + uv[:, None, None] * (mixed + mixed.transpose(0, 2, 1))
            + vv[:, None, None] * dual_v[:, :, None] * dual_v[:, None, :]
        )

    def gradient(self, samples: Samples) -> np.ndarray:
        """Half the derivative of the cost by the degrees of freedom, (n_dof,), the turning normal included."""
        weighted = samples.weights * samples.residuals
        direct = np.einsum("nm,nmk->nk", weighted, samples.gradients)
        lever = np.einsum("nm,nmk->nk", weighted * self._held.offsets, samples.gradients)
        turning_u, turning_v = _normal_terms(samples.frame, lever)
        result = np.zeros(self.parametrization.n_dof)
        for motion, part in zip(self._motion, (direct, turning_u, turning_v)):
            for k, index in enumerate(self.parametrization.indices):
                result[index] += motion[k].T @ part[:, k]
        return result

    def hessian(self, samples: Samples):
        """Gauss-Newton approximation J' W J of half the cost's second derivative, (n_dof, n_dof).

        The turning normal is left out here: it changes the path, not the minimum, and would cost nine times as much.
        """
        weighted = samples.weights[..., None] * samples.gradients
        return self.quadratic_form(np.einsum("nma,nmb->nab", weighted, samples.gradients))

    def displacement_form(self, q: np.ndarray, *, tangential: float, normal: float):
        """Mean squared displacement of the surface from q as a quadratic form, (n_dof, n_dof) in mm^2.

        Parameters
        ----------
        q : (n_dof,) ndarray
        tangential, normal : float
            Weights of the displacement within the tangent plane at q and along the normal. Where voxels are longer
            along the normal than at the finest, that along the normal is smaller by the square of how much: there the
            surface at q is known less, as it comes from whole voxels. Where the levels are estimated and differ less
            than elsewhere on the organ, it is up to `_LARGEST_DOUBT` times larger: a weak edge is easily mistaken for
            its neighbour. So it is where the volume ends: nothing else holds the surface there.
        """
        frame = self.frame(q)
        if self.levels.adaptive and normal > 0.0:
            self.refresh(q)
            step = np.abs(self._held.inside - self._held.outside)
            doubt = (self._held.contrast / np.maximum(step, 1e-12 * self._held.contrast)) ** 4
            doubt = np.where(self._read(q).valid.all(axis=1), doubt, _LARGEST_DOUBT)
            share = np.clip(doubt, 1.0, _LARGEST_DOUBT) / self.levels.blur(frame.normals) ** 2
            normal = normal * share[:, None, None]
        along = frame.normals[:, :, None] * frame.normals[:, None, :]
        area = frame.length / frame.length.sum()
        return self.quadratic_form(area[:, None, None] * (tangential * np.eye(3) + (normal - tangential) * along))

    def quadratic_form(self, outer: np.ndarray):
        """Sum over the samples of dS' M dS for symmetric matrices M (n, 3, 3), as a matrix (n_dof, n_dof)."""
        pairs = [(a, b) for a in range(3) for b in range(a, 3)]
        weights = np.stack([outer[:, a, b] for a, b in pairs], axis=1)
        motion, indices = self._motion[0], self.parametrization.indices
        if self._alike:
            blocks = self.grid.products(self.parametrization.matrices[0]).forms(weights, dense=not self.sparse)
        elif self.sparse:
            blocks = [motion[a].T @ sparse.diags(w) @ motion[b] for (a, b), w in zip(pairs, weights.T)]
        else:
            blocks = [motion[a].T @ (w[:, None] * motion[b]) for (a, b), w in zip(pairs, weights.T)]
        n_dof = self.parametrization.n_dof
        total = sparse.csc_matrix((n_dof, n_dof)) if self.sparse else np.zeros((n_dof, n_dof))
        for (a, b), block in zip(pairs, blocks):
            for rows, columns, part in ((a, b, block), (b, a, block.T))[: 1 if a == b else 2]:
                if self.sparse:
                    part = part.tocoo()
                    place = (indices[rows][part.row], indices[columns][part.col])
                    total = total + sparse.csc_matrix((part.data, place), shape=total.shape)
                else:
                    total[np.ix_(indices[rows], indices[columns])] += part
        return total

    def jacobian(self, samples: Samples) -> np.ndarray:
        """Differentiate all residuals, (n * m, n_dof), the turning normal included; large: for small nets."""
        n, m = samples.residuals.shape
        lever = self._held.offsets[..., None] * samples.gradients
        result = np.zeros((n, m, self.parametrization.n_dof))
        for depth in range(m):
            parts = (samples.gradients[:, depth], *_normal_terms(samples.frame, lever[:, depth]))
            for motion, part in zip(self._motion, parts):
                for k, index in enumerate(self.parametrization.indices):
                    matrix = motion[k].toarray() if self.sparse else motion[k]
                    result[:, depth, index] += part[:, k, None] * matrix
        return result.reshape(n * m, -1)


def _along_normals(frame: Frame, offsets: np.ndarray) -> np.ndarray:
    """Points (n, m, 3) at distances (n, m) along the normals; coordinates apart in memory, which numpy adds faster."""
    return np.moveaxis(frame.points.T[:, :, None] + offsets * frame.normals.T[:, :, None], 0, -1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (n, 3) arrays; numpy's own is several times slower."""
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _normal_terms(frame: Frame, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors t_u, t_v (n, 3) with lever . dn = t_u . dS_u + t_v . dS_v."""
    along = np.einsum("nk,nk->n", lever, frame.normals)
    tangential = (lever - along[:, None] * frame.normals) / np.maximum(frame.length, 1e-300)[:, None]
    along_u, along_v = frame.tangents
    return _cross(along_v, tangential), _cross(tangential, along_u)
