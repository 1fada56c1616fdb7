"""Models as STEP files (AP214): a named face for every patch, organs and cords as solids, sheets as open shells.

The patches are exact. Faces of a part share their edges; attached parts share vertices and curves. Names of parts that
the image does not show end in "(estimated)". Coordinates are LPS mm, as in the files of single organs.
"""

from __future__ import annotations

import os

import numpy as np

from ..export.step import ASSEMBLY_NAME, Products, Solid, file_text, validate_solids
from ..export.step_shapes import (
    Entities,
    add_curve,
    add_line,
    add_parameter_plane,
    add_surface,
    listed,
    string,
)
from ..files import write_text
from ..frames import RAS_TO_LPS
from ..organ_colours import rgb
from .colours import part_colours
from .model import MultiPatchModel, Part, Patch
from .topology import Side, open_edges, shell, sides, sides_by_edge


def write_model_step(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Write a model as a STEP file.

    Parameters
    ----------
    model : MultiPatchModel
    path : path
        File to write; its folder must exist.

    Raises
    ------
    ValueError
        If an organ is no valid solid (the message names the place), or a cord is not closed.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    validate_solids([Solid(organ, parent) for organ, parent in model.parents.items()])
    write_text(path, model_step_text(model))


def model_step_text(model: MultiPatchModel) -> str:
    """Return the text of a STEP file: an assembly of the parts.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    str
        ASCII. Same model, same text.

    Raises
    ------
    ValueError
        If an organ or a cord is not closed.
    """
    entities = Entities()
    products, shapes = Products(entities), _Shapes(entities, model)
    colours, parts = part_colours(model), []
    for part in model.parts:
        name, sheet = part.labelled(), part.kind == "sheet"
        body = shapes.add_part(part)
        parts.append((name, products.add_part(name, body, rgb(colours[part.name]), sheet=sheet)))
    if len(parts) > 1:
        products.add_assembly(model.name or ASSEMBLY_NAME, parts)
    return file_text([name for name, _ in parts], entities)


def faces_step_text(model: MultiPatchModel) -> str:
    """Return the text of a STEP file with every patch once, in one shell whose faces share edges across parts.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    str
        ASCII.
    """
    entities = Entities()
    products, shapes = Products(entities), _Shapes(entities, model)
    products.add_part("patches", shapes.add_faces(), None, sheet=True)
    return file_text(["patches"], entities)


class _Shapes:
    """Adds the parts of a model to a file; surfaces, curves and vertices that they share are added once."""

    def __init__(self, entities: Entities, model: MultiPatchModel) -> None:
        self._entities, self._model = entities, model
        # Adding zero turns -0.0 into 0.0.
        self._points = model.points * RAS_TO_LPS + 0.0
        self._plane = add_parameter_plane(entities)
        self._surfaces: dict[str, str] = {}
        self._curves: dict[tuple[int, ...], tuple[str, tuple[float, float]]] = {}
        self._vertices: dict[int, str] = {}

    def add_part(self, part: Part) -> str:
        """Add the shell or the solid of a part."""
        entities, name, faces = self._entities, string(part.labelled()), shell(self._model, part)
        gaps = () if part.kind == "sheet" else open_edges(faces)
        if gaps:
            side = gaps[0]
            msg = (
                f"{part.name} does not bound a solid: its patches do not meet, or are turned to different sides, at "
                f"the border {side.name} of {side.patch.name}; check the model."
            )
            raise ValueError(msg)
        edges = self._edges([patch for patch, _ in faces])
        written = listed(self._face(part, patch, turned, edges) for patch, turned in faces)
        if part.kind == "sheet":
            opened = entities.add(f"OPEN_SHELL({name},{written})")
            return entities.add(f"SHELL_BASED_SURFACE_MODEL({name},({opened}))")
        closed = entities.add(f"CLOSED_SHELL({name},{written})")
        return entities.add(f"MANIFOLD_SOLID_BREP({name},{closed})")

    def add_faces(self) -> str:
        """Add one open shell of all patches."""
        model, edges = self._model, self._edges(list(self._model.patches))
        written = listed(self._face(model.part(patch.part), patch, False, edges) for patch in model.patches)
        opened = self._entities.add(f"OPEN_SHELL('',{written})")
        return self._entities.add(f"SHELL_BASED_SURFACE_MODEL('',({opened}))")

    def _face(self, part: Part, patch: Patch, turned: bool, edges: dict) -> str:
        way = []
        for side in sides(patch):
            forward = side.forward != turned
            way.append(self._entities.add(f"ORIENTED_EDGE('',*,*,{edges[side.edge]},{'.T.' if forward else '.F.'})"))
        loop = self._entities.add(f"EDGE_LOOP('',{listed(way[::-1] if turned else way)})")
        bound = self._entities.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        own = patch.part == part.name
        name = part.labelled(patch.name if own else f"{part.name} foot")
        sense = ".F." if turned else ".T."
        return self._entities.add(f"ADVANCED_FACE({string(name)},({bound}),{self._surface(patch)},{sense})")

    def _edges(self, patches: list[Patch]) -> dict[tuple[int, ...], str]:
        """Add the edges of patches, with their lines in the parameters of one or two faces; by their control points."""
        found = {}
        for edge, here in sides_by_edge(patches).items():
            curve, ends = self._curve(here[0])
            lines = [self._line(side, ends) for side in here]
            # A SURFACE_CURVE has one or two such lines; where more faces meet, readers compute them.
            if len(lines) <= 2:
                curve = self._entities.add(f"SURFACE_CURVE('',{curve},{listed(lines)},.CURVE_3D.)")
            first, last = self._vertex(edge[0]), self._vertex(edge[-1])
            found[edge] = self._entities.add(f"EDGE_CURVE('',{first},{last},{curve},.T.)")
        return found

    def _surface(self, patch: Patch) -> str:
        if patch.name not in self._surfaces:
            net = self._points[patch.indices]
            surface = patch.surface(self._model.points)
            self._surfaces[patch.name] = add_surface(self._entities, surface, net, closed=False)
        return self._surfaces[patch.name]

    def _curve(self, side: Side) -> tuple[str, tuple[float, float]]:
        """Add the curve along an edge, in the order of its control points; with the parameters of its ends."""
        if side.edge not in self._curves:
            degree, knots = side.patch.degrees[side.axis], side.patch.knots[side.axis]
            knots = knots if side.same else (knots[0] + knots[-1]) - knots[::-1]
            curve = add_curve(self._entities, degree, knots, self._points[list(side.edge)])
            self._curves[side.edge] = curve, (float(knots[0]), float(knots[-1]))
        return self._curves[side.edge]

    def _line(self, side: Side, ends: tuple[float, float]) -> str:
        """Add the line of an edge in the parameters of a patch, as a function of the curve's parameter."""
        knots = side.patch.knots[side.axis]
        begin, end = (knots[0], knots[-1]) if side.same else (knots[-1], knots[0])
        slope = (end - begin) / (ends[1] - ends[0])
        across = side.patch.knots[1 - side.axis][-1 if side.name.endswith("max") else 0]
        origin, step = np.array([begin - slope * ends[0], across]), np.array([slope, 0.0])
        order = slice(None) if side.axis == 0 else slice(None, None, -1)
        return add_line(
            self._entities, self._surface(side.patch), tuple(origin[order]), tuple(step[order]), self._plane
        )

    def _vertex(self, index: int) -> str:
        if index not in self._vertices:
            self._vertices[index] = self._entities.add(f"VERTEX_POINT('',{self._entities.point(self._points[index])})")
        return self._vertices[index]
