"""Lit triangles in parallel projection, ready to be painted from back to front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.triangulation import TriangleMesh

_AMBIENT, _DIFFUSE, _SPECULAR, _SHININESS = 0.34, 0.68, 0.20, 30.0
# Of the light, in the camera's frame: from above, over the viewer's left shoulder.
_LIGHT = np.array([-0.35, 0.55, 0.76])


@dataclass(frozen=True, eq=False)
class Camera:
    """Parallel projection.

    Parameters
    ----------
    right, up, towards : (3,) ndarray
        Unit vectors of the picture and from the scene to the viewer, RAS.
    """

    right: np.ndarray
    up: np.ndarray
    towards: np.ndarray

    @classmethod
    def from_direction(cls, towards: Sequence[float]) -> Camera:
        """Camera that sees the scene from a direction (RAS), with superior up."""
        towards = np.asarray(towards, dtype=float) / np.linalg.norm(towards)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        return cls(right, np.cross(towards, right), towards)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Take RAS points (..., 3) to the picture's coordinates (..., 2), mm to the right and up."""
        return np.asarray(points) @ np.stack([self.right, self.up], axis=1)


def shaded_triangles(
    meshes: Sequence[TriangleMesh], colours: Sequence[Sequence[float]], camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Light the triangles that face the viewer.

    Parameters
    ----------
    meshes : sequence of TriangleMesh
        RAS mm. Small triangles look smooth.
    colours : sequence of (red, green, blue)
        From 0 to 1, one for each mesh.
    camera : Camera

    Returns
    -------
    corners : (n, 3, 2) ndarray
        In the picture's coordinates, from the farthest to the nearest triangle.
    colours : (n, 3) ndarray
        From 0 to 1.
    """
    corners, shades, depths = [], [], []
    for mesh, colour in zip(meshes, colours):
        normals = mesh.normals[mesh.triangles].mean(axis=1)
        front = normals @ camera.towards > -0.05
        places = mesh.points[mesh.triangles[front]]
        corners.append(camera.project(places))
        shades.append(_lit(normals[front], np.asarray(colour, dtype=float), camera))
        depths.append(places.mean(axis=1) @ camera.towards)
    order = np.argsort(np.concatenate(depths), kind="stable")
    return np.concatenate(corners)[order], np.concatenate(shades)[order]


def _lit(normals: np.ndarray, colour: np.ndarray, camera: Camera) -> np.ndarray:
    """Colours (n, 3) of faces by the model of Blinn and Phong, with light that reaches a little round the edge."""
    light = _LIGHT @ np.stack([camera.right, camera.up, camera.towards]) / np.linalg.norm(_LIGHT)
    half = (light + camera.towards) / np.linalg.norm(light + camera.towards)
    diffuse = np.clip(0.25 + 0.75 * (normals @ light), 0.0, 1.0)[:, None]
    specular = np.clip(normals @ half, 0.0, 1.0)[:, None] ** _SHININESS
    return np.clip(colour * (_AMBIENT + _DIFFUSE * diffuse) + _SPECULAR * specular, 0.0, 1.0)
