"""How slicer.parameterNodeWrapper keeps values of each type in a parameter node, for the types this module uses.

Written to refuse what the real one refuses and to store under the same names; types it knows and this does not are
refused too.
"""

from __future__ import annotations

import enum
import typing

import slicer

from .annotations import FloatRange


class Stored:
    """One type of value, an int or a text: how it is checked, written to a parameter node and read back."""

    def __init__(self, type_):
        self.type = type_

    def default(self):
        return self.type()

    def check(self, value):
        if value is None:
            msg = "The value must not be None"
            raise ValueError(msg)
        if not isinstance(value, self.type):
            msg = f"The value must be of type {self.type}, is of type {type(value)}: {value}"
            raise TypeError(msg)

    def isIn(self, node, name):
        return node.HasParameter(name)

    def write(self, node, name, value):
        node.SetParameter(name, str(value))

    def read(self, node, name):
        return self.type(node.GetParameter(name))

    def remove(self, node, name):
        node.UnsetParameter(name)


class Real(Stored):
    """A float, which an int may stand for."""

    def check(self, value):
        super().check(float(value) if isinstance(value, int) else value)


class Flag(Stored):
    """A bool."""

    def read(self, node, name):
        return node.GetParameter(name) == "True"


class Named(Stored):
    """A member of an enum, kept by its name."""

    def default(self):
        return next(iter(self.type))

    def write(self, node, name, value):
        node.SetParameter(name, value.name)

    def read(self, node, name):
        text = node.GetParameter(name)
        if text not in self.type.__members__:
            msg = f"{text!r} in the parameter node is no name of {self.type!r}"
            raise ValueError(msg)
        return self.type[text]


class Range(Stored):
    """A FloatRange."""

    def check(self, value):
        if not isinstance(value, FloatRange):
            msg = f"The value must be of type FloatRange, is of type {type(value)}: {value}"
            raise ValueError(msg)

    def isIn(self, node, name):
        return node.HasParameter(f"{name}._minimum")

    def write(self, node, name, value):
        node.SetParameter(f"{name}._minimum", str(value.minimum))
        node.SetParameter(f"{name}._maximum", str(value.maximum))

    def read(self, node, name):
        return FloatRange(*(float(node.GetParameter(f"{name}.{end}")) for end in ("_minimum", "_maximum")))


class Node(Stored):
    """A reference to a node, or None."""

    def default(self):
        return None

    def check(self, value):
        if value is not None:
            super().check(value)

    def write(self, node, name, value):
        node.SetParameter(name, "")
        node.SetNodeReferenceID(name, None if value is None else value.GetID())

    def read(self, node, name):
        return node.GetNodeReference(name)

    def remove(self, node, name):
        super().remove(node, name)
        node.RemoveNodeReferenceIDs(name)


class OptionalNode(Node):
    """Optional[node]: a reference, or None, under names of their own."""

    def isIn(self, node, name):
        return any(node.HasParameter(f"{name}.{index}") for index in (0, 1))

    def write(self, node, name, value):
        super().remove(node, f"{name}.0")
        node.UnsetParameter(f"{name}.1")
        if value is None:
            node.SetParameter(f"{name}.1", "True")
        else:
            super().write(node, f"{name}.0", value)

    def read(self, node, name):
        return super().read(node, f"{name}.0")


class Tuple(Stored):
    """Values of given types, in order. Without a default of its own Slicer's serves the first node only."""

    def default(self):
        msg = "a tuple needs a default of its own"
        raise TypeError(msg)

    def check(self, values):
        if len(values) != len(self.type):
            msg = f"Unexpected number of tuple values: {len(values)}; {len(self.type)} are needed"
            raise ValueError(msg)
        for part, value in zip(self.type, values):
            part.check(value)

    def isIn(self, node, name):
        return self.type[0].isIn(node, f"{name}.0")

    def write(self, node, name, values):
        for index, (part, value) in enumerate(zip(self.type, values)):
            part.write(node, f"{name}.{index}", value)

    def read(self, node, name):
        return tuple(part.read(node, f"{name}.{index}") for index, part in enumerate(self.type))


class List(Stored):
    """Values of one type, any number of them. Slicer's list can be changed in place, which this module does not."""

    def default(self):
        return ()

    def check(self, values):
        for value in values:
            self.type.check(value)

    def isIn(self, node, name):
        return node.HasParameter(f"{name}.len")

    def write(self, node, name, values):
        old = len(self.read(node, name)) if self.isIn(node, name) else 0
        for index, value in enumerate(values):
            self.type.write(node, f"{name}.{index}", value)
        for index in range(len(values), old):
            self.type.remove(node, f"{name}.{index}")
        node.SetParameter(f"{name}.len", str(len(values)))

    def read(self, node, name):
        return tuple(self.type.read(node, f"{name}.{index}") for index in range(int(node.GetParameter(f"{name}.len"))))


def split(hint):
    """The type and the annotations of a hint."""
    if typing.get_origin(hint) is typing.Annotated:
        return hint.__origin__, hint.__metadata__
    return hint, ()


def storedAs(type_):
    """How values of a type are kept; a TypeError if they cannot be, or are not used by this module."""
    origin, inner = typing.get_origin(type_), typing.get_args(type_)
    if origin is list:
        return List(storedAs(*inner))
    if origin is tuple:
        return Tuple([storedAs(part) for part in inner])
    if (
        origin is typing.Union
        and len(inner) == 2
        and inner[1] is type(None)
        and issubclass(inner[0], slicer.vtkMRMLNode)
    ):
        return OptionalNode(inner[0])
    kinds = {enum.Enum: Named, slicer.vtkMRMLNode: Node, FloatRange: Range, bool: Flag, float: Real}
    for base, kind in {**kinds, int: Stored, str: Stored}.items():
        if isinstance(type_, type) and issubclass(type_, base):
            return kind(type_)
    msg = f"Unable to create serializer for type: {type_}"
    raise TypeError(msg)
