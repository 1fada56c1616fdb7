"""Reading of references: label images, meshes, and surfaces that this program has written."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from ..export.mesh_reading import READABLE_MESHES, holds_surface, is_image, read_triangles, read_vtp_record
from ..geometry.surface_file import read_surface_record
from ..imaging.labels import read_label
from ..imaging.morphology import fill_holes
from ..imaging.region import region_from_mask
from ..messages import Diagnostic
from .distances import Reference
from .reference_meshes import ReferenceMesh, closed_mesh, mesh_of_mask, pieces

# Suffixes of shapes that are neither read here nor by a reader of images.
_OTHER_SHAPES = (
    *(".step", ".stp", ".igs", ".iges", ".brep", ".3dm", ".x_t", ".off", ".3mf", ".glb", ".gltf", ".dae", ".fbx"),
    *(".vtu", ".msh", ".inp", ".med", ".unv", ".bdf", ".gii"),
)

# A label is a wall without its lumen if filling it slice by slice adds more than this share of the result. It is 0.75
# to 0.88 for the walls of seven real bladders that experts drew, and up to 0.0043 for their lumens and tumours and for
# three hippocampi.
_OPEN_WALL = 0.03
# Neighbourhood within a slice, for ndimage.label.
_IN_SLICE = np.array([[[0, 0, 0]] * 3, [[0, 1, 0], [1, 1, 1], [0, 1, 0]], [[0, 0, 0]] * 3])


@dataclass(frozen=True, eq=False)
class ReadReference:
    """A reference from a file.

    Parameters
    ----------
    reference : BSplineSurface or ReferenceMesh
        RAS mm.
    kind : {"surface", "mesh", "label image"}
    label : str
        Value and name of the label; empty for other kinds.
    diagnostics : tuple of Diagnostic
        Findings that make distances from it too large.
    notes : tuple of str
        Warnings of the reader, a sentence each.
    center : (3,) ndarray, optional
        Middle of the grid of a label image, RAS mm.
    """

    reference: Reference
    kind: str
    label: str = ""
    diagnostics: tuple[Diagnostic, ...] = ()
    notes: tuple[str, ...] = ()
    center: np.ndarray | None = None


def read_reference(
    path: str | os.PathLike,
    *,
    organ: str = "",
    label: int | str | None = None,
    largest: bool = False,
    frame: str | None = None,
) -> ReadReference:
    """Read a reference.

    Parameters
    ----------
    path : path
        A surface (.json, or .vtp with a control net), a mesh (.stl, .ply, .vtp, .vtk, .obj), or a label image: any that
        `read_image` reads, or a DICOM segmentation.
    organ : str
        Name of the organ: of several named segments, the one with this name is read.
    label : int or str, optional
        Value or name of the label, for label images.
    largest : bool
        Keep only the largest piece of a label or a mesh, with its cavities filled.
    frame : {"LPS", "RAS"}, optional
        Frame of a mesh; see :func:`read_triangles`.

    Returns
    -------
    ReadReference

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it holds no reference, the label is ambiguous, or an option does not fit the kind of file.
    """
    path = Path(path)
    if path.suffix.lower() in _OTHER_SHAPES:
        msg = f"{path} is of a kind that is not read; save it as a closed mesh ({', '.join(READABLE_MESHES)})."
        raise ValueError(msg)
    kind = _kind(path)
    unfit = {
        "--label": label is not None and kind != "label image",
        "The frame of a mesh": frame is not None and kind != "mesh",
        "--largest": largest and kind == "surface",
    }
    for option, given in unfit.items():
        if given:
            msg = f"{option} was given, which does not fit {path}: it is a {kind}. Leave it out."
            raise ValueError(msg)
    if kind == "surface":
        record = read_vtp_record(path) if path.suffix.lower() == ".vtp" else read_surface_record(path)
        return ReadReference(record.surface, kind)
    return _mesh(path, largest, frame) if kind == "mesh" else _label(path, label, organ, largest)


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix == ".json" or (suffix == ".vtp" and holds_surface(path)):
        return "surface"
    if suffix == ".vtk" and is_image(path):
        return "label image"
    return "mesh" if suffix in READABLE_MESHES else "label image"


def _mesh(path: Path, largest: bool, frame: str | None) -> ReadReference:
    try:
        mesh = closed_mesh(ReferenceMesh(*read_triangles(path, frame=frame)))
    except ValueError as error:
        msg = str(error) if str(path) in str(error) else f"{path}: {error}"
        raise ValueError(msg) from error
    parts = pieces(mesh)
    if largest:
        return ReadReference(parts[0], "mesh")
    return ReadReference(mesh, "mesh", diagnostics=_about_pieces(len(parts), str(path)))


def _label(path: Path, label: int | str | None, organ: str, largest: bool) -> ReadReference:
    notes: list[str] = []
    mask, segment = read_label(path, label, organ=organ, warn=notes.append)
    region = region_from_mask(mask, mask.array, largest_component=largest)
    pieces_found = region.diagnostics
    if largest:
        region = replace(region, mask=fill_holes(region.mask))
    else:
        name = f"{path}, label {segment}"
        pieces_found = (*_about_pieces(ndimage.label(region.mask)[1], name), *_about_hollows(region.mask, name))
    center = mask.to_ras([(mask.size - 1) / 2.0])[0]
    return ReadReference(mesh_of_mask(region.image), "label image", str(segment), pieces_found, tuple(notes), center)


def _about_pieces(count: int, reference: str) -> tuple[Diagnostic, ...]:
    """Warn of several pieces: distances from all of them are measured."""
    return () if count < 2 else (Diagnostic("reference_in_pieces", {"reference": reference, "count": count}),)


def _about_hollows(mask: np.ndarray, reference: str) -> tuple[Diagnostic, ...]:
    """Warn of cavities, from whose surfaces distances are measured too, and of a wall without its lumen."""
    count = ndimage.label(fill_holes(mask) & ~mask)[1]
    if count:
        return (Diagnostic("reference_hollow", {"reference": reference, "count": count}),)
    background, parts = ndimage.label(~np.pad(mask, ((0, 0), (1, 1), (1, 1))), structure=_IN_SLICE)
    outside = np.zeros(parts + 1, dtype=bool)
    outside[background[:, 0, 0]] = True
    share = float(1.0 - mask.sum() / np.count_nonzero(~outside[background]))
    if share < _OPEN_WALL:
        return ()
    return (Diagnostic("reference_open_wall", {"reference": reference, "share": share}),)
