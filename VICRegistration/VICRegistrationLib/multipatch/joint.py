"""Joint deformation of all organs of a model: radial basis functions as degrees of freedom of several surfaces.

The centres lie on the organs, and all organs share the centres' displacements q. A closed organ with control net P has
the parametrization P + E q with E = Pi Phi(P): Phi are the cardinal functions at its control points, Pi the projection
on nets that are closed and smooth. So one objective is the sum over all organs.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg
from scipy.spatial.distance import cdist

from ..geometry.parametrization import Parametrization, closed_organ
from ..geometry.projection import closest_points
from ..geometry.space_deformation import CardinalDeformation
from ..geometry.surface import BSplineSurface
from ..registration.cost import Objective
from ..registration.nets import grid_shape, net_of
from ..registration.sample_grid import SampledSurface, SampleGrid
from ..registration.stages import Stage, Step, iterate_stage
from .carrying import CarryingMap

# Radius of Wendland's function, mm, and centres on each organ. Half and twice of the radius change no organ of two
# known maps and of real shapes by more than 0.003 mm in the mean; with 16 centres a real vagina is 0.20 mm off in place
# of 0.08 mm.
RADIUS_MM = 80.0
CENTERS = 32
# Points of a surface among which its centres are chosen.
_CANDIDATES = (32, 20)
# Most samples of a surface: half of them change no mean by more than 0.006 mm.
_MOST_SAMPLES = (48, 30)
# Ridge of the least squares by which points slide, as a share of the mean diagonal; a hundredth of it gives the same.
_RIDGE = 1e-2
# Nugget of the map by which points slide on their surfaces, mm^2: from 0.03 to 0.3 the same. With 4 the ends of a long,
# thin vagina lose their points, and its tip is 2.5 mm off in place of 1.4 mm.
_NUGGET = 0.1
CLOSURE = "smooth"


@dataclass(frozen=True, eq=False)
class JointStep:
    """State after one iteration of the fit of all organs.

    Parameters
    ----------
    stage : str
    iteration : int
        Number of the iteration in this stage, from 1.
    cost : float
        Mean squared residual in units of the contrast, mean of the organs.
    displacement : float
        Largest displacement of a control point, mm.
    surfaces : dict of str to BSplineSurface
        The organs after this iteration, RAS mm.
    stopped_by : str
        As in :class:`.stages.Step`.
    """

    stage: str
    iteration: int
    cost: float
    displacement: float
    surfaces: dict[str, BSplineSurface]
    stopped_by: str = ""

    @property
    def converged(self) -> bool:
        """Whether the stage stopped by its stop rule."""
        return self.of(next(iter(self.surfaces))).converged

    def of(self, name: str) -> Step:
        """Return the step of one organ, with the cost of all."""
        return Step(
            self.stage, self.iteration, self.cost, self.displacement, self.surfaces[name], stopped_by=self.stopped_by
        )


def spread_centers(surfaces: Mapping[str, BSplineSurface]) -> np.ndarray:
    """Choose `CENTERS` points on every surface, each the farthest one from those before.

    Parameters
    ----------
    surfaces : mapping of str to BSplineSurface

    Returns
    -------
    (n, 3) ndarray
        RAS mm.
    """
    chosen = []
    for surface in surfaces.values():
        points = surface.points(*surface.midpoints(*_CANDIDATES))
        away = cdist(points, points.mean(axis=0)[None])[:, 0]
        own = []
        for _ in range(CENTERS):
            own.append(points[away.argmax()])
            nearest = cdist(points, own[-1][None])[:, 0]
            away = nearest if len(own) == 1 else np.minimum(away, nearest)
        chosen += own
    return np.array(chosen)


class JointSpace:
    """Closed organs with common degrees of freedom.

    Parameters
    ----------
    surfaces : mapping of str to BSplineSurface
        The organs after placement, RAS mm.

    Attributes
    ----------
    surfaces : dict of str to SampledSurface
        Each with the common degrees of freedom.
    """

    def __init__(self, surfaces: Mapping[str, BSplineSurface]) -> None:
        self.deformation = CardinalDeformation(spread_centers(surfaces), RADIUS_MM)
        self.surfaces = {name: self._sampled(surface) for name, surface in surfaces.items()}

    def _sampled(self, surface: BSplineSurface) -> SampledSurface:
        moved = sparse.csr_matrix(projected(surface, self.deformation.matrix(surface.control_net.reshape(-1, 3))))
        n = moved.shape[1]
        space = Parametrization(surface, (moved,) * 3, tuple(np.arange(n) + k * n for k in range(3)), 3 * n)
        shape = tuple(min(pair) for pair in zip(grid_shape(net_of(surface, CLOSURE)), _MOST_SAMPLES))
        return SampledSurface(space, SampleGrid.on(surface, shape), use_sparse=False)

    def nearest(self, nets: Mapping[str, np.ndarray]) -> dict[str, BSplineSurface]:
        """Fit the degrees of freedom to control nets by least squares, with equal weights of the organs.

        Parameters
        ----------
        nets : mapping of str to (n_u, n_v, 3) ndarray
            RAS mm.

        Returns
        -------
        dict of str to BSplineSurface
            RAS mm.
        """
        left, right = [], []
        for name, sampled in self.surfaces.items():
            space = sampled.parametrization
            weight = 1.0 / np.sqrt(space.matrices[0].shape[0])
            left.append(weight * space.matrices[0].toarray())
            right.append(weight * (nets[name] - space.surface.control_net).reshape(-1, 3))
        q = np.linalg.lstsq(np.vstack(left), np.vstack(right), rcond=None)[0].T.ravel()
        return {name: sampled.parametrization.deform(q) for name, sampled in self.surfaces.items()}

    def with_slid_points(self, surfaces: Mapping[str, BSplineSurface]) -> dict[str, BSplineSurface]:
        """Move points within their surfaces to where the map with the least bending energy puts them.

        Moments and nearest points place the surfaces, but hardly determine which point of the model corresponds to
        which point of a surface. On six known maps points are 1.9 mm off within their surfaces without this and 1.2 mm
        with it, and the control points of ligaments and fasciae 1.9 to 2.6 mm in place of 1.8 to 2.4 mm.

        Parameters
        ----------
        surfaces : mapping of str to BSplineSurface
            Deformed by the degrees of freedom, RAS mm.

        Returns
        -------
        dict of str to BSplineSurface
            RAS mm.
        """
        placed = {name: sampled.parametrization.surface for name, sampled in self.surfaces.items()}
        carry = CarryingMap(placed, surfaces, nugget=_NUGGET)
        starts = {name: self.surfaces[name].at(surface) for name, surface in surfaces.items()}
        wanted = []
        for name, start in starts.items():
            basis, points = _samples(start)
            _, model = _samples(self.surfaces[name])
            wanted.append((basis, closest_points(surfaces[name], carry(model)).points - points))
        return _displaced(starts, wanted)

    def run(
        self, stages: Mapping[str, Stage], surfaces: Mapping[str, BSplineSurface]
    ) -> Generator[JointStep, None, tuple[dict[str, BSplineSurface], dict[str, float]]]:
        """Run one stage for all organs, starting at surfaces, where the energies are zero.

        Parameters
        ----------
        stages : mapping of str to Stage
            The same stage of every organ.
        surfaces : mapping of str to BSplineSurface
            Deformed by the degrees of freedom, RAS mm.

        Yields
        ------
        JointStep

        Returns
        -------
        surfaces : dict of str to BSplineSurface
        costs : dict of str to float
            Cost of each organ at the end.
        """
        starts = {name: self.surfaces[name].at(surface) for name, surface in surfaces.items()}
        objectives = {name: stages[name].objective(start) for name, start in starts.items()}
        objective = Objective(
            [cost for own in objectives.values() for cost in own.costs],
            stiffness=sum(own.stiffness for own in objectives.values()),
        )
        stage = next(iter(stages.values()))
        for number, (iterate, stopped_by) in enumerate(iterate_stage(stage, objective), start=1):
            q = iterate.q
            found = {name: start.parametrization.deform(q) for name, start in starts.items()}
            cost = iterate.cost / len(stages)
            yield JointStep(stage.name, number, cost, iterate.displacement, found, stopped_by)
        return found, {name: sum(cost.sample(q).cost for cost in own.costs) for name, own in objectives.items()}


def _samples(surface: SampledSurface) -> tuple[np.ndarray, np.ndarray]:
    """Matrix from one coordinate's degrees of freedom to a surface's samples, (n, m), and the samples, (n, 3) mm."""
    motion = surface.grid.motion(surface.parametrization.matrices[0], dense=True)[0]
    return motion, surface.frame(np.zeros(surface.n_dof)).points


def _displaced(
    starts: Mapping[str, SampledSurface], wanted: list[tuple[np.ndarray, np.ndarray]]
) -> dict[str, BSplineSurface]:
    """Displace surfaces by least squares, given the matrix (n, m) and wanted displacements (n, 3) of samples, mm."""
    left = sum(matrix.T @ matrix / len(matrix) for matrix, _ in wanted)
    right = sum(matrix.T @ displacements / len(matrix) for matrix, displacements in wanted)
    ridge = _RIDGE * np.trace(left) / len(left)
    q = np.linalg.solve(left + ridge * np.eye(len(left)), right).T.ravel()
    return {name: start.parametrization.deform(q) for name, start in starts.items()}


def projected(surface: BSplineSurface, columns: np.ndarray) -> np.ndarray:
    """Project displacements of control points on those that keep an organ closed and smooth.

    Parameters
    ----------
    surface : BSplineSurface
        A closed organ.
    columns : (n_u * n_v, m) ndarray
        m displacements along one coordinate.

    Returns
    -------
    (n_u * n_v, m) ndarray
        The nearest such displacements in least squares.
    """
    free = closed_organ(surface, closure=CLOSURE).matrices[0].tocsc()
    return free @ sparse_linalg.splu((free.T @ free).tocsc()).solve(free.T @ columns)
