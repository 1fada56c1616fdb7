"""Shapes of a STEP file: instances in the syntax of ISO 10303-21, patches of a surface, and solids of these."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..frames import RAS_TO_LPS
from ..geometry import bspline
from ..geometry.surface import BSplineSurface


class Entities:
    """Numbered instances of a file, in the order in which they are added."""

    def __init__(self) -> None:
        self._instances: list[str] = []
        self._points: dict[tuple[float, ...], str] = {}

    def add(self, instance: str) -> str:
        """Add an instance, such as ``VERTEX_POINT('',#3)``; returns its reference, such as ``#4``."""
        self._instances.append(instance)
        return f"#{len(self._instances)}"

    def point(self, coordinates: Sequence[float]) -> str:
        """Add a point unless there is an equal one; returns its reference."""
        key = tuple(float(number) for number in coordinates)
        if key not in self._points:
            self._points[key] = self.add(f"CARTESIAN_POINT('',{listed(real(number) for number in key)})")
        return self._points[key]

    def text(self) -> str:
        """Return all instances, one a line."""
        return "".join(f"#{number}={instance};\n" for number, instance in enumerate(self._instances, start=1))


def listed(items: Iterable[object]) -> str:
    """Return a list of values or references as text."""
    return f"({','.join(str(item) for item in items)})"


def real(number: float) -> str:
    """Return the shortest decimal that is read as the same double, in the syntax of Part 21: a point, a capital E."""
    number = float(number)
    if not math.isfinite(number):
        msg = f"The number {number} cannot be written; give finite numbers."
        raise ValueError(msg)
    mantissa, _, exponent = repr(number).partition("e")
    mantissa = mantissa[:-1] if mantissa.endswith(".0") else mantissa
    mantissa += "" if "." in mantissa else "."
    return f"{mantissa}E{int(exponent)}" if exponent else mantissa


def string(text: str) -> str:
    """Return quoted text; letters that are not printable ASCII become their code points in hexadecimal."""
    parts, run = [], []
    for letter in [*text, None]:
        plain = letter is not None and " " <= letter <= "~"
        if run and (letter is None or plain):
            parts.append(_encoded(run))
            run = []
        if plain:
            parts.append({"'": "''", "\\": "\\\\"}.get(letter, letter))
        elif letter is not None:
            run.append(letter)
    return f"'{''.join(parts)}'"


def _encoded(letters: Sequence[str]) -> str:
    r"""Write letters as ``\X2\...\X0\``, or as ``\X4\...\X0\`` where one of them needs more than 16 bits."""
    # Lone surrogates, by which Python keeps bytes that are not UTF-8, become the replacement character.
    codes = [0xFFFD if 0xD800 <= ord(letter) <= 0xDFFF else ord(letter) for letter in letters]
    width, control = (8, "X4") if max(codes) > 0xFFFF else (4, "X2")
    digits = "".join(f"{code:0{width}X}" for code in codes)
    return f"\\{control}\\{digits}\\X0\\"


# ------------------------------------------------------------------ patches


def patches(surface: BSplineSurface, number: int = 1) -> tuple[BSplineSurface, ...]:
    """Cut a surface around its tube into strips from pole to pole.

    Parameters
    ----------
    surface : BSplineSurface
    number : int
        Number of strips. Cuts are at knots if there are enough.

    Returns
    -------
    tuple of BSplineSurface
        With clamped knots, in order around the tube: the last row of a control net is the first row of the next one. A
        single strip of a surface with clamped knots is that surface, bit for bit.

    Raises
    ------
    ValueError
        If the number is not positive, or the surface may be discontinuous at a knot.

    Notes
    -----
    Knots are inserted (Boehm's algorithm) until the control net interpolates the surface along the cuts, so that the
    strips together are the same surface. Its poles stay: an edge of each strip at a pole is one point.
    """
    if int(number) != number or number < 1:
        msg = f"{number} faces were asked for; give a whole number of at least 1."
        raise ValueError(msg)
    for axis, knots in enumerate(surface.knots):
        _check_multiplicities(surface.degrees[axis], knots)
    low_v, high_v = surface.domain[1]
    cuts = _cuts(surface.span_limits(0), int(number))
    whole = surface.insert_knots(
        u=missing_knots(surface.degrees[0], surface.knots_u, cuts),
        v=missing_knots(surface.degrees[1], surface.knots_v, [low_v, high_v]),
    )
    knots_v, columns = clamped_piece(whole.degrees[1], whole.knots_v, low_v, high_v)
    strips = []
    for low, high in zip(cuts[:-1], cuts[1:]):
        knots_u, rows = clamped_piece(whole.degrees[0], whole.knots_u, low, high)
        strips.append(BSplineSurface(whole.degrees, knots_u, knots_v, whole.control_net[rows, columns]))
    return tuple(strips)


def _check_multiplicities(degree: int, knots: np.ndarray) -> None:
    """Refuse knots at which the surface may be discontinuous."""
    values, counts = np.unique(knots, return_counts=True)
    low, high = bspline.domain(degree, knots)
    torn = values[(counts > degree) & (values > low) & (values < high)]
    if len(torn):
        msg = f"The knot {torn[0]:g} has a multiplicity above the degree {degree}; the surface must hold together."
        raise ValueError(msg)


def _cuts(limits: np.ndarray, number: int) -> np.ndarray:
    """Parameters of the cuts, both ends included: spread over the knot spans, at knots if there are enough."""
    positions = np.arange(number + 1) * (len(limits) - 1) / number
    if number < len(limits):
        return limits[np.rint(positions).astype(int)]
    return np.interp(positions, np.arange(len(limits)), limits)


def missing_knots(degree: int, knots: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Knots to insert so that the multiplicity of each cut is at least the degree."""
    return np.concatenate([np.repeat(cut, max(degree - np.count_nonzero(knots == cut), 0)) for cut in cuts])


def clamped_piece(degree: int, knots: np.ndarray, low: float, high: float) -> tuple[np.ndarray, slice]:
    """Clamped knots and range of control points of a spline between two knots whose multiplicity is the degree."""
    first = int(np.searchsorted(knots, low, side="right")) - 1
    last = int(np.searchsorted(knots, high, side="left"))
    clamped = np.concatenate([np.repeat(low, degree + 1), knots[first + 1 : last], np.repeat(high, degree + 1)])
    return clamped, slice(first - degree, last)


# ------------------------------------------------------------------ solids


def add_solid(entities: Entities, name: str, strips: Sequence[BSplineSurface]) -> str:
    """Add the solid bounded by strips from pole to pole.

    Parameters
    ----------
    entities : Entities
    name : str
    strips : sequence of BSplineSurface
        RAS mm, clamped knots, normals outward, in order around the tube; a single strip has a seam.

    Returns
    -------
    str
        Reference to the solid.

    Notes
    -----
    An edge runs along the first row of every strip from pole to pole. A face is bounded by the edge of the next strip
    and, backwards, its own; a single strip by its seam in both directions. They meet at the poles, which by ISO
    10303-42 need no edge.
    """
    # Adding zero turns -0.0 into 0.0.
    nets = [strip.control_net * RAS_TO_LPS + 0.0 for strip in strips]
    surfaces = [add_surface(entities, strip, net, closed=len(strips) == 1) for strip, net in zip(strips, nets)]
    edges = _add_edges(entities, strips, nets, surfaces)
    faces = []
    for number, surface in enumerate(surfaces):
        right = entities.add(f"ORIENTED_EDGE('',*,*,{edges[(number + 1) % len(edges)]},.T.)")
        left = entities.add(f"ORIENTED_EDGE('',*,*,{edges[number]},.F.)")
        loop = entities.add(f"EDGE_LOOP('',({right},{left}))")
        bound = entities.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        faces.append(entities.add(f"ADVANCED_FACE({string(name)},({bound}),{surface},.T.)"))
    shell = entities.add(f"CLOSED_SHELL({string(name)},{listed(faces)})")
    return entities.add(f"MANIFOLD_SOLID_BREP({string(name)},{shell})")


def add_surface(entities: Entities, strip: BSplineSurface, net: np.ndarray, *, closed: bool) -> str:
    """Add the surface of a patch with a given net, LPS mm; `closed` if its last row is its first one."""
    (knots_u, multiplicities_u), (knots_v, multiplicities_v) = knots_text(strip.knots_u), knots_text(strip.knots_v)
    rows = listed(listed(entities.point(point) for point in row) for row in net)
    return entities.add(
        f"B_SPLINE_SURFACE_WITH_KNOTS('',{strip.degrees[0]},{strip.degrees[1]},{rows},.UNSPECIFIED.,"
        f"{'.T.' if closed else '.F.'},.F.,.F.,{multiplicities_u},{multiplicities_v},{knots_u},{knots_v},.UNSPECIFIED.)"
    )


def _add_edges(entities: Entities, strips, nets, surfaces) -> list[str]:
    """Add an edge along the first row of every strip, where the strip before it ends."""
    ends = [entities.add(f"VERTEX_POINT('',{entities.point(nets[0][0, end])})") for end in (0, -1)]
    plane = add_parameter_plane(entities)
    kind = "SEAM_CURVE" if len(strips) == 1 else "SURFACE_CURVE"
    edges = []
    for number, (strip, net) in enumerate(zip(strips, nets)):
        curve = add_curve(entities, strip.degrees[1], strip.knots_v, net[0])
        # Also as lines in the parameters of both faces, which readers would approximate otherwise.
        before = add_line(entities, surfaces[number - 1], (strips[number - 1].domain[0][1], 0.0), (0.0, 1.0), plane)
        own = add_line(entities, surfaces[number], (strip.domain[0][0], 0.0), (0.0, 1.0), plane)
        curve = entities.add(f"{kind}('',{curve},({before},{own}),.CURVE_3D.)")
        edges.append(entities.add(f"EDGE_CURVE('',{ends[0]},{ends[1]},{curve},.T.)"))
    return edges


def add_curve(entities: Entities, degree: int, knots: np.ndarray, points: np.ndarray) -> str:
    """Add a B-spline curve with control points (n, 3), LPS mm."""
    values, multiplicities = knots_text(knots)
    row = listed(entities.point(point) for point in points)
    return entities.add(
        f"B_SPLINE_CURVE_WITH_KNOTS('',{degree},{row},.UNSPECIFIED.,.F.,.F.,{multiplicities},{values},.UNSPECIFIED.)"
    )


def add_parameter_plane(entities: Entities) -> str:
    """Add the context of curves in the parameters of surfaces."""
    return entities.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('2D SPACE',''))"
    )


def add_line(
    entities: Entities, surface: str, origin: tuple[float, float], step: tuple[float, float], plane: str
) -> str:
    """Add a line in the parameters of a surface: its start, and the step per unit of the curve's parameter."""
    length = math.hypot(*step)
    direction = entities.add(f"DIRECTION('',{listed(real(part / length) for part in step)})")
    vector = entities.add(f"VECTOR('',{direction},{real(length)})")
    line = entities.add(f"LINE('',{entities.point(origin)},{vector})")
    representation = entities.add(f"DEFINITIONAL_REPRESENTATION('',({line}),{plane})")
    return entities.add(f"PCURVE('',{surface},{representation})")


def knots_text(knots: np.ndarray) -> tuple[str, str]:
    """Return the distinct knots and their multiplicities as texts."""
    values, counts = np.unique(knots, return_counts=True)
    return listed(real(value) for value in values), listed(counts)
