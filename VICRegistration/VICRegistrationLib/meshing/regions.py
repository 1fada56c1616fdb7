"""Options of a mesh, its regions (organs or their walls), the job for gmsh, and overlaps of regions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..export.step import Solid, step_text, validate_solids
from ..geometry.surface import BSplineSurface
from ..messages import Diagnostic
from .process import MeshingError
from .sizes import SizeField, size_field
from .wall import offset_surface

_MOST_PATCHES = 32
# Largest edge in a wall, as a multiple of its thickness: longer edges make flat tetrahedra.
_LONGEST_IN_WALL = 1.5
# Relative difference of volumes above which gmsh has read the solid wrongly.
_MISREAD = 1e-3
# Volume in mm^3, and share of the region, up to which an overlap is rounding.
_ROUNDING = (1e-2, 1e-5)


@dataclass(frozen=True)
class MeshOptions:
    """Options of a mesh.

    Parameters
    ----------
    size : float
        Largest edge of an element, mm. At strongly curved surfaces elements are smaller, so that the mesh keeps the
        organ's volume.
    order : {1, 2}
        Linear elements, or second-order ones with curved edges.
    wall : float, optional
        Thickness of the wall of hollow organs, mm. The given surface is that of the lumen, and the wall lies outside of
        it. By default organs are solid.
    patches : (around, along)
        Number of patches of each organ's surface for the groups of triangles, in equal steps of its parameters: around
        the tube, and from pole to pole.
    time_limit : float
        Seconds after which gmsh is ended.
    volume_error : float, optional
        Largest relative difference between the volumes of mesh and exact solid. By default 0.005 for elements of 3 mm,
        proportional to the square of the size for others, and at most 0.02.

    Raises
    ------
    ValueError
        If an option is out of range.
    """

    size: float = 3.0
    order: int = 1
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
        if len(self.patches) != 2 or any(int(n) != n or not 1 <= n <= _MOST_PATCHES for n in self.patches):
            found = "x".join(map(str, self.patches))
            msg = f"Patches of {found} were asked for; give two whole numbers from 1 to {_MOST_PATCHES}, such as 4x3."
            raise ValueError(msg)
        if not (math.isfinite(self.time_limit) and self.time_limit > 0.0):
            msg = f"A time limit of {self.time_limit:g} s was given; give a positive number of seconds."
            raise ValueError(msg)
        if self.volume_error is None:
            object.__setattr__(self, "volume_error", min(0.005 * max(self.size / 3.0, 0.2) ** 2, 0.02))
        if not 1e-4 <= self.volume_error < 1.0:
            msg = f"A volume error of {self.volume_error:g} was asked for; give a fraction such as 0.005."
            raise ValueError(msg)


@dataclass(frozen=True, eq=False)
class Region:
    """A solid organ, or the wall of a hollow one.

    Parameters
    ----------
    name : str
        Name of the organ.
    outer : BSplineSurface
        RAS mm.
    inner : BSplineSurface, optional
        Surface of the lumen, if the region is a wall.
    """

    name: str
    outer: BSplineSurface
    inner: BSplineSurface | None = None

    @property
    def group(self) -> str:
        """Name of the group of its tetrahedra."""
        return self.name if self.inner is None else f"{self.name}_wall"

    @property
    def surfaces(self) -> dict[str, BSplineSurface]:
        """Its surfaces by the names of their groups of triangles."""
        if self.inner is None:
            return {f"{self.name}_surface": self.outer}
        return {f"{self.name}_inside": self.inner, f"{self.name}_outside": self.outer}

    @property
    def volume(self) -> float:
        """Volume before overlaps are cut off, mm^3."""
        return self.outer.volume() - (0.0 if self.inner is None else self.inner.volume())


def regions_of(solids: Sequence[Solid], options: MeshOptions) -> list[Region]:
    """Check organs, and make their regions, with walls if wanted.

    Parameters
    ----------
    solids : sequence of Solid
    options : MeshOptions

    Returns
    -------
    list of Region
        In the order of the solids: a common volume belongs to the first one.

    Raises
    ------
    ValueError
        If there is no solid, two have the same name, a surface is not valid, or a wall would pass through itself.
    """
    if not solids:
        msg = "No organ was given; give at least one surface to mesh."
        raise ValueError(msg)
    validate_solids(solids)
    if options.wall is None:
        regions = [Region(solid.name, solid.surface) for solid in solids]
    else:
        regions = [
            Region(solid.name, offset_surface(solid.surface, options.wall, name=solid.name), solid.surface)
            for solid in solids
        ]
    names = [name for region in regions for name in (region.group, *region.surfaces)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        msg = f"Two groups of the mesh would be called {twice}; give the organs different names."
        raise ValueError(msg)
    return regions


def surfaces_of(regions: Sequence[Region]) -> dict[str, BSplineSurface]:
    """Return all exact surfaces by the names of their groups of triangles."""
    return {name: surface for region in regions for name, surface in region.surfaces.items()}


def job_files(
    regions: Sequence[Region], options: MeshOptions, *, scale: float, faces: int, least_quality: float
) -> tuple[dict, dict[str, str | bytes]]:
    """Make the job of the worker, and the files that it needs.

    Parameters
    ----------
    regions : sequence of Region
    options : MeshOptions
    scale : float
        Factor on the sizes at curved surfaces, to keep the volume.
    faces : int
        Number of faces of every surface.
    least_quality : float
        Least scaled Jacobian at which the worker tries no further algorithm.

    Returns
    -------
    job : dict
    files : dict of name to content
        A STEP file for every surface, and the file of the sizes, in LPS mm.
    """
    files, described = {}, []
    for number, region in enumerate(regions):
        entry = {"name": region.name, "outer": f"outer{number}.step", "inner": None}
        files[entry["outer"]] = step_text([Solid(region.name, region.outer)], faces=faces)
        if region.inner is not None:
            entry["inner"] = f"inner{number}.step"
            files[entry["inner"]] = step_text([Solid(region.name, region.inner)], faces=faces)
        described.append(entry)
    surfaces = list(surfaces_of(regions).values())
    size = options.size if options.wall is None else min(options.size, _LONGEST_IN_WALL * options.wall)
    sizes = size_field(surfaces, size, order=options.order, volume_error=options.volume_error * scale**2)
    files["sizes.bin"] = field_file(sizes)
    job = {
        "task": "tetrahedra",
        "regions": described,
        "size": size,
        "least_quality": least_quality,
        "sizes": "sizes.bin",
    }
    return job, files


def exact_volumes(regions: Sequence[Region], measured: Sequence[Mapping]) -> dict[str, float]:
    """Return the volumes of the exact regions without what was cut off.

    Parameters
    ----------
    regions : sequence of Region
    measured : sequence of mapping
        What gmsh measured on each region's exact solid, mm^3: ``whole``, its volume before it was cut, and ``given``,
        the volumes that were cut off, by the names of the solids that they belong to.

    Returns
    -------
    dict of str to float
        By group, mm^3.

    Raises
    ------
    MeshingError
        If gmsh has read a solid wrongly.
    """
    kept = {}
    for region, volume in zip(regions, measured):
        exact = region.volume
        if not abs(volume["whole"] - exact) <= _MISREAD * exact:
            msg = (
                f"gmsh has read {region.group} with {volume['whole'] / 1000.0:.6g} ml instead of "
                f"{exact / 1000.0:.6g} ml; report this with the surface."
            )
            raise MeshingError(msg)
        kept[region.group] = exact - sum(_given(volume).values())
    return kept


def claimed_twice(regions: Sequence[Region], measured: Sequence[Mapping]) -> list[Diagnostic]:
    """Report the overlaps that were resolved."""
    return [
        Diagnostic("overlap_resolved", {"first": region.name, "second": other, "volume_mm3": float(lost)})
        for region, volume in zip(regions, measured)
        for other, lost in _given(volume).items()
    ]


def _given(volume: Mapping) -> dict[str, float]:
    """Volumes that were cut off a region, without those that are rounding."""
    least = max(_ROUNDING[0], _ROUNDING[1] * volume["whole"])
    return {other: lost for other, lost in volume["given"].items() if lost > least}


def field_file(sizes: SizeField) -> bytes:
    """Return a binary file for gmsh's field "Structured", in LPS mm."""
    turned = sizes.sizes[::-1, ::-1]
    last = sizes.origin + sizes.spacing * (np.array(sizes.sizes.shape) - 1)
    origin = np.array([-last[0], -last[1], sizes.origin[2]])
    head = np.concatenate([origin, np.full(3, sizes.spacing)]).astype("<f8").tobytes()
    return head + np.array(turned.shape, dtype="<i4").tobytes() + np.ascontiguousarray(turned, "<f8").tobytes()


def _check_length(what: str, value: float, example: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        msg = f"A {what} of {value:g} mm was given; give a positive length such as {example}."
        raise ValueError(msg)
