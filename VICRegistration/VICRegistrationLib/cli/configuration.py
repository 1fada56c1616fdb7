"""Requests for fits: from flags, or from a configuration file for several organs.

A configuration is a JSON object with the schema ``vic-registration/organs``, version 1:

.. code-block:: json

    {
      "schema": "vic-registration/organs",
      "version": 1,
      "organs": [
        {"organ": "bladder", "seed": [[1.5, 42.0, 10.0], [3.0, 40.0, 22.0]], "threshold": [600, 1500]},
        {"organ": "rectum", "seed": [0.0, -31.0, 2.0], "erosion": 2, "dilation": 2, "net": "11x9",
         "solver": "gauss-newton", "boundary": [[12.5, -30.0, 4.0]]}
      ]
    }

Keys have the names of the flags. ``organ`` is needed, and ``seed`` or ``region``: a label image on any grid, whose path
is relative to the configuration; ``label`` chooses one of its labels. ``boundary`` and the options of a fit, see
:mod:`..registration.options`, are optional. ``also``, beside ``organs`` or in one of them, lists further stacks of the
patient: files or folders relative to the configuration.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..file_names import file_key, organ_name
from ..geometry.models import DEFAULT_NET, closed_organ
from ..json_files import checked_content, file_bytes
from ..registration.options import OPTIONS, FitOptions
from . import validators
from .stack_entries import stack_place

SCHEMA, VERSION = "vic-registration/organs", 1

# Checks of the values by their keys.
_CHECKS = {
    "organ": organ_name,
    "seed": validators.points,
    "region": validators.path,
    "label": validators.label,
    "boundary": validators.points,
    "also": validators.paths,
    **{name.replace("_", "-"): option.read for name, option in OPTIONS.items()},
}


@dataclass(frozen=True)
class OrganRequest:
    """One organ to be fitted.

    Parameters
    ----------
    name : str
        Name of the organ and of its files.
    seeds : tuple of (r, a, s)
        Points in the organ, RAS mm.
    options : FitOptions
    boundary : tuple of (r, a, s)
        Points on the wall, RAS mm; may be empty.
    region : str, optional
        Label image of the organ; without it, the organ is separated by its seeds.
    label : str, optional
        Value or name of the label.
    also : tuple of str
        Files or folders of further stacks.
    """

    name: str
    seeds: tuple[tuple[float, float, float], ...]
    options: FitOptions
    boundary: tuple[tuple[float, float, float], ...] = ()
    region: str | None = None
    label: str | None = None
    also: tuple[str, ...] = ()


def files_of(requests: Sequence[OrganRequest]) -> list[str]:
    """Label images and further stacks that requests need, each once."""
    regions = (request.region for request in requests if request.region is not None)
    return list(dict.fromkeys([*regions, *(stack_place(each)[0] for request in requests for each in request.also)]))


def organ_request(
    name: str,
    seeds: Sequence[Sequence[float]],
    *,
    boundary: Sequence[Sequence[float]] | None = None,
    region: str | None = None,
    label: str | None = None,
    also: Sequence[str] | None = None,
    **options,
) -> OrganRequest:
    """Make a request; options that cannot be used are refused before an image is read.

    Parameters
    ----------
    name : str
    seeds : sequence of (r, a, s)
        RAS mm.
    boundary : sequence of (r, a, s), optional
        RAS mm.
    region, label, also : optional
        See :class:`OrganRequest`.
    **options
        Fields of :class:`..registration.options.FitOptions`; those that are None are left to their defaults.

    Returns
    -------
    OrganRequest

    Raises
    ------
    ValueError
        If an option is out of range, the net is too small, or a region is given with seeds or options of a separation.
    """
    _check_region(name, region, {"seed": seeds or None, **options})
    try:
        chosen = FitOptions(**{key: value for key, value in options.items() if value is not None})
        closed_organ(chosen.net or DEFAULT_NET, closure=chosen.closure)
    except ValueError as error:
        msg = f"{name}: {error}"
        raise ValueError(msg) from error
    return OrganRequest(name, _points(seeds), chosen, _points(boundary or ()), region, label, tuple(also or ()))


def _check_region(name: str, region: str | None, options: Mapping[str, object]) -> None:
    """Refuse seeds and options of a separation beside a region."""
    own = [word for word in ("seed", "threshold", "erosion", "dilation") if options.get(word) is not None]
    if region is not None and own:
        msg = f"{name}: the region {region} is taken as it is, but its {own[0]} was given too; leave one of them out."
        raise ValueError(msg)


def _points(points: Sequence[Sequence[float]]) -> tuple[tuple[float, float, float], ...]:
    return tuple(tuple(point) for point in points)


def read_requests(path: str | os.PathLike, *, defaults: Mapping[str, object] | None = None) -> tuple[OrganRequest, ...]:
    """Read a configuration file.

    Parameters
    ----------
    path : path
        File of the schema above.
    defaults : mapping, optional
        Options for organs that do not set them.

    Returns
    -------
    tuple of OrganRequest

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not of the schema; the message names the organ and the key.
    """
    path = Path(path)
    content = checked_content(
        file_bytes(path, kind="configuration"),
        f"configuration {path}",
        kind="configuration",
        schema=SCHEMA,
        version=VERSION,
    )
    entries, defaults = _entries(content, path), dict(defaults or {})
    stacks = _stacks(content, path)
    if stacks:
        defaults["also"] = [*stacks, *(defaults.get("also") or ())]
    requests = tuple(
        _request(entry, f"{path}, organ {number}", defaults, path.parent)
        for number, entry in enumerate(entries, start=1)
    )
    names = [file_key(request.name) for request in requests]
    twice = sorted({request.name for request in requests if names.count(file_key(request.name)) > 1})
    if twice:
        msg = f"The configuration {path} has {', '.join(twice)} twice (upper and lower case count as one); rename one."
        raise ValueError(msg)
    return requests


def _entries(content: Mapping[str, object], path: Path) -> list:
    """Entries of the organs."""
    unknown = sorted(set(content) - {"schema", "version", "organs", "also"})
    if unknown:
        msg = f"The configuration {path} has the unknown key {unknown[0]!r}; use schema, version, organs and also."
        raise ValueError(msg)
    organs = content.get("organs")
    if not isinstance(organs, list) or not organs:
        msg = f"The configuration {path} lists no organs; give a list of one or more under 'organs'."
        raise ValueError(msg)
    return organs


def _stacks(content: Mapping[str, object], path: Path) -> list[str]:
    """Further stacks of all organs, relative to the configuration."""
    try:
        return [str(path.parent / name) for name in validators.paths(content.get("also", []))]
    except ValueError as error:
        msg = f"The configuration {path}, key 'also': {error}."
        raise ValueError(msg) from error


def _request(entry: object, where: str, defaults: Mapping[str, object], folder: Path) -> OrganRequest:
    """Request of one entry of the list."""
    if not isinstance(entry, dict):
        msg = f"{where}: {entry!r} was given; an organ is an object with the keys organ and seed."
        raise ValueError(msg)
    named = {}
    for word, value in entry.items():
        if word not in _CHECKS:
            close = difflib.get_close_matches(word, _CHECKS, n=1)
            similar = f" (similar: {close[0]})" if close else ""
            msg = f"{where}: the key {word!r} is unknown{similar}; use {', '.join(_CHECKS)}."
            raise ValueError(msg)
        try:
            named[word.replace("-", "_")] = _CHECKS[word](value)
        except ValueError as error:
            msg = f"{where}, key {word!r}: {str(error).rstrip('.')}."
            raise ValueError(msg) from error
    if "region" in named:
        named["region"] = str(folder / named["region"])
    if "also" in named:
        named["also"] = [str(folder / name) for name in named["also"]]
    asked = {**defaults, **named}
    if "seed" in named:
        # An organ's own seeds replace a region that is given for all organs.
        asked["region"] = named.get("region")
    if asked.get("label") is not None and asked.get("region") is None:
        msg = f"{where}: the key 'label' was given without 'region', which it belongs to; give both."
        raise ValueError(msg)
    starts = bool(asked.get("seed")) or asked.get("region") is not None
    missing = [word for word, there in (("organ", "organ" in named), ("seed", starts)) if not there]
    if missing:
        msg = f"{where}: the key {missing[0]!r} is missing; an organ needs organ and seed, or organ and region."
        raise ValueError(msg)
    try:
        return organ_request(asked.pop("organ"), asked.pop("seed", None) or (), **asked)
    except ValueError as error:
        msg = f"{where}, {error}"
        raise ValueError(msg) from error
