"""How slicer.parameterNodeWrapper keeps values of each type in a parameter node, for the types this module uses.

Written to refuse what the real one refuses and to store under the same names; types it knows and this does not are
refused too.
"""

from __future__ import annotations

import enum
import typing
from collections.abc import MutableSequence

import slicer

from .annotations import FloatRange, Validator


class Stored:
    """One type of value: how it is checked, written to a parameter node and read back."""

    cached = True

    def __init__(self, type_=None):
        self.type = type_

    def accepts(self, type_):
        return type_ is self.type

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
        node.SetParameter(name, self.text(value))

    def read(self, node, name):
        return self.value(node.GetParameter(name))

    def remove(self, node, name):
        node.UnsetParameter(name)


class Number(Stored):
    """An int, or a float (which an int may stand for). A bool passes here as it does in Slicer."""

    text = staticmethod(str)

    def accepts(self, type_):
        return type_ in (int, float)

    def default(self):
        return 0

    def check(self, value):
        Stored((int, float) if self.type is float else int).check(value) if value is not None else super().check(value)

    def value(self, text):
        return self.type(text)


class Text(Stored):
    """A str."""

    text = value = staticmethod(str)
    default = staticmethod(str)


class Flag(Stored):
    """A bool."""

    text = staticmethod(str)
    default = staticmethod(bool)

    def value(self, text):
        return text == "True"


class Named(Stored):
    """A member of an enum, kept by its name."""

    def accepts(self, type_):
        return issubclass(type_, enum.Enum)

    def default(self):
        return next(iter(self.type))

    def check(self, value):
        """None passes here, and is an AttributeError when it is written."""
        if value is not None:
            super().check(value)

    def text(self, value):
        return value.name

    def value(self, text):
        if text not in self.type.__members__:
            msg = f"{text!r} in the parameter node is no name of {self.type!r}"
            raise ValueError(msg)
        return self.type[text]


class Node(Stored):
    """A reference to a node, or None."""

    def accepts(self, type_):
        return issubclass(type_, slicer.vtkMRMLNode)

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


class Nothing(Stored):
    """None, as one side of Optional."""

    def accepts(self, type_):
        return type_ is type(None)

    def check(self, value):
        if value is not None:
            msg = f"The value must be None, is {value}"
            raise ValueError(msg)

    def text(self, value):
        return "True"

    def value(self, text):
        return None


class Parts(Stored):
    """Base of types that consist of values with names of their own."""

    def __init__(self, parts):
        super().__init__()
        self.parts = parts
        self.cached = all(part.cached for part in parts)

    def check(self, value):
        """Each part is checked when it is written."""

    def names(self, name):
        return [f"{name}.{index}" for index in range(len(self.parts))]

    def remove(self, node, name):
        with slicer.util.NodeModify(node):
            for part, partName in zip(self.parts, self.names(name)):
                part.remove(node, partName)


class Tuple(Parts):
    """Values of given types, in order."""

    def accepts(self, type_):
        return False

    def default(self):
        # As in Slicer a generator: it serves the first node only. A tuple needs a default of its own.
        return (part.default() for part in self.parts)

    def isIn(self, node, name):
        return self.parts[0].isIn(node, f"{name}.0")

    def write(self, node, name, values):
        values = tuple(values)
        if len(values) != len(self.parts):
            msg = f"Unexpected number of tuple values: {len(values)}; {len(self.parts)} are needed"
            raise ValueError(msg)
        with slicer.util.NodeModify(node):
            for part, partName, value in zip(self.parts, self.names(name), values):
                part.check(value)
                part.write(node, partName, value)

    def read(self, node, name):
        return tuple(part.read(node, partName) for part, partName in zip(self.parts, self.names(name)))


class Union(Parts):
    """One of several types, such as Optional."""

    def default(self):
        optional = len(self.parts) == 2 and isinstance(self.parts[1].stored, Nothing)
        return None if optional else self.parts[0].default()

    def isIn(self, node, name):
        return any(part.isIn(node, partName) for part, partName in zip(self.parts, self.names(name)))

    def write(self, node, name, value):
        fitting = [index for index, part in enumerate(self.parts) if part.accepts(type(value))]
        if not fitting:
            msg = f"Unable to write value '{value}' of type '{type(value)}'"
            raise TypeError(msg)
        chosen = next((index for index in fitting if self._passes(self.parts[index], value)), fitting[-1])
        self.parts[chosen].check(value)
        with slicer.util.NodeModify(node):
            self.remove(node, name)
            self.parts[chosen].write(node, f"{name}.{chosen}", value)

    def read(self, node, name):
        for part, partName in zip(self.parts, self.names(name)):
            if part.isIn(node, partName):
                return part.read(node, partName)
        msg = f"Unable to find value for name: {name}"
        raise KeyError(msg)

    @staticmethod
    def _passes(part, value):
        try:
            part.check(value)
        except (TypeError, ValueError):
            return False
        return True


class List(Stored):
    """Values of one type, any number of them."""

    def __init__(self, item):
        super().__init__()
        self.item, self.cached = item, item.cached

    def accepts(self, type_):
        return issubclass(type_, list)

    def check(self, value):
        """Each value is checked when it is written."""

    def default(self):
        return []

    def isIn(self, node, name):
        return node.HasParameter(f"{name}.len")

    def write(self, node, name, values):
        values = list(values)
        for value in values:
            self.item.check(value)
        with slicer.util.NodeModify(node):
            old = self._length(node, name)
            for index, value in enumerate(values):
                self.item.write(node, f"{name}.{index}", value)
            for index in range(len(values), old):
                self.item.remove(node, f"{name}.{index}")
            node.SetParameter(f"{name}.len", str(len(values)))

    def read(self, node, name):
        values = [self.item.read(node, f"{name}.{index}") for index in range(self._length(node, name))]
        return ObservedList(values, lambda changed: self.write(node, name, changed))

    def _length(self, node, name):
        return int(node.GetParameter(f"{name}.len")) if self.isIn(node, name) else 0


class ObservedList(MutableSequence):
    """A list read from a node: what is done to it is written to the node, at once and with one event."""

    def __init__(self, values, save):
        self._values, self._save = values, save

    def __getitem__(self, index):
        return self._values[index]

    def __len__(self):
        return len(self._values)

    def __setitem__(self, index, value):
        self._change("__setitem__", index, value)

    def __delitem__(self, index):
        self._change("__delitem__", index)

    def insert(self, index, value):
        self._change("insert", index, value)

    def extend(self, values):
        self._change("extend", values)

    def clear(self):
        self._change("clear")

    def __eq__(self, other):
        return self._values == (other._values if isinstance(other, ObservedList) else other)

    __hash__ = None

    def __repr__(self):
        return f"ObservedList({self._values})"

    def _change(self, method, *arguments):
        changed = list(self._values)
        getattr(changed, method)(*arguments)
        self._save(changed)
        self._values = changed


class ObservedRange(FloatRange):
    """A range read from a node: what is set in it is written to the node."""

    def __init__(self, minimum, maximum, save):
        super().__init__(minimum, maximum)
        self._write = save

    def _save(self):
        if "_write" in self.__dict__:
            self._write(self)


class Range(Stored):
    """A FloatRange."""

    def __init__(self):
        super().__init__(FloatRange)

    def default(self):
        return FloatRange()

    def check(self, value):
        if not isinstance(value, FloatRange):
            msg = f"The value must be of type FloatRange, is of type {type(value)}: {value}"
            raise ValueError(msg)

    def isIn(self, node, name):
        return node.HasParameter(f"{name}._minimum")

    def write(self, node, name, value):
        with slicer.util.NodeModify(node):
            node.SetParameter(f"{name}._minimum", str(value.minimum))
            node.SetParameter(f"{name}._maximum", str(value.maximum))

    def read(self, node, name):
        ends = (float(node.GetParameter(f"{name}.{end}")) for end in ("_minimum", "_maximum"))
        return ObservedRange(*ends, lambda value: self.write(node, name, value))

    def remove(self, node, name):
        node.UnsetParameter(f"{name}._minimum")
        node.UnsetParameter(f"{name}._maximum")


class Checked:
    """A stored type with the validators of its annotation."""

    def __init__(self, stored, validators):
        self.stored, self.validators = stored, validators

    def __getattr__(self, name):
        return getattr(self.stored, name)

    def check(self, value):
        self.stored.check(value)
        for validator in self.validators:
            validator.validate(value)


def split(hint):
    """The type and the annotations of a hint."""
    if typing.get_origin(hint) is typing.Annotated:
        return hint.__origin__, hint.__metadata__
    return hint, ()


def storedAs(hint):
    """How values of a type hint are kept; an Exception if they cannot be, or are not used by this module."""
    type_, annotations = split(hint)
    stored = _storedPlainly(type_)
    return Checked(stored, [annotation for annotation in annotations if isinstance(annotation, Validator)])


def _storedPlainly(type_):
    origin, inner = typing.get_origin(type_), [storedAs(part) for part in typing.get_args(type_)]
    if origin in (list, tuple, typing.Union):
        return {list: lambda: List(*inner), tuple: lambda: Tuple(inner), typing.Union: lambda: Union(inner)}[origin]()
    plain = {int: Number, float: Number, str: Text, bool: Flag, type(None): Nothing}
    if type_ in plain:
        return plain[type_](type_)
    if type_ is FloatRange:
        return Range()
    if isinstance(type_, type) and issubclass(type_, (enum.Enum, slicer.vtkMRMLNode)):
        return (Named if issubclass(type_, enum.Enum) else Node)(type_)
    raise Exception(f"Unable to create serializer for type: {type_}")  # noqa: EM102
