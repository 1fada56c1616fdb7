"""Formats that a surface can be saved in, by the ending of the file's name.

``BSplineSurface.save`` looks here for what writes a format. So that `geometry` imports nothing of `export`, the package
itself, which is imported before any part of it, puts the writers in.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

_writers: dict[str, Callable[..., None]] = {}


def register(suffix: str, writer: Callable[..., None]) -> None:
    """Have a format written by a function.

    Parameters
    ----------
    suffix : str
        Ending of the file's name with its dot, in lower case.
    writer : callable
        Called as ``writer(surface, path, name=name, **choices)``.
    """
    _writers[suffix] = writer


def writer_of(path: str | os.PathLike) -> Callable[..., None]:
    """Find what writes a file.

    Parameters
    ----------
    path : path

    Returns
    -------
    callable

    Raises
    ------
    ValueError
        If no format has that ending.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _writers:
        msg = f"The file {path} was asked for; surfaces are written as {', '.join(_writers)}. Choose another ending."
        raise ValueError(msg)
    return _writers[suffix]
