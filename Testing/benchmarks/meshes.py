"""Meshes of the demo's organs, of real bladders and of random organs: quality, volume, and time."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator

from bladders import bladders
from measuring import table
from random_organs import random_organ

from VICRegistrationLib.export.step import Solid
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.meshing.organ_meshes import mesh_organs
from VICRegistrationLib.meshing.process import MeshingError
from VICRegistrationLib.meshing.quality import quality
from VICRegistrationLib.meshing.regions import MeshOptions
from VICRegistrationLib.phantoms.organs import pelvic_organs
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish

# The least scaled Jacobian that a mesh shall have.
WANTED = 0.15
_SIZES_MM = (5.0, 3.0)
_RANDOM, _RANDOM_SIZE_MM = 50, 5.0


def report(*, quick: bool) -> str:
    """Mesh the organs at several sizes and orders, and many random ones."""
    if importlib.util.find_spec("gmsh") is None:
        return "  Skipped: gmsh is not installed."
    return f"{_known(quick)}\n\n{_random(10 if quick else _RANDOM)}"


def _surfaces(quick: bool) -> Iterator[tuple[str, BSplineSurface]]:
    yield from pelvic_organs().items()
    for case in [] if quick else bladders():
        yield case.name, finish(fit_organ(case.image, case.seed)).surface


def _known(quick: bool) -> str:
    rows = [["organ", "mm", "order", "elements", "inverted", "least Jacobian", "volume %", "time / linear 5 mm"]]
    for name, surface in _surfaces(quick):
        unit = None
        for size in _SIZES_MM[:1] if quick else _SIZES_MM:
            for order in (1, 2):
                start = time.perf_counter()
                found = quality(mesh_organs([Solid(name, surface)], MeshOptions(size=size, order=order)))
                seconds = time.perf_counter() - start
                unit = unit or seconds
                numbers = [f"{found.tetrahedra}", f"{found.inverted}", f"{found.scaled_jacobian_min:.3f}"]
                off = f"{100.0 * (found.volume_ratio - 1.0):+.2f}"
                rows.append([name, f"{size:g}", f"{order}", *numbers, off, f"{seconds / unit:.1f}"])
    about = "  Jacobians are scaled: 1 is the best, 0 is flat. Volume against the exact solid."
    return f"{about}\n\n{table(rows)}\n\n  The worst of all organs:\n\n{table(_worst(rows[1:]))}"


def _worst(rows: list[list[str]]) -> list[list[str]]:
    """Worst values of all organs for each order and size."""
    found = [["elements", "meshes", "inverted", "least Jacobian", "volume, lowest %", "volume, highest %"]]
    for order, size in sorted({(row[2], float(row[1])) for row in rows}):
        some = [row for row in rows if (row[2], float(row[1])) == (order, size)]
        volumes = sorted(float(row[6]) for row in some)
        name = f"{'linear' if order == '1' else 'second order'}, {size:g} mm"
        inverted, least = sum(int(row[4]) for row in some), min(float(row[5]) for row in some)
        found.append([name, str(len(some)), str(inverted), f"{least:.3f}", *(f"{volumes[i]:+.2f}" for i in (0, -1))])
    return found


def _random(count: int) -> str:
    """Mesh so many valid random organs; lists those that fail and those of poor shape."""
    poor, failed, seed, meshed = [], [], 0, 0
    while meshed + len(failed) < count:
        surface = random_organ(seed)
        seed += 1
        if check_surface(surface):
            continue
        try:
            least = quality(mesh_organs([Solid("organ", surface)], MeshOptions(size=_RANDOM_SIZE_MM)))
        except MeshingError as error:
            failed.append(f"{seed - 1} ({error})")
            continue
        meshed += 1
        if least.scaled_jacobian_min < WANTED:
            poor.append(f"{seed - 1} ({least.scaled_jacobian_min:.3f})")
    lines = [f"  {count} random valid organs at {_RANDOM_SIZE_MM:g} mm: {meshed} meshed, {len(failed)} failed, "]
    lines[0] += f"{len(poor)} with a scaled Jacobian below {WANTED:g}"
    lines += [f"  {what}: {', '.join(seeds)}" for what, seeds in (("failed", failed), ("poor", poor)) if seeds]
    return "\n".join(lines)
