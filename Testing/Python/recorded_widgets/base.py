"""Base of all stand-ins: properties, signals and members as recorded, and an AttributeError for everything else."""

from __future__ import annotations

import inspect

from .record import argumentTypes, load

# Members that only change looks may be called, and do nothing.
SILENT = ("setFixedHeight", "setHorizontalHeaderLabels", "setSectionResizeMode")
EMPTY = {"bool": False, "int": 0, "double": 0.0, "QString": ""}
# As PythonQt takes them: no np.float32 and no np.int64; np.float64 is a float.
ACCEPTED = {"bool": int, "int": int, "double": (int, float), "QString": str}


class Missing:
    """Hides a method that a base class has, and the recorded class has not."""

    def __init__(self, name):
        self.name = name

    def __get__(self, instance, owner):
        raise _unknown(owner, self.name)


class RecordedType(type):
    """Gives classes their record, hides what is not in it, and knows the names of enums."""

    def __new__(mcs, name, bases, namespace, record=True):
        cls = super().__new__(mcs, name, bases, namespace)
        # A class derived in the project from one of Slicer's has the record of that.
        cls.record_ = load().get(name, cls.record_) if record else None
        if record and name in load():
            for member in dir(cls):
                if not member.startswith("_") and member not in ("record_", *cls.record_.members):
                    setattr(cls, member, Missing(member))
        return cls

    def __init__(cls, name, bases, namespace, record=True):
        super().__init__(name, bases, namespace)

    def __getattr__(cls, name):
        if cls.record_ is not None and name[:1].isupper() and name in cls.record_.members:
            # A member of an enum, by a number of its own.
            return sorted(cls.record_.members).index(name)
        raise _unknown(cls, name)


class Signal:
    """A signal of an object, as in ``button.clicked``."""

    def __init__(self, owner, name):
        self._owner, self._name = owner, name

    def connect(self, handler):
        self._owner._connect(self._name, None, handler)
        return True

    def disconnect(self, handler):
        self._owner._handlers[self._name].remove((None, handler))
        return True


class Recorded(metaclass=RecordedType, record=False):
    """An object of a recorded class.

    A subclass gives behaviour by ``_set_<property>`` and ``_get_<property>``, and by methods that are in the record.
    """

    _notify: dict = {}
    _defaults: dict = {}

    def __init__(self, *arguments):
        self._values, self._handlers = {}, {}
        self._blocked = self._destroyed = False
        self._objects, self._owner = [], None
        for argument in arguments:
            self._construct(argument)

    def _construct(self, argument):
        """Take an argument of the constructor: the parent."""
        if not isinstance(argument, Recorded):
            msg = f"The stand-in of {type(self).__name__} cannot be made from {argument!r}"
            raise TypeError(msg)
        self._adoptedBy(argument)

    # --- properties and members ---

    def __getattribute__(self, name):
        if not name.startswith("_") and object.__getattribute__(self, "_destroyed"):
            msg = f"Trying to call '{name}' on a destroyed {type(self).__name__} object"
            raise ValueError(msg)
        return object.__getattribute__(self, name)

    def __getattr__(self, name):
        record = type(self).record_
        if name == "name" and "objectName" in record.properties:
            name = "objectName"
        if name in record.properties:
            return self._get(name)
        if name in record.signals:
            return Signal(self, name)
        if name not in record.members:
            raise _unknown(type(self), name)
        if name[0].isupper():
            return getattr(type(self), name)
        return self._member(name)

    def _member(self, name):
        setter, getter = self.record_.setter(name), self.record_.getter(name)
        if setter:
            return lambda value: self._set(setter, value)
        if getter:
            return lambda: self._get(getter)
        if name in SILENT:
            return lambda *arguments: None

        def refuse(*arguments):
            msg = f"{type(self).__name__}.{name} exists in Slicer; the stand-in cannot do it"
            raise NotImplementedError(msg)

        return refuse

    def __setattr__(self, name, value):
        if name.startswith("_"):
            object.__setattr__(self, name, value)
        elif name == "name" and "objectName" in self.record_.properties:
            self._set("objectName", value)
        elif name in self.record_.properties:
            self._set(name, value)
        else:
            raise _unknown(type(self), name)

    def _get(self, name):
        if hasattr(type(self), f"_get_{name}"):
            return getattr(self, f"_get_{name}")()
        default = self._defaults.get(name, EMPTY.get(self.record_.properties[name]))
        return self._values.get(name, default)

    def _set(self, name, value):
        expected = self.record_.properties[name]
        if not isinstance(value, ACCEPTED.get(expected, object)):
            msg = f"Property '{name}' of type '{expected}' of {type(self).__name__} does not accept {value!r}"
            raise AttributeError(msg)
        if expected in ("bool", "double"):
            value = bool(value) if expected == "bool" else float(value)
        if hasattr(type(self), f"_set_{name}"):
            getattr(self, f"_set_{name}")(value)
        else:
            self._store(name, value)

    def _store(self, name, value):
        """Set a property; its signal is emitted if that is a change. Returns whether it is."""
        changed = self._get(name) != value
        self._values[name] = value
        if changed and name in self._notify:
            self._emit(self._notify[name], value)
        return changed

    # --- signals ---

    def connect(self, signature, handler):
        self._connect(self._signal(signature), signature, handler)
        return True

    def blockSignals(self, block):
        was, self._blocked = self._blocked, bool(block)
        return was

    def _signal(self, signature):
        name = signature.partition("(")[0]
        if signature not in self.record_.signals.get(name, ()):
            raise _unknown(type(self), signature, "signal")
        return name

    def _connect(self, name, signature, handler):
        if not callable(handler):
            msg = f"{handler!r} cannot be connected to {name}; it is not callable"
            raise TypeError(msg)
        self._handlers.setdefault(name, []).append((signature, handler))

    def _emit(self, name, *arguments, **overloads):
        """Call what is connected; overloads give the argument for signatures of another type, as QString=text."""
        if self._blocked or self._destroyed:
            return
        for entry in list(self._handlers.get(name, ())):
            if entry in self._handlers.get(name, ()):
                signature, handler = entry
                types = argumentTypes(signature) if signature else None
                given = arguments if types is None else arguments[: len(types)]
                if types and types[0] in overloads:
                    given = (overloads[types[0]],)
                call(handler, given)

    # --- tree of objects ---

    def children(self):
        return list(self._objects)

    def className(self):
        return type(self).__name__

    def deleteLater(self):
        """Be gone; Slicer waits for the next turn of its event loop with that."""
        self._destroy()

    delete = deleteLater

    def _adoptedBy(self, owner):
        if self._owner is not None:
            self._owner._objects.remove(self)
        self._owner = owner
        if owner is not None:
            owner._objects.append(self)

    def _destroy(self):
        for child in list(self._objects):
            child._destroy()
        self._emit("destroyed")
        self._adoptedBy(None)
        self._destroyed = True


def call(handler, arguments):
    """Call a function with as many of the arguments as it takes, as PythonQt does."""
    try:
        parameters = inspect.signature(handler).parameters.values()
    except (TypeError, ValueError):
        return handler(*arguments)
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    if not any(parameter.kind is inspect.Parameter.VAR_POSITIONAL for parameter in parameters):
        arguments = arguments[: sum(parameter.kind in kinds for parameter in parameters)]
    return handler(*arguments)


def _unknown(cls, name, what="attribute"):
    return AttributeError(f"'{cls.__name__}' has no {what} '{name}' in a real Slicer")
