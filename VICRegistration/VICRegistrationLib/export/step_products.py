"""Product structure of a STEP file (AP214): products with their shapes, an assembly of them, colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .step_entities import Entities, listed, real, string

SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"

# Points closer than this are one point to the reader, mm.
_ACCURACY_MM = 1e-6


@dataclass(frozen=True)
class Product:
    """References to what stands for a product.

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
    """Adds products to the instances of a file.

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
        self, name: str, solids: Sequence[str], colors: Sequence[tuple[float, float, float] | None]
    ) -> Product:
        """Add a product made of solids.

        Parameters
        ----------
        name : str
        solids : sequence of str
            References to the solids.
        colors : sequence of (r, g, b), or None for a solid without
            Each from 0 to 1.

        Returns
        -------
        Product
        """
        context, placement = self._context(), self._placement()
        representation = self._entities.add(
            f"ADVANCED_BREP_SHAPE_REPRESENTATION({string(name)},{listed([placement, *solids])},{context})"
        )
        styled = [self._styled(solid, color) for solid, color in zip(solids, colors) if color is not None]
        if styled:
            self._entities.add(
                f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',{listed(styled)},{context})"
            )
        return Product(self._definition(name, representation), representation, placement)

    def add_assembly(self, name: str, parts: Sequence[tuple[str, Product]]) -> Product:
        """Add a product made of other products, each where it is.

        Parameters
        ----------
        name : str
        parts : sequence of (name, Product)

        Returns
        -------
        Product
        """
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
        return Product(definition, representation, placement)

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
        """Space of its own for a representation, in mm."""
        accuracy = self._entities.add(
            f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({real(_ACCURACY_MM)}),{self._units[0]},"
            "'distance_accuracy_value','confusion accuracy')"
        )
        return self._entities.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({accuracy}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT({listed(self._units)})REPRESENTATION_CONTEXT('LPS','3D'))"
        )

    def _placement(self) -> str:
        """Frame at the origin."""
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
