"""Topology of an organ in a STEP file: faces with their edges and vertices, a closed shell, a solid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.surface import BSplineSurface
from .frames import RAS_TO_LPS
from .step_entities import Entities, listed, real, string


def add_solid(entities: Entities, name: str, strips: Sequence[BSplineSurface]) -> str:
    """Add the solid that strips from pole to pole enclose.

    Parameters
    ----------
    entities : Entities
    name : str
    strips : sequence of BSplineSurface
        RAS mm, clamped knots, normals outward, side by side around the tube; one strip has a seam.

    Returns
    -------
    str
        Reference to the solid.

    Notes
    -----
    An edge runs along the first row of every strip from pole to pole. A face is bounded by the edge of the next strip
    and, backwards, its own: for a single strip, by its seam there and back. Where they meet, its surface has a pole,
    which by ISO 10303-42 needs no edge of its own.
    """
    # Adding zero takes the sign off zeros.
    nets = [strip.control_net * RAS_TO_LPS + 0.0 for strip in strips]
    surfaces = [_add_surface(entities, strip, net, closed=len(strips) == 1) for strip, net in zip(strips, nets)]
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


def _add_surface(entities: Entities, strip: BSplineSurface, net: np.ndarray, *, closed: bool) -> str:
    """Surface of a strip; `closed` if its last row is its first one."""
    (knots_u, multiplicities_u), (knots_v, multiplicities_v) = _knots(strip.knots_u), _knots(strip.knots_v)
    rows = listed(listed(entities.point(point) for point in row) for row in net)
    return entities.add(
        f"B_SPLINE_SURFACE_WITH_KNOTS('',{strip.degrees[0]},{strip.degrees[1]},{rows},.UNSPECIFIED.,"
        f"{'.T.' if closed else '.F.'},.F.,.F.,{multiplicities_u},{multiplicities_v},{knots_u},{knots_v},.UNSPECIFIED.)"
    )


def _add_edges(entities: Entities, strips, nets, surfaces) -> list[str]:
    """Edge along the first row of every strip, where the strip before it ends."""
    ends = [entities.add(f"VERTEX_POINT('',{entities.point(nets[0][0, end])})") for end in (0, -1)]
    plane = entities.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('2D SPACE',''))"
    )
    kind = "SEAM_CURVE" if len(strips) == 1 else "SURFACE_CURVE"
    edges = []
    for number, (strip, net) in enumerate(zip(strips, nets)):
        curve = _add_curve(entities, strip, net[0])
        # Said in the parameters of both faces too, or readers approximate what is a straight line there.
        before = _add_line(entities, surfaces[number - 1], strips[number - 1].domain[0][1], plane)
        own = _add_line(entities, surfaces[number], strip.domain[0][0], plane)
        curve = entities.add(f"{kind}('',{curve},({before},{own}),.CURVE_3D.)")
        edges.append(entities.add(f"EDGE_CURVE('',{ends[0]},{ends[1]},{curve},.T.)"))
    return edges


def _add_curve(entities: Entities, strip: BSplineSurface, row: np.ndarray) -> str:
    """Curve of a row of the strip's control net, (n_v, 3)."""
    knots, multiplicities = _knots(strip.knots_v)
    points = listed(entities.point(point) for point in row)
    return entities.add(
        f"B_SPLINE_CURVE_WITH_KNOTS('',{strip.degrees[1]},{points},.UNSPECIFIED.,.F.,.F.,{multiplicities},{knots},"
        ".UNSPECIFIED.)"
    )


def _add_line(entities: Entities, surface: str, u: float, plane: str) -> str:
    """Line of constant u in the plane of a surface's parameters."""
    direction = entities.add("DIRECTION('',(0.,1.))")
    vector = entities.add(f"VECTOR('',{direction},1.)")
    line = entities.add(f"LINE('',{entities.point((u, 0.0))},{vector})")
    representation = entities.add(f"DEFINITIONAL_REPRESENTATION('',({line}),{plane})")
    return entities.add(f"PCURVE('',{surface},{representation})")


def _knots(knots: np.ndarray) -> tuple[str, str]:
    """Write distinct knots and how often each occurs."""
    values, counts = np.unique(knots, return_counts=True)
    return listed(real(value) for value in values), listed(counts)
