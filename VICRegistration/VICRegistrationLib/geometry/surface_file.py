"""Surfaces as JSON files, without loss of precision.

Schema ``vic-registration/surface``, version 1, one object with the keys

=============== ========================================================================================
``schema``      "vic-registration/surface"
``version``     1
``name``        name of the organ, may be empty
``frame``       "RAS": right, anterior, superior
``unit``        "mm"
``net``         size in the paper's counting such as "9x7", may be empty
``closure``     how seam and poles are closed, "smooth" or "paper", may be empty (an open surface)
``degrees``     [p, q]
``knots_u``     n_u + p + 1 ascending numbers
``knots_v``     n_v + q + 1 ascending numbers
``control_net`` n_u rows of n_v points [r, a, s]; ``control_net[i][j]`` is the control point p_ij
=============== ========================================================================================

Numbers have enough digits to restore the same double. Other keys are ignored.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ..files import write_text
from ..json_files import checked_content, file_bytes, json_text
from .surface import BSplineSurface
from .validity import check_place

SCHEMA = "vic-registration/surface"
VERSION = 1
_TEXTS = ("name", "net", "closure")
_KEYS = ("frame", "unit", *_TEXTS, "degrees", "knots_u", "knots_v", "control_net")


@dataclass(frozen=True, eq=False)
class SurfaceRecord:
    """Content of a surface file.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm.
    name : str
        Name of the organ.
    net : str
        Size in the paper's counting such as "9x7"; empty if unknown.
    closure : str
        "smooth" or "paper"; empty if unknown.
    """

    surface: BSplineSurface
    name: str = ""
    net: str = ""
    closure: str = ""


def write_surface(
    surface: BSplineSurface, path: str | os.PathLike, *, name: str = "", net: str = "", closure: str = ""
) -> None:
    """Write a surface as JSON, replacing the file in one step.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm.
    path : path
        File to write; its folder must exist.
    name, net, closure : str
        As in :class:`SurfaceRecord`.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "name": name,
        "frame": "RAS",
        "unit": "mm",
        "net": net,
        "closure": closure,
        "degrees": list(surface.degrees),
        "knots_u": surface.knots_u.tolist(),
        "knots_v": surface.knots_v.tolist(),
        "control_net": surface.control_net.tolist(),
    }
    write_text(path, json_text(content))


def read_surface(path: str | os.PathLike) -> BSplineSurface:
    """Read the surface of a file.

    Parameters
    ----------
    path : path
        File written by :func:`write_surface`.

    Returns
    -------
    BSplineSurface
        RAS mm.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the file is not a surface file that this version understands.
    """
    return read_surface_record(path).surface


def read_surface_record(path: str | os.PathLike) -> SurfaceRecord:
    """Read a surface with its name, net and closure.

    Parameters
    ----------
    path : path
        File written by :func:`write_surface`.

    Returns
    -------
    SurfaceRecord

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the file is not a surface file that this version understands.
    """
    path = Path(path)
    content = checked_content(
        file_bytes(path, kind="surface"), f"file {path}", kind="surface", schema=SCHEMA, version=VERSION, keys=_KEYS
    )
    for key in _TEXTS:
        if not isinstance(content[key], str):
            msg = f'The file {path} has a {key} that is not text; give text, or "" if it is unknown.'
            raise ValueError(msg)
    surface = _surface_of(content, path)
    return SurfaceRecord(surface, **{key: content[key] for key in _TEXTS})


def _surface_of(content: dict, path: Path) -> BSplineSurface:
    """Make the surface from the content of a file with a checked header; every error names the file."""
    rows = content["control_net"]
    if not (_is_list_of(rows, list) and rows and all(_is_list_of(row, list) for row in rows)):
        msg = f"The control net of {path} is not made of rows of points [r, a, s]; give n_u rows of n_v points."
        raise ValueError(msg)
    if any(len(row) != len(rows[0]) for row in rows) or any(len(point) != 3 for row in rows for point in row):
        msg = f"The control net of {path} is ragged; give rows of equal length and three coordinates per point."
        raise ValueError(msg)
    numbers = {key: content[key] for key in ("degrees", "knots_u", "knots_v")}
    numbers["control_net"] = [number for row in rows for point in row for number in point]
    for key, values in numbers.items():
        if not isinstance(values, list) or any(type(value) not in (int, float) for value in values):
            msg = f"The {key.replace('_', ' ')} of {path} holds something that is no number; give numbers only."
            raise ValueError(msg)
    if len(content["degrees"]) != 2 or any(type(degree) is not int for degree in content["degrees"]):
        msg = f"The file {path} has the degrees {content['degrees']}; give two whole numbers, in u and in v."
        raise ValueError(msg)
    try:
        surface = BSplineSurface(tuple(content["degrees"]), content["knots_u"], content["knots_v"], rows)
        check_place(surface)
    except (ValueError, OverflowError) as error:
        msg = f"The file {path} holds no surface: {error}"
        raise ValueError(msg) from error
    return surface


def _is_list_of(value: object, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(item, kind) for item in value)
