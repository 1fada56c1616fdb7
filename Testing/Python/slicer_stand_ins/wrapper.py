"""Stand-in of slicer.parameterNodeWrapper: typed parameters of a node as attributes of a class."""

from __future__ import annotations

import typing
import weakref

import slicer
import vtk

from .annotations import Default, WithinRange
from .connectors import connectorFor
from .serializers import split, storedAs

# Names that Slicer's wrapper has for itself, and this one does not need.
_RESERVED = ("default", "isCached", "dataType", "getValue", "setValue", "connectGui")


class Parameter:
    """What a class says about one of its parameters."""

    def __init__(self, cls, name, hint):
        self.name, self.hint = name, hint
        type_, annotations = split(hint)
        try:
            self.stored = storedAs(type_)
            inside = [annotation.value for annotation in annotations if isinstance(annotation, Default)]
            if hasattr(cls, name):
                self.default = getattr(cls, name)
            else:
                self.default = inside[0] if inside else self.stored.default()
        except TypeError as error:
            msg = f"Unable to create serializer for {cls} member {name}"
            raise TypeError(msg) from error
        self.validators = [annotation for annotation in annotations if isinstance(annotation, WithinRange)]

    def write(self, node, value):
        self.stored.check(value)
        for validator in self.validators:
            validator.validate(value)
        self.stored.write(node, self.name, value)

    def read(self, node):
        if not self.stored.isIn(node, self.name):
            self.write(node, self.default)
        return self.stored.read(node, self.name)


class Kept:
    """The value of a parameter, read again after every change of its node that was not made here.

    As in Slicer each has an observer of its own, and of all observers the one that was added first comes last.
    """

    def __init__(self, parameter, node):
        self._parameter, self._node, self._writing = parameter, node, False
        self.value = parameter.read(node)
        me = weakref.ref(self)
        self._tag = node.AddObserver(vtk.vtkCommand.ModifiedEvent, lambda *_: me() and me()._readAgain())

    def __del__(self):
        self._node.RemoveObserver(self._tag)

    def _readAgain(self):
        if not self._writing:
            self.value = self._parameter.read(self._node)

    def write(self, value):
        self._writing = True
        try:
            with slicer.util.NodeModify(self._node):
                self._parameter.write(self._node, value)
                self.value = self._parameter.read(self._node)
        finally:
            self._writing = False


class Wrapper:
    """What every class gets that is decorated with parameterNodeWrapper."""

    def __init__(self, parameterNode):
        self.parameterNode = parameterNode
        self._updating, self._connected = False, {}
        self._kept = {name: Kept(parameter, parameterNode) for name, parameter in self.allParameters.items()}

    def __setattr__(self, name, value):
        # Slicer lets a misspelt parameter pass here as a new attribute.
        if name != "parameterNode" and not name.startswith("_") and not hasattr(type(self), name):
            msg = f"'{type(self).__name__}' has no parameter '{name}'"
            raise AttributeError(msg)
        object.__setattr__(self, name, value)

    def connectParametersToGui(self, mapping):
        """Bind parameters to widgets; the observer it adds stays for ever, as in Slicer 5.8."""
        connectors = {name: connectorFor(widget, self.allParameters[name].hint) for name, widget in mapping.items()}
        tag = max(self._connected, default=-1) + 1
        self._connected[tag] = connectors
        for name, connector in connectors.items():
            connector.write(getattr(self, name))
            connector.onChanged(self._writer(name, connector))
        self.AddObserver(vtk.vtkCommand.ModifiedEvent, lambda *_: self._updateWidgets())
        return tag

    def disconnectGui(self, tag):
        for connector in self._connected.pop(tag, {}).values():
            connector.onChanged(None)

    def _writer(self, name, connector):
        def write():
            with slicer.util.NodeModify(self):
                if not self._updating:
                    setattr(self, name, connector.read())

        return write

    def _updateWidgets(self):
        if self._updating:
            return
        self._updating = True
        try:
            with slicer.util.NodeModify(self):
                for connectors in self._connected.values():
                    for name, connector in connectors.items():
                        connector.write(getattr(self, name))
        finally:
            self._updating = False

    def StartModify(self):
        return self.parameterNode.StartModify()

    def EndModify(self, wasModified):
        return self.parameterNode.EndModify(wasModified)

    def AddObserver(self, event, callback, priority=0.0):
        return self.parameterNode.AddObserver(event, callback, priority)

    def RemoveObserver(self, tag):
        self.parameterNode.RemoveObserver(tag)

    def Modified(self):
        self.parameterNode.Modified()


def parameterNodeWrapper(cls):
    """Class decorator: annotated names of the class become parameters of a node."""
    parameters = {}
    for name, hint in typing.get_type_hints(cls, include_extras=True).items():
        parameters[name] = Parameter(cls, name, hint)
        setattr(cls, name, _attribute(name))
    cls.allParameters = parameters
    for name in (*vars(Wrapper), *_RESERVED):
        if not name.startswith("__") and hasattr(cls, name):
            msg = f"Cannot use reserved name '{name}' in a parameterNodeWrapper"
            raise ValueError(msg)
    for name, member in vars(Wrapper).items():
        if not name.startswith("__") or name in ("__init__", "__setattr__"):
            setattr(cls, name, member)
    return cls


def _attribute(name):
    return property(lambda self: self._kept[name].value, lambda self, value: self._kept[name].write(value))
