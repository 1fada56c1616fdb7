"""File formats of surfaces, by the suffix.

``BSplineSurface.save`` finds the function that writes a format here. Modules are named, not imported, because
`geometry` must not import `export`.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path

# Module and function by the suffix in lower case.
_WRITERS = {
    ".json": ("geometry.surface_file", "write_surface"),
    **dict.fromkeys((".step", ".stp"), ("export.step", "write_step_surface")),
    **dict.fromkeys((".vtp", ".stl", ".ply"), ("export.mesh_files", "write_mesh")),
}


def writer_of(path: str | os.PathLike) -> Callable[..., None]:
    """Return the function that writes a file.

    Parameters
    ----------
    path : path

    Returns
    -------
    callable
        Called as ``writer(surface, path, name=name, **choices)``.

    Raises
    ------
    ValueError
        If no format has that suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        msg = f"The file {path} was asked for; surfaces are written as {', '.join(_WRITERS)}. Choose another ending."
        raise ValueError(msg)
    module, function = _WRITERS[suffix]
    return getattr(importlib.import_module(f".{module}", __package__), function)
