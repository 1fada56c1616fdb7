"""Stand-ins of what is no widget: timers, colours, icons, settings, dialogs that nobody answers."""

from __future__ import annotations

import weakref

from .base import Recorded, call
from .event_loop import LOOP


class QTimer(Recorded):
    """Fires in the virtual time of the event loop; without a reference to it, it is gone and never fires."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._entry = None

    def start(self, milliseconds=None):
        if milliseconds is not None:
            self._set("interval", milliseconds)
        self.stop()
        me = weakref.ref(self)
        self._entry = LOOP.post(self._get("interval"), lambda: me() is not None and me()._fire())

    def stop(self):
        if self._entry is not None:
            self._entry[2] = self._entry = None

    def _fire(self):
        self._entry = None
        if self._destroyed:
            return
        if not self._get("singleShot"):
            self.start()
        self._emit("timeout")

    def _get_active(self):
        return self._entry is not None

    class _SingleShot:
        """Static method on the class, property of an object, as in PythonQt."""

        def __get__(self, timer, owner):
            if timer is not None:
                return timer._get("singleShot")
            return lambda milliseconds, handler: LOOP.post(milliseconds, lambda: call(handler, ()))

        def __set__(self, timer, value):
            timer._set("singleShot", value)

    singleShot = _SingleShot()

    def __setattr__(self, name, value):
        if name == "singleShot":
            self._set(name, value)
        else:
            super().__setattr__(name, value)


class Value(Recorded, record=False):
    """Base of objects that are compared by what they are."""

    def __eq__(self, other):
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self):
        return hash(self._key())


class QColor(Value):
    """A colour, kept as 16 bit per channel like Qt does."""

    def __init__(self, *arguments):
        super().__init__()
        self._channels = (0.0, 0.0, 0.0, 1.0)
        self._valid = bool(arguments)
        if arguments and isinstance(arguments[0], QColor):
            self._channels, self._valid = arguments[0]._channels, arguments[0]._valid
        elif arguments and isinstance(arguments[0], str):
            self._fromName(arguments[0])
        elif arguments:
            self.setRgbF(*(value / 255 for value in arguments))

    @staticmethod
    def fromRgbF(red, green, blue, alpha=1.0):
        color = QColor(0, 0, 0)
        color.setRgbF(red, green, blue, alpha)
        return color

    def setRgbF(self, *channels):
        if not all(0 <= channel <= 1 for channel in channels):
            msg = f"QColor::setRgbF: parameters out of range: {channels}"
            raise ValueError(msg)
        rounded = tuple(round(channel * 65535) / 65535 for channel in channels)
        self._channels, self._valid = (*rounded, 1.0)[:4], True

    def redF(self):
        return self._channels[0]

    def greenF(self):
        return self._channels[1]

    def blueF(self):
        return self._channels[2]

    def name(self, *form):
        return "#" + "".join(f"{round(channel * 255):02x}" for channel in self._channels[:3])

    def isValid(self):
        return self._valid

    def _fromName(self, name):
        digits = name.lstrip("#")
        if len(digits) != 6:
            msg = f"The stand-in knows colours as #rrggbb, not {name!r}"
            raise ValueError(msg)
        self.setRgbF(*(int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)))

    def _key(self):
        return self._channels, self._valid


class QIcon(Value):
    """A picture, known by the path it was made from."""

    def __init__(self, path=""):
        super().__init__()
        self._path = path._path if isinstance(path, QIcon) else path

    def isNull(self):
        return self._path == ""

    def _key(self):
        return self._path


class QSize(Value):
    """Width and height."""

    def __init__(self, width=-1, height=-1):
        super().__init__()
        self._key_ = (width, height)

    def isValid(self):
        return min(self._key_) >= 0

    def width(self):
        return self._key_[0]

    def height(self):
        return self._key_[1]

    def _key(self):
        return self._key_


class QSettings(Recorded):
    """Settings, kept until the process ends."""

    _stored: dict = {}

    def value(self, key, default=None):
        return self._stored.get(key, default)

    def setValue(self, key, value):
        self._stored[key] = value

    def contains(self, key):
        return key in self._stored

    def remove(self, key):
        self._stored.pop(key, None)


class QApplication:
    """The cursor, which slicer.util.WaitCursor changes; this class was not recorded."""

    __slots__ = ()
    cursors: list = []

    @classmethod
    def setOverrideCursor(cls, cursor):
        cls.cursors.append(cursor)

    @classmethod
    def restoreOverrideCursor(cls):
        cls.cursors.pop()
