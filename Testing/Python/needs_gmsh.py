"""Skipping tests where gmsh cannot be loaded."""

from __future__ import annotations

import pytest


def gmsh_or_skip():
    """Module gmsh, which needs libraries of the system too."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        pytest.skip(f"gmsh cannot be loaded: {error}")
    return gmsh
