"""Reading surface files as solids with names and colours."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..export.mesh_reading import read_vtp_record
from ..export.step import Solid
from ..file_names import file_key, organ_name
from ..geometry.surface import BSplineSurface
from ..geometry.surface_file import read_surface_record
from ..multipatch.file import is_model_file
from ..multipatch.vtp import holds_patches
from ..organ_colours import organ_colours, rgb
from ..transactions import recover
from .console import LOG
from .stored_results import REPORT

# Endings of files that have a control net; other files of an organ have triangles or solids.
_SUFFIXES = (".json", ".vtp")


def read_solids(paths: Sequence[str | os.PathLike]) -> tuple[Solid, ...]:
    """Read surfaces with their names, each in its organ's colour.

    Parameters
    ----------
    paths : sequence of path
        Files .json or .vtp as the program writes them. A surface without a name gets that of its file. A fit's
        report.json and models of several organs are skipped, with a line on stderr for each.

    Returns
    -------
    tuple of Solid

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If there is no file but a report, a file holds no surface, or two surfaces have one name (upper and lower case
        are one, as in files).
    """
    for folder in dict.fromkeys(Path(path).parent for path in paths):
        recover(folder)
    surfaces: dict[str, BSplineSurface] = {}
    read: dict[str, Path] = {}
    for path in map(Path, paths):
        # organs/*.json contains it as well; no organ can have its name.
        if path.name == REPORT:
            LOG.warning(f"{path} is the report of a fit and has no surface; it is skipped")
            continue
        if is_model_file(path) or holds_patches(path):
            LOG.warning(f"{path} is a model of several organs and not the surface of one; it is skipped")
            continue
        if path.is_dir():
            msg = f"{path} is a folder; give the organs' files in it, NAME.json or NAME.vtp, as fit writes them."
            raise ValueError(msg)
        if path.suffix.lower() not in _SUFFIXES:
            msg = f"{path} has no control net; give the organ's file NAME.json or NAME.vtp, as fit writes them."
            raise ValueError(msg)
        record = read_vtp_record(path) if path.suffix.lower() == ".vtp" else read_surface_record(path)
        name = record.name or path.stem
        before = read.setdefault(file_key(name), path)
        if before is not path:
            msg = f"{before} and {path} both have a surface named {name!r}; give surfaces of different organs."
            raise ValueError(msg)
        surfaces[name] = record.surface
    if not surfaces:
        msg = (
            f"{Path(paths[0]).name} has no surface; give the organ's file NAME.json or NAME.vtp, as fit writes them. "
            "Models of several organs (model.json) are for the commands model and mesh."
        )
        raise ValueError(msg)
    return colored_solids(surfaces)


def colored_solids(surfaces: Mapping[str, BSplineSurface]) -> tuple[Solid, ...]:
    """Give surfaces the colours that their organs have in pictures.

    Parameters
    ----------
    surfaces : mapping of str to BSplineSurface
        By the organs' names.

    Returns
    -------
    tuple of Solid
    """
    colours = organ_colours(list(surfaces))
    return tuple(Solid(name, surface, rgb(colours[name])) for name, surface in surfaces.items())


def file_name(name: str) -> str:
    """Check that the name of an organ can be the name of a file.

    Parameters
    ----------
    name : str

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If it cannot.
    """
    try:
        return organ_name(name)
    except ValueError as error:
        msg = f"The name of a surface cannot be that of a file: {error}."
        raise ValueError(msg) from error
