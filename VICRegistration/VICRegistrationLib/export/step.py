"""Organs as STEP files (ISO 10303-21, AP214): the exact B-spline patches as closed solids, in LPS mm.

An organ is a product with a name, a colour and one solid. Several organs are an assembly of such products, each at its
place in the patient. Coordinates are those of DICOM (LPS: left, posterior, superior), as in the mesh files.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from .. import __version__
from ..files import write_text
from ..geometry.surface import BSplineSurface
from ..geometry.validity import validate
from .step_shapes import Entities, add_solid, listed, patches, real, string

ASSEMBLY_NAME = "organs"
_SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"
# Distance below which a reader may take two points for one, mm.
_ACCURACY_MM = 1e-6
# The standard requires a time; a constant one makes the files of the same organs equal.
_NO_TIME = "1970-01-01T00:00:00"


@dataclass(frozen=True, eq=False)
class Solid:
    """An organ as it is exported.

    Parameters
    ----------
    name : str
        Name of the organ.
    surface : BSplineSurface
        Closed by a seam and two poles, normals outward; RAS mm.
    color : (r, g, b), optional
        Each from 0 to 1 (sRGB).
    """

    name: str
    surface: BSplineSurface
    color: tuple[float, float, float] | None = None


def write_step(solids: Sequence[Solid], path: str | os.PathLike, *, faces: int = 1) -> None:
    """Write organs as a STEP file.

    Parameters
    ----------
    solids, faces
        As in :func:`step_text`.
    path : path
        File to write; its folder must exist.

    Raises
    ------
    ValueError
        If a surface is open, folded at a pole, has flipped normals or passes through itself: the message has the organ,
        the place (RAS mm) and a remedy. And as in :func:`step_text`.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    validate_solids(solids)
    write_text(path, step_text(solids, faces=faces))


def write_step_surface(surface: BSplineSurface, path: str | os.PathLike, *, name: str, faces: int = 1) -> None:
    """Write one surface as a STEP file.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ.
    faces : int
        As in :func:`step_text`.

    Raises
    ------
    ValueError, OSError
        As :func:`write_step`.
    """
    write_step([Solid(name, surface)], path, faces=faces)


def validate_solids(solids: Sequence[Solid], *, require_closed: bool = True) -> None:
    """Check that every surface bounds a solid.

    Parameters
    ----------
    solids : sequence of Solid
    require_closed : bool
        Whether an open surface is an error too.

    Raises
    ------
    ValueError
        With the first problem: the organ, the place on its surface (RAS mm), and a remedy.
    """
    for solid in solids:
        try:
            validate(solid.surface, require_closed=require_closed)
        except ValueError as error:
            msg = f"{solid.name}: {error}"
            raise ValueError(msg) from error


def step_text(solids: Sequence[Solid], *, faces: int = 1) -> str:
    """Return the text of a STEP file: one product, or an assembly. It does not check the surfaces for validity.

    Parameters
    ----------
    solids : sequence of Solid
        With different names.
    faces : int
        Faces of every organ: 1 with a seam, or several strips from pole to pole, cut exactly by knot insertion.

    Returns
    -------
    str
        ASCII. Same arguments, same text.

    Raises
    ------
    ValueError
        If no organ is given, two have one name, a colour is none, or a surface has not both a seam and two poles.
    """
    _check(solids)
    entities = Entities()
    products = Products(entities)
    bodies = [add_solid(entities, solid.name, _strips(solid, faces)) for solid in solids]
    parts = [(solid.name, products.add_part(solid.name, body, solid.color)) for solid, body in zip(solids, bodies)]
    if len(parts) > 1:
        products.add_assembly(ASSEMBLY_NAME, parts)
    return file_text([solid.name for solid in solids], entities)


def file_text(names: Sequence[str], entities: Entities) -> str:
    """Return the text of a file with given products and their instances.

    Parameters
    ----------
    names : sequence of str
    entities : Entities

    Returns
    -------
    str
    """
    return _header(names) + f"DATA;\n{entities.text()}ENDSEC;\nEND-ISO-10303-21;\n"


def _check(solids: Sequence[Solid]) -> None:
    """Refuse organs that cannot be written as STEP."""
    names = [solid.name for solid in solids]
    if not names:
        msg = "No organ was given; give at least one surface to write."
        raise ValueError(msg)
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        msg = f"Two organs are named {twice[0]!r}; rename one, or write them into files of their own."
        raise ValueError(msg)
    for solid in solids:
        if solid.color is not None and not (
            len(solid.color) == 3 and all(0.0 <= float(part) <= 1.0 for part in solid.color)
        ):
            msg = f"{solid.name}: The colour {solid.color} was given; give red, green and blue from 0 to 1."
            raise ValueError(msg)
        if not (solid.surface.closed_u and all(solid.surface.poles)):
            msg = f"{solid.name}: The surface is open or a ring; a solid needs a seam in u and a pole at each end of v."
            raise ValueError(msg)


def _strips(solid: Solid, faces: int) -> tuple[BSplineSurface, ...]:
    try:
        return patches(solid.surface, faces)
    except ValueError as error:
        msg = f"{solid.name}: {error}"
        raise ValueError(msg) from error


def _header(names: Sequence[str]) -> str:
    """Return the header section: content, frame and program."""
    what = f"B-spline solids of organs: {', '.join(names)}"
    frame = "LPS mm: x to the left, y to the back, z to the head of the patient (DICOM)"
    program = f"vic-registration {__version__}"
    name = names[0] if len(names) == 1 else ASSEMBLY_NAME
    return (
        "ISO-10303-21;\nHEADER;\n"
        f"FILE_DESCRIPTION({listed([string(what), string(frame)])},'2;1');\n"
        f"FILE_NAME({string(name)},{string(_NO_TIME)},(''),(''),{string(program)},{string(program)},'');\n"
        f"FILE_SCHEMA(({string(_SCHEMA)}));\nENDSEC;\n"
    )


# ------------------------------------------------------------------ products


@dataclass(frozen=True)
class _Product:
    """References to the entities of a product.

    Parameters
    ----------
    definition : str
        Its PRODUCT_DEFINITION.
    representation : str
        Its shape.
    placement : str
        The frame of that shape.
    """

    definition: str
    representation: str
    placement: str


class Products:
    """Adds products to a file.

    Parameters
    ----------
    entities : Entities
    """

    def __init__(self, entities: Entities) -> None:
        self._entities = entities
        application = entities.add("APPLICATION_CONTEXT('core data for automotive mechanical design processes')")
        entities.add(
            f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,{application})"
        )
        self._product_context = entities.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
        self._definition_context = entities.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
        self._units = [
            entities.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))"),
            entities.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))"),
            entities.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())"),
        ]

    def add_part(
        self, name: str, solid: str, color: tuple[float, float, float] | None, *, sheet: bool = False
    ) -> _Product:
        """Add a product of a solid or an open sheet, given by its reference, with an optional colour."""
        context, placement = self._context(), self._placement()
        kind = "MANIFOLD_SURFACE" if sheet else "ADVANCED_BREP"
        representation = self._entities.add(
            f"{kind}_SHAPE_REPRESENTATION({string(name)},{listed([placement, solid])},{context})"
        )
        if color is not None:
            styled = self._styled(solid, color)
            self._entities.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({styled}),{context})")
        return _Product(self._definition(name, representation), representation, placement)

    def add_assembly(self, name: str, parts: Sequence[tuple[str, _Product]]) -> None:
        """Add an assembly of products, given with their names, each at its own coordinates."""
        entities = self._entities
        context, placement = self._context(), self._placement()
        places = [self._placement() for _ in parts]
        representation = entities.add(f"SHAPE_REPRESENTATION({string(name)},{listed([placement, *places])},{context})")
        definition = self._definition(name, representation)
        for number, ((part_name, part), place) in enumerate(zip(parts, places), start=1):
            transformation = entities.add(f"ITEM_DEFINED_TRANSFORMATION('','',{part.placement},{place})")
            relation = entities.add(
                f"(REPRESENTATION_RELATIONSHIP('','',{part.representation},{representation})"
                f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION({transformation})SHAPE_REPRESENTATION_RELATIONSHIP())"
            )
            usage = entities.add(
                f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{number}',{string(part_name)},'',{definition},{part.definition},$)"
            )
            shape = entities.add(f"PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',{usage})")
            entities.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{shape})")

    def _definition(self, name: str, representation: str) -> str:
        """Add a product that has a shape."""
        entities, text = self._entities, string(name)
        product = entities.add(f"PRODUCT({text},{text},'',({self._product_context}))")
        entities.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,({product}))")
        formation = entities.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        definition = entities.add(f"PRODUCT_DEFINITION('design','',{formation},{self._definition_context})")
        shape = entities.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        entities.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{representation})")
        return definition

    def _context(self) -> str:
        """Add a geometric context in mm."""
        accuracy = self._entities.add(
            f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({real(_ACCURACY_MM)}),{self._units[0]},"
            "'distance_accuracy_value','confusion accuracy')"
        )
        return self._entities.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({accuracy}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT({listed(self._units)})REPRESENTATION_CONTEXT('LPS','3D'))"
        )

    def _placement(self) -> str:
        """Add a coordinate frame at the origin."""
        entities = self._entities
        origin = entities.point((0.0, 0.0, 0.0))
        axis, reference = entities.add("DIRECTION('',(0.,0.,1.))"), entities.add("DIRECTION('',(1.,0.,0.))")
        return entities.add(f"AXIS2_PLACEMENT_3D('',{origin},{axis},{reference})")

    def _styled(self, solid: str, color: tuple) -> str:
        """Give a solid a colour."""
        entities = self._entities
        rgb = entities.add(f"COLOUR_RGB('',{','.join(real(part) for part in color)})")
        fill = entities.add(f"FILL_AREA_STYLE_COLOUR('',{rgb})")
        area = entities.add(f"FILL_AREA_STYLE('',({fill}))")
        filled = entities.add(f"SURFACE_STYLE_FILL_AREA({area})")
        side = entities.add(f"SURFACE_SIDE_STYLE('',({filled}))")
        usage = entities.add(f"SURFACE_STYLE_USAGE(.BOTH.,{side})")
        assignment = entities.add(f"PRESENTATION_STYLE_ASSIGNMENT(({usage}))")
        return entities.add(f"STYLED_ITEM('color',({assignment}),{solid})")
