"""Stand-in of slicer.parameterNodeWrapper: typed parameters of a node as attributes of a class."""

from __future__ import annotations

import typing
import weakref

import slicer
import vtk

from .annotations import Default
from .connectors import connectorFor
from .serializers import split, storedAs


class Parameter:
    """What a class says about one of its parameters."""

    def __init__(self, cls, name, hint):
        self.name, self.hint = name, hint
        try:
            self.stored = storedAs(hint)
        except Exception as error:
            msg = f"Unable to create serializer for {cls} member {name}"
            raise Exception(msg) from error
        inside = [annotation for annotation in split(hint)[1] if isinstance(annotation, Default)]
        if hasattr(cls, name):
            self.default = Default(getattr(cls, name))
        else:
            self.default = inside[0] if inside else Default(self.stored.default())

    def write(self, node, value):
        self.stored.check(value)
        self.stored.write(node, self.name, value)

    def read(self, node):
        if not self.stored.isIn(node, self.name):
            self.write(node, self.default.value)
        return self.stored.read(node, self.name)


class Bound:
    """A parameter of one node; remembers the value until the node says that it was modified."""

    def __init__(self, parameter, node):
        self.parameter, self.node, self.writing, self.tag = parameter, node, False, None
        if not parameter.stored.isIn(node, parameter.name):
            parameter.write(node, parameter.default.value)
        if parameter.stored.cached:
            self.value, me = parameter.read(node), weakref.ref(self)
            self.tag = node.AddObserver(vtk.vtkCommand.ModifiedEvent, lambda *_: me().refresh())

    def __del__(self):
        if self.tag is not None:
            self.node.RemoveObserver(self.tag)

    def refresh(self):
        if not self.writing:
            self.value = self.parameter.read(self.node)

    def read(self):
        return self.parameter.read(self.node) if self.tag is None else self.value

    def write(self, value):
        self.writing = True
        try:
            with slicer.util.NodeModify(self.node):
                self.parameter.write(self.node, value)
                if self.tag is not None:
                    self.value = self.parameter.read(self.node)
        finally:
            self.writing = False


class Wrapper:
    """What every class gets that is decorated with parameterNodeWrapper."""

    def __init__(self, parameterNode):
        self.parameterNode = parameterNode
        self._updating, self._connected = False, {}
        self._bound = {name: Bound(parameter, parameterNode) for name, parameter in self.allParameters.items()}

    def __setattr__(self, name, value):
        # Slicer lets a misspelt parameter pass here as a new attribute.
        if name != "parameterNode" and not name.startswith("_") and not hasattr(type(self), name):
            msg = f"'{type(self).__name__}' has no parameter '{name}'"
            raise AttributeError(msg)
        object.__setattr__(self, name, value)

    def getValue(self, name):
        return self._bound[self._known(name)].read()

    def setValue(self, name, value):
        self._bound[self._known(name)].write(value)

    def default(self, name):
        return self.allParameters[self._known(name)].default

    @classmethod
    def dataType(cls, name):
        return cls.allParameters[cls._known(name)].hint

    def isCached(self, name):
        return self.allParameters[self._known(name)].stored.cached

    def connectParametersToGui(self, mapping):
        """Bind parameters to widgets; the observer it adds stays for ever, as in Slicer 5.8."""
        connectors = {name: connectorFor(widget, self.dataType(name)) for name, widget in mapping.items()}
        tag = max(self._connected, default=-1) + 1
        self._connected[tag] = connectors
        for name, connector in connectors.items():
            connector.write(self.getValue(name))
            connector.onChanged(self._writer(name, connector))
        self.AddObserver(vtk.vtkCommand.ModifiedEvent, lambda *_: self._updateWidgets())
        return tag

    def connectGui(self, gui):
        """Bind the widgets that have a SlicerParameterName; returns no tag, as in Slicer 5.8."""
        widgets = [w for w in vars(gui).values() if w.property("SlicerParameterName")]
        self.connectParametersToGui({w.property("SlicerParameterName"): w for w in widgets})

    def disconnectGui(self, tag):
        for connector in self._connected.pop(tag, {}).values():
            connector.onChanged(None)

    def _writer(self, name, connector):
        def write():
            with slicer.util.NodeModify(self):
                if not self._updating:
                    self.setValue(name, connector.read())

        return write

    def _updateWidgets(self):
        if self._updating:
            return
        self._updating = True
        try:
            with slicer.util.NodeModify(self):
                for connectors in self._connected.values():
                    for name, connector in connectors.items():
                        connector.write(self.getValue(name))
        finally:
            self._updating = False

    @classmethod
    def _known(cls, name):
        if name not in cls.allParameters:
            msg = f"Cannot find a param with the given name: {name}; there are {', '.join(cls.allParameters)}"
            raise ValueError(msg)
        return name

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


def parameterNodeWrapper(cls=None):
    """Class decorator: annotated names of the class become parameters of a node."""
    if cls is None:
        return parameterNodeWrapper
    parameters = {}
    for name, hint in typing.get_type_hints(cls, include_extras=True).items():
        parameters[name] = Parameter(cls, name, hint)
        setattr(cls, name, _attribute(name))
    cls.allParameters, cls._is_parameter_node_wrapper = parameters, True
    for name, member in vars(Wrapper).items():
        if name in ("__init__", "__setattr__"):
            setattr(cls, name, member)
        elif not name.startswith("__"):
            if hasattr(cls, name):
                msg = f"Cannot use reserved name '{name}' in a parameterNodeWrapper"
                raise ValueError(msg)
            setattr(cls, name, member)
    return cls


def _attribute(name):
    return property(lambda self: self._bound[name].read(), lambda self, value: self._bound[name].write(value))


def isParameterNodeWrapper(classOrObject):
    return getattr(classOrObject, "_is_parameter_node_wrapper", False)
