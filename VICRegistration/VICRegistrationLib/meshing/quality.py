"""How good a tetrahedral mesh is."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .elements import scaled_jacobians, volumes
from .tetrahedra import TetrahedralMesh


@dataclass(frozen=True)
class QualityReport:
    """Numbers about a mesh.

    Parameters
    ----------
    nodes, tetrahedra : int
    order : int
    inverted : int
        Elements whose Jacobian is not positive somewhere (at a node, with ten nodes).
    scaled_jacobian_min, scaled_jacobian_1_percent, scaled_jacobian_mean : float
        1 is the best, 0 is flat. See :func:`.elements.scaled_jacobians`.
    volume : float
        Of all elements, mm^3.
    volume_exact : float
        Of the exact solids, mm^3; not a number if unknown.
    volume_ratio : float
        The one divided by the other.
    groups : dict of str to dict
        For every group of tetrahedra: ``tetrahedra``, ``volume``, ``volume_exact`` and ``volume_ratio``.
    surfaces : dict of str to dict
        For every group of triangles: ``triangles`` and ``area``, mm^2.
    """

    nodes: int
    tetrahedra: int
    order: int
    inverted: int
    scaled_jacobian_min: float
    scaled_jacobian_1_percent: float
    scaled_jacobian_mean: float
    volume: float
    volume_exact: float
    volume_ratio: float
    groups: dict
    surfaces: dict

    def lines(self) -> list[str]:
        """Report for people, one fact a line."""
        kind = "linear" if self.order == 1 else "second-order"
        told = [
            f"{self.tetrahedra} {kind} tetrahedra, {self.nodes} nodes, {self.inverted} inverted",
            f"scaled Jacobian: min {self.scaled_jacobian_min:.3f}, 1 % {self.scaled_jacobian_1_percent:.3f}, "
            f"mean {self.scaled_jacobian_mean:.3f}",
        ]
        for name, group in self.groups.items():
            told.append(
                f"{name}: {group['tetrahedra']} tetrahedra, {group['volume'] / 1000.0:.2f} ml, "
                f"{100.0 * (group['volume_ratio'] - 1.0):+.3f} % of the exact solid"
            )
        told.extend(
            f"{name}: {group['triangles']} triangles, {group['area']:.0f} mm2" for name, group in self.surfaces.items()
        )
        return told

    def as_json(self) -> dict:
        """Everything as JSON keeps it: null where a number is unknown."""
        return _finite(asdict(self))


def quality(mesh: TetrahedralMesh) -> QualityReport:
    """Measure a mesh.

    Parameters
    ----------
    mesh : TetrahedralMesh

    Returns
    -------
    QualityReport
    """
    jacobian = scaled_jacobians(mesh.points, mesh.tetrahedra)
    volume = volumes(mesh.points, mesh.tetrahedra)
    groups = {}
    for name, cells in mesh.tetrahedron_groups.items():
        exact, found = mesh.exact_volumes.get(name, np.nan), float(volume[cells].sum())
        groups[name] = {
            "tetrahedra": len(cells),
            "volume": found,
            "volume_exact": float(exact),
            "volume_ratio": float(found / exact),
        }
    exact = float(sum(group["volume_exact"] for group in groups.values()))
    total = float(volume.sum())
    area = triangle_areas(mesh.points, mesh.triangles)
    return QualityReport(
        nodes=len(mesh.points),
        tetrahedra=len(mesh.tetrahedra),
        order=mesh.order,
        inverted=int(np.count_nonzero(jacobian <= 0.0)),
        scaled_jacobian_min=float(jacobian.min()),
        scaled_jacobian_1_percent=float(np.percentile(jacobian, 1)),
        scaled_jacobian_mean=float(jacobian.mean()),
        volume=total,
        volume_exact=exact,
        volume_ratio=total / exact if exact else float("nan"),
        groups=groups,
        surfaces={
            name: {"triangles": len(cells), "area": float(area[cells].sum())}
            for name, cells in mesh.triangle_groups.items()
        },
    )


def triangle_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas of triangles, (m,) mm^2; with six nodes, those of the four straight ones between the nodes."""
    if triangles.shape[1] == 6:
        parts = [triangles[:, part] for part in ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5])]
        return sum(triangle_areas(points, part) for part in parts)
    corners = points[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(cross, axis=1) / 2.0


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
