"""What Open CASCADE reads out of a STEP file. Needs the package cadquery-ocp-novtk, 7.8 or newer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.ShapeAnalysis import ShapeAnalysis_ShapeTolerance
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.STEPControl import STEPControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_ChildIterator
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool


@dataclass(frozen=True)
class Part:
    """A product of a file: its name, its colour if it has one, and the names of what it is put together from."""

    name: str
    color: tuple | None
    components: tuple


@dataclass(frozen=True)
class Patch:
    """A B-spline surface as Open CASCADE holds it; poles (n_u, n_v, 3), knots without repetition."""

    degrees: tuple
    periodic: bool
    poles: np.ndarray
    knots: tuple
    multiplicities: tuple


def read(path):
    """Shape of all that is in a file."""
    reader = STEPControl_Reader()
    assert reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    reader.TransferRoots()
    return reader.OneShape()


def parts(path):
    """Products of a file in the order of their definition."""
    document = TDocStd_Document(TCollection_ExtendedString("test"))
    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    assert reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    assert reader.Transfer(document)
    colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    labels = _children(XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).Label())
    return [
        Part(_name(label), _color(colors, label), tuple(_name(child) for child in _components(label)))
        for label in labels
    ]


def face_names(path):
    """Names of the faces that were made of a file."""
    reader = STEPControl_Reader()
    assert reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    reader.TransferRoots()
    made = reader.WS().TransferReader()
    return [made.EntityFromShapeResult(face, -1).Name().ToCString() for face in faces(reader.OneShape())]


def solids(shape):
    return _inside(shape, TopAbs_ShapeEnum.TopAbs_SOLID)


def faces(shape):
    return [_cast("Face", face) for face in _inside(shape, TopAbs_ShapeEnum.TopAbs_FACE)]


def shells(shape):
    return _inside(shape, TopAbs_ShapeEnum.TopAbs_SHELL)


def n_seams(shape):
    """Number of edges on which a face meets itself."""
    edges = [
        (_cast("Edge", edge), face) for face in faces(shape) for edge in _inside(face, TopAbs_ShapeEnum.TopAbs_EDGE)
    ]
    # Each is come upon twice, once in each direction.
    return sum(BRep_Tool.IsClosed_s(edge, face) for edge, face in edges) // 2


def is_valid(shape):
    return BRepCheck_Analyzer(shape).IsValid()


def is_closed(shape):
    return all(BRep_Tool.IsClosed_s(shell) for shell in shells(shape))


def largest_tolerance(shape):
    """Largest distance at which Open CASCADE had to let edges, vertices and faces meet, mm."""
    return ShapeAnalysis_ShapeTolerance().Tolerance(shape, 1)


def volume(shape):
    """Volume, mm^3; Gauss-Kronrod, as the default quadrature is off by up to 1e-5 whatever is asked for."""
    properties = GProp_GProps()
    BRepGProp.VolumePropertiesGK_s(shape, properties, 1e-9, False, True, False, False, False)
    return properties.Mass()


def patch(face):
    """B-spline surface of a face."""
    surface = BRep_Tool.Surface_s(face)
    n_u, n_v = surface.NbUPoles(), surface.NbVPoles()
    poles = [[surface.Pole(i + 1, j + 1) for j in range(n_v)] for i in range(n_u)]
    knots, multiplicities = [], []
    for axis in "UV":
        numbers = range(1, getattr(surface, f"Nb{axis}Knots")() + 1)
        knots.append([getattr(surface, f"{axis}Knot")(number) for number in numbers])
        multiplicities.append([getattr(surface, f"{axis}Multiplicity")(number) for number in numbers])
    return Patch(
        (surface.UDegree(), surface.VDegree()),
        surface.IsUPeriodic(),
        np.array([[(pole.X(), pole.Y(), pole.Z()) for pole in row] for row in poles]),
        tuple(knots),
        tuple(multiplicities),
    )


def _inside(shape, kind):
    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _cast(kind, shape):
    """Cast a shape to its class; the name of the function has lost its ending in version 8."""
    return (getattr(TopoDS, f"{kind}_s", None) or getattr(TopoDS, kind))(shape)


def _children(label):
    iterator, found = TDF_ChildIterator(label, False), []
    while iterator.More():
        found.append(iterator.Value())
        iterator.Next()
    return found


def _components(label):
    return [child for child in _children(label) if XCAFDoc_ShapeTool.IsComponent_s(child)]


def _name(label):
    name = TDataStd_Name()
    assert label.FindAttribute(TDataStd_Name.GetID_s(), name)
    return name.Get().ToExtString()


def _color(colors, label):
    color = Quantity_Color()
    if not colors.GetColor(XCAFDoc_ShapeTool.GetShape_s(label), XCAFDoc_ColorType.XCAFDoc_ColorSurf, color):
        return None
    return color.Values(Quantity_TypeOfColor.Quantity_TOC_sRGB)
