"""What a mesh shall be like."""

from __future__ import annotations

import math
from dataclasses import dataclass

TOOLS = ("gmsh", "netgen")
MOST_PATCHES = 32


@dataclass(frozen=True)
class MeshOptions:
    """Options of a mesh.

    Parameters
    ----------
    size : float
        Largest wanted edge of an element, mm. Where the surface is strongly curved the elements are made smaller, so
        that the mesh keeps the organ's volume.
    order : {1, 2}
        Linear elements, or second-order ones with curved edges.
    tool : {"gmsh", "netgen"}
        Which program makes the mesh.
    wall : float, optional
        Thickness of the wall of hollow organs, mm: the surface is that of the lumen, the wall lies outside of it. The
        organs are solid if not given.
    patches : (around, along)
        Into how many patches each organ's surface is cut for the groups of triangles, in steps of its parameters:
        around the tube, and from pole to pole.
    time_limit : float
        Seconds after which the program is ended.
    volume_error : float, optional
        Largest relative difference between the volumes of the mesh and of the exact solid. If not given, 0.005 for
        elements of 3 mm, and with the square of the size for others, up to 0.02.

    Raises
    ------
    ValueError
        If an option makes no sense.
    """

    size: float = 3.0
    order: int = 1
    tool: str = "gmsh"
    wall: float | None = None
    patches: tuple[int, int] = (1, 1)
    time_limit: float = 600.0
    volume_error: float | None = None

    def __post_init__(self) -> None:
        """Check every option by itself."""
        _check_length("size of the elements", self.size, "3")
        if self.wall is not None:
            _check_length("thickness of the wall", self.wall, "2")
        if self.order not in (1, 2):
            msg = f"Elements of order {self.order} were asked for; choose 1 (linear) or 2."
            raise ValueError(msg)
        if self.tool not in TOOLS:
            msg = f"The mesher {self.tool!r} was asked for; choose one of {', '.join(TOOLS)}."
            raise ValueError(msg)
        if len(self.patches) != 2 or any(int(n) != n or not 1 <= n <= MOST_PATCHES for n in self.patches):
            msg = f"Patches of {self.patches} were asked for; give two whole numbers from 1 to {MOST_PATCHES}."
            raise ValueError(msg)
        if not (math.isfinite(self.time_limit) and self.time_limit > 0.0):
            msg = f"A time limit of {self.time_limit:g} s was given; give a positive number of seconds."
            raise ValueError(msg)
        if self.volume_error is None:
            object.__setattr__(self, "volume_error", min(0.005 * max(self.size / 3.0, 0.2) ** 2, 0.02))
        if not 1e-4 <= self.volume_error < 1.0:
            msg = f"A volume error of {self.volume_error:g} was asked for; give a fraction such as 0.005."
            raise ValueError(msg)


def _check_length(what: str, value: float, example: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        msg = f"A {what} of {value:g} mm was given; give a positive length such as {example}."
        raise ValueError(msg)
