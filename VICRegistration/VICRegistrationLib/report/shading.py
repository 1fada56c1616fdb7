"""Lit triangles in parallel projection, ready to be painted from back to front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.triangles import area_vectors
from ..geometry.triangulation import TriangleMesh

_SHININESS = 30.0
# Of the light, in the camera's frame: from above, over the viewer's left shoulder.
_LIGHT = np.array([-0.35, 0.55, 0.76])


@dataclass(frozen=True)
class Finish:
    """How much light a surface gives back.

    Parameters
    ----------
    ambient, diffuse, specular : float
        Parts of the light from everywhere, of the light that is scattered, and of the highlight.
    """

    ambient: float
    diffuse: float
    specular: float


GLOSSY = Finish(0.34, 0.68, 0.20)
# For colours that stand for numbers: without highlight, which would look like another number, and with less shade.
MATT = Finish(0.56, 0.46, 0.0)


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
    meshes: Sequence[TriangleMesh],
    colours: Sequence[Sequence[float] | np.ndarray],
    camera: Camera,
    *,
    finish: Finish = GLOSSY,
) -> tuple[np.ndarray, np.ndarray]:
    """Light the triangles that face the viewer.

    Parameters
    ----------
    meshes : sequence of TriangleMesh
        RAS mm. Small triangles look smooth.
    colours : sequence of (red, green, blue) or of (m, 3) array_like
        From 0 to 1, one for each mesh or one for each of its triangles.
    camera : Camera
    finish : Finish

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
        each = np.broadcast_to(np.asarray(colour, dtype=float), (len(mesh.triangles), 3))
        shades.append(_lit(normals[front], each[front], camera, finish))
        depths.append(places.mean(axis=1) @ camera.towards)
    order = np.argsort(np.concatenate(depths), kind="stable")
    return np.concatenate(corners)[order], np.concatenate(shades)[order]


def lit_mesh(points: np.ndarray, triangles: np.ndarray, *, smooth: bool) -> TriangleMesh:
    """Give triangles normals to be lit by.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.
    smooth : bool
        Whether the normals are those of the vertices, or each triangle's own.

    Returns
    -------
    TriangleMesh
        Each triangle with three points of its own, in the order given.
    """
    corners = points[triangles]
    normals = area_vectors(points, triangles)
    if smooth:
        flat = triangles.ravel()
        each = [np.bincount(flat, np.repeat(normals[:, k], 3), len(points)) for k in range(3)]
        normals = np.stack(each, axis=1)[flat].reshape(-1, 3, 3)
    else:
        normals = np.broadcast_to(normals[:, None], corners.shape)
    normals = normals.reshape(-1, 3)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    places = corners.reshape(-1, 3)
    return TriangleMesh(places, np.arange(len(places)).reshape(-1, 3), normals, np.zeros((len(places), 2)))


def _lit(normals: np.ndarray, colour: np.ndarray, camera: Camera, finish: Finish) -> np.ndarray:
    """Light faces of given colours (n, 3) by the model of Blinn and Phong; light reaches a little round the edge."""
    light = _LIGHT @ np.stack([camera.right, camera.up, camera.towards]) / np.linalg.norm(_LIGHT)
    half = (light + camera.towards) / np.linalg.norm(light + camera.towards)
    diffuse = np.clip(0.25 + 0.75 * (normals @ light), 0.0, 1.0)[:, None]
    specular = np.clip(normals @ half, 0.0, 1.0)[:, None] ** _SHININESS
    return np.clip(colour * (finish.ambient + finish.diffuse * diffuse) + finish.specular * specular, 0.0, 1.0)
