"""Models of several organs as JSON files that lose no bit.

Schema ``vic-registration/model``, version 1, one object with the keys

============= ===========================================================================================
``schema``    "vic-registration/model"
``version``   1
``name``      name of the model, may be empty
``frame``     "RAS": right, anterior, superior
``unit``      "mm"
``organs``    the closed surface of each organ by its name, with the cuts that make patches of it:
              ``degrees``, ``knots_u``, ``knots_v`` and ``control_net`` as in a surface file; ``cuts_u``
              around and ``cuts_v`` from pole to pole; ``patches``, a list of names from the lower to the
              upper cut in v for each cut in u; ``points``, how many points that gives
``parts``     list of ``name``, ``kind`` ("organ", "sheet" or "cord"), ``thickness`` (mm, of a sheet, else
              null), ``estimated`` (whether the image does not show it), ``foot`` (of a cord: the patch
              that it stands on, else "")
``points``    control points [r, a, s] that belong to no organ
``patches``   list of ``name``, ``part``, ``degrees``, ``knots_u``, ``knots_v`` and ``indices``: n_u rows of
              n_v numbers of points. The patches of organs are not in it
``fixed``     numbers of points that are fixed to bone, by the name of the place
``landmarks`` places on bone [r, a, s] by their names
============= ===========================================================================================

Points are numbered from 0: those of the first organ, then of the second, ..., then ``points``. An organ's points are
those of its net after every cut was inserted as a knot as often as the degree: the pole at v_min; the rows from the
first cut in u once around, without the poles; the pole at v_max. Other keys are ignored.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..files import write_text
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_place
from ..json_files import checked_content, file_bytes, json_text
from .cuts import OrganCuts
from .model import MultiPatchModel, Part, Patch, assembled

SCHEMA = "vic-registration/model"
VERSION = 1
_KINDS = {
    "name": str,
    "organs": dict,
    "parts": list,
    "points": list,
    "patches": list,
    "fixed": dict,
    "landmarks": dict,
}
_ORGAN_KEYS = ("degrees", "knots_u", "knots_v", "control_net", "cuts_u", "cuts_v", "patches", "points")
_PART_KEYS = ("name", "kind", "thickness", "estimated", "foot")
_PATCH_KEYS = ("name", "part", "degrees", "knots_u", "knots_v", "indices")
_SHAPES = {
    (float, 1): "a list of numbers",
    (float, 2): "a list of points [r, a, s]",
    (float, 3): "rows of equal length of points [r, a, s]",
    (int, 1): "a list of whole numbers",
    (int, 2): "rows of equal length of whole numbers",
}


def write_model(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Write a model as JSON, replacing the file in one step.

    Parameters
    ----------
    model : MultiPatchModel
    path : path
        File to write; its folder must exist.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    write_text(path, model_text(model))


def model_text(model: MultiPatchModel) -> str:
    """Text of a model's file."""
    ranges = model.ranges()
    organs = {
        name: {
            "degrees": list(parent.degrees),
            "knots_u": parent.knots_u.tolist(),
            "knots_v": parent.knots_v.tolist(),
            "control_net": parent.control_net.tolist(),
            "cuts_u": model.cuts[name].u.tolist(),
            "cuts_v": model.cuts[name].v.tolist(),
            "patches": [list(column) for column in model.cuts[name].names],
            "points": ranges[name].stop - ranges[name].start,
        }
        for name, parent in model.parents.items()
    }
    patches = [
        {
            "name": patch.name,
            "part": patch.part,
            "degrees": list(patch.degrees),
            "knots_u": patch.knots[0].tolist(),
            "knots_v": patch.knots[1].tolist(),
            "indices": patch.indices.tolist(),
        }
        for patch in model.patches
        if patch.part not in model.parents
    ]
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "name": model.name,
        "frame": "RAS",
        "unit": "mm",
        "organs": organs,
        "parts": [{key: getattr(part, key) for key in _PART_KEYS} for part in model.parts],
        "points": model.points[model.first_free :].tolist(),
        "patches": patches,
        "fixed": {place: group.tolist() for place, group in model.fixed.items()},
        "landmarks": {place: list(point) for place, point in model.landmarks.items()},
    }
    return json_text(content)


def read_model(path: str | os.PathLike) -> MultiPatchModel:
    """Read a model.

    Parameters
    ----------
    path : path
        File written by :func:`write_model`.

    Returns
    -------
    MultiPatchModel

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the file is not a model file that this version understands, or holds no model.
    """
    path = Path(path)
    return model_of_text(file_bytes(path, kind="model"), f"file {path}")


def model_of_text(text: str | bytes, where: str) -> MultiPatchModel:
    """Take a model out of the text of its file.

    Parameters
    ----------
    text : str or bytes
        As of :func:`model_text`.
    where : str
        What holds it, for messages: "file pelvis.json".

    Returns
    -------
    MultiPatchModel

    Raises
    ------
    ValueError
        If the text is not that of a model that this version understands.
    """
    content = checked_content(
        text, where, kind="model", schema=SCHEMA, version=VERSION, keys=("frame", "unit", *_KINDS)
    )
    for key, kind in _KINDS.items():
        if not isinstance(content[key], kind):
            needed = {dict: "an object", list: "a list", str: "text"}[kind]
            msg = f"The key {key!r} of the {where} is not {needed}; give {needed}."
            raise ValueError(msg)
    try:
        return _model_of(content)
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        msg = f"The {where} holds no model: {error}"
        raise ValueError(msg) from error


def is_model_file(path: str | os.PathLike) -> bool:
    """Whether a file has the schema of a model at its beginning."""
    try:
        with Path(path).open("rb") as file:
            return f'"{SCHEMA}"'.encode() in file.read(200)
    except OSError:
        return False


def _model_of(content: dict) -> MultiPatchModel:
    """Build the model below a checked header."""
    parents, cuts = {}, {}
    for name, organ in content["organs"].items():
        _require(organ, _ORGAN_KEYS, f"The organ {name!r}")
        parents[name] = BSplineSurface(
            _degrees(organ, name),
            _array(organ["knots_u"], f"knots_u of {name!r}", 1),
            _array(organ["knots_v"], f"knots_v of {name!r}", 1),
            _array(organ["control_net"], f"control_net of {name!r}", 3),
        )
        check_place(parents[name])
        cuts[name] = OrganCuts(
            _array(organ["cuts_u"], f"cuts_u of {name!r}", 1),
            _array(organ["cuts_v"], f"cuts_v of {name!r}", 1),
            tuple(tuple(str(patch) for patch in column) for column in organ["patches"]),
        )
    for number, part in enumerate(content["parts"], start=1):
        _require(part, _PART_KEYS, f"Part {number}")
    for number, patch in enumerate(content["patches"], start=1):
        _require(patch, _PATCH_KEYS, f"Patch {number}")
    points = content["points"]
    model = assembled(
        parents,
        cuts,
        [Part(**{key: part[key] for key in _PART_KEYS}) for part in content["parts"]],
        free_points=_array(points, "points", 2) if points else (),
        free_patches=[_patch(patch) for patch in content["patches"]],
        fixed={place: _array(group, f"fixed points {place!r}", 1, int) for place, group in content["fixed"].items()},
        landmarks={place: _array(point, f"landmark {place!r}", 1) for place, point in content["landmarks"].items()},
        name=content["name"],
    )
    for organ, part in model.ranges().items():
        count, given = part.stop - part.start, content["organs"][organ]["points"]
        if count != given:
            msg = f"The organ {organ!r} is said to have {given} points; its net and cuts give {count}."
            raise ValueError(msg)
    return model


def _patch(entry: Mapping) -> Patch:
    name = entry["name"]
    knots = tuple(_array(entry[key], f"{key} of {name!r}", 1) for key in ("knots_u", "knots_v"))
    return Patch(
        name, entry["part"], _degrees(entry, name), knots, _array(entry["indices"], f"indices of {name!r}", 2, int)
    )


def _require(entry: object, keys: tuple[str, ...], what: str) -> None:
    if not isinstance(entry, dict):
        msg = f"{what} is no object; give its keys {', '.join(keys)}."
        raise ValueError(msg)
    missing = [key for key in keys if key not in entry]
    if missing:
        msg = f"{what} lacks {', '.join(missing)}."
        raise ValueError(msg)


def _degrees(entry: Mapping, name: str) -> tuple[int, int]:
    degrees = entry["degrees"]
    if not (isinstance(degrees, list) and len(degrees) == 2 and all(type(degree) is int for degree in degrees)):
        msg = f"{name!r} has the degrees {degrees}; give two whole numbers, in u and in v."
        raise ValueError(msg)
    return degrees[0], degrees[1]


def _array(values: object, what: str, dimensions: int, kind: type = float) -> np.ndarray:
    """Turn lists into an array of numbers, or of whole numbers, of that many dimensions."""
    try:
        array = np.array(values, dtype=float if kind is float else None)
    except (ValueError, TypeError):
        array = np.zeros(0)
    fits = array.dtype.kind == "i" if kind is int else dimensions == 1 or array.shape[-1:] == (3,)
    if array.ndim != dimensions or not array.size or not fits:
        msg = f"The {what} must be {_SHAPES[kind, dimensions]}; the file has something else there."
        raise ValueError(msg)
    return array
