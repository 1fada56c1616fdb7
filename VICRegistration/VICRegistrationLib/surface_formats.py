"""Formats that a surface can be saved in, by the ending of the file's name.

``BSplineSurface.save`` looks here for what writes a format. So that `geometry` imports nothing of `export`, the package
itself, which is imported before any part of it, puts the writers in.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

# By the ending with its dot, in lower case; called as ``writer(surface, path, name=name, **choices)``.
writers: dict[str, Callable[..., None]] = {}


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
    if suffix not in writers:
        msg = f"The file {path} was asked for; surfaces are written as {', '.join(writers)}. Choose another ending."
        raise ValueError(msg)
    return writers[suffix]
