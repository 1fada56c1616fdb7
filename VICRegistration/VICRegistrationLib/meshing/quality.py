"""Quality of meshes of tetrahedra and of triangles."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..geometry.triangles import area_vectors
from .elements import TetrahedralMesh, flat_triangles, scaled_jacobians, volumes


@dataclass(frozen=True)
class TetrahedronQuality:
    """Sizes and quality of a mesh.

    Parameters
    ----------
    nodes, tetrahedra : int
    order : int
    inverted : int
        Elements whose Jacobian is not positive somewhere (at a node, with ten nodes).
    scaled_jacobian_min, scaled_jacobian_1_percent, scaled_jacobian_mean : float
        Least, first percentile and mean; 1 is the best, 0 is flat. See :func:`.elements.scaled_jacobians`.
    volume : float
        Volume of all elements, mm^3.
    volume_exact : float
        Volume of the exact solids, mm^3; not a number if unknown.
    volume_ratio : float
        `volume` divided by `volume_exact`.
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

    def lines(self, *, surfaces: bool = True) -> list[str]:
        """Return a report in lines, with all groups of triangles or only their number."""
        kind = "linear" if self.order == 1 else "second-order"
        lines = [
            f"{self.tetrahedra} {kind} tetrahedra, {self.nodes} nodes, {self.inverted} inverted",
            f"scaled Jacobian: min {self.scaled_jacobian_min:.3f}, 1 % {self.scaled_jacobian_1_percent:.3f}, "
            f"mean {self.scaled_jacobian_mean:.3f}",
        ]
        for name, group in self.groups.items():
            lines.append(
                f"{name}: {group['tetrahedra']} tetrahedra, {group['volume'] / 1000.0:.2f} ml, "
                f"{100.0 * (group['volume_ratio'] - 1.0):+.2f} % against the exact solid"
            )
        if not surfaces:
            return [*lines, f"{len(self.surfaces)} groups of triangles: see the .quality.json file"]
        lines.extend(
            f"{name}: {group['triangles']} triangles, {group['area']:.0f} mm2" for name, group in self.surfaces.items()
        )
        return lines

    def as_json(self) -> dict:
        """Return all values for JSON, with null for unknown numbers."""
        return _finite(asdict(self))


def quality(mesh: TetrahedralMesh) -> TetrahedronQuality:
    """Measure a mesh.

    Parameters
    ----------
    mesh : TetrahedralMesh

    Returns
    -------
    TetrahedronQuality
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
    area = _areas(mesh.points, mesh.triangles)
    return TetrahedronQuality(
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


@dataclass(frozen=True)
class TriangleQuality:
    """Quality of triangles.

    Parameters
    ----------
    triangles, nodes : int
    angle_min, angle_max : float
        Smallest and largest angle, degrees; 60 is the best for both.
    edge_min, edge_mean, edge_max : float
        Lengths of the edges, mm.
    """

    triangles: int
    nodes: int
    angle_min: float
    angle_max: float
    edge_min: float
    edge_mean: float
    edge_max: float

    def lines(self) -> list[str]:
        """Return a report in lines."""
        return [
            f"{self.triangles} triangles, {self.nodes} nodes",
            f"angles: {self.angle_min:.1f} to {self.angle_max:.1f} degrees",
            f"edges: {self.edge_min:.2f} to {self.edge_max:.2f} mm, mean {self.edge_mean:.2f} mm",
        ]


def triangle_quality(points: np.ndarray, triangles: np.ndarray) -> TriangleQuality:
    """Measure triangles.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int

    Returns
    -------
    TriangleQuality
    """
    corners = points[triangles]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = np.linalg.norm(np.cross(ahead, back), axis=2)
    angles = np.degrees(np.arctan2(cross, np.einsum("nij,nij->ni", ahead, back)))
    lengths = np.linalg.norm(ahead, axis=2)
    return TriangleQuality(
        triangles=len(triangles),
        nodes=len(np.unique(triangles)),
        angle_min=float(angles.min()),
        angle_max=float(angles.max()),
        edge_min=float(lengths.min()),
        edge_mean=float(lengths.mean()),
        edge_max=float(lengths.max()),
    )


def _areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas of triangles, (m,) mm^2; with six nodes, the sum over the four flat triangles between them."""
    flat = np.linalg.norm(area_vectors(points, flat_triangles(triangles)), axis=1)
    return flat.reshape(len(triangles), -1).sum(axis=1)


def _finite(value):
    """Replace numbers that are not finite by None, in dictionaries too."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
