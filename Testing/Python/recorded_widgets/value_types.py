"""Stand-ins of what is no widget: timers, colours, icons, settings, dialogs that nobody answers."""

from __future__ import annotations

import weakref

from .base import Recorded, call
from .event_loop import LOOP


class Qt:
    """Enums of Qt itself: roles and flags, which code adds up or compares."""

    DecorationRole, UserRole = 1, 256
    ItemIsSelectable, ItemIsEditable, ItemIsEnabled = 1, 2, 32
    WaitCursor = 3


class QTimer(Recorded):
    """Fires once in the virtual time of the event loop; without a reference to it, it is gone and never fires."""

    _entry = None

    @staticmethod
    def singleShot(milliseconds, handler):
        LOOP.post(milliseconds, lambda: call(handler, ()))

    def start(self):
        if not self._get("singleShot"):
            msg = "The stand-in of QTimer fires once only; call setSingleShot(True)"
            raise NotImplementedError(msg)
        self.stop()
        me = weakref.ref(self)
        self._entry = LOOP.post(self._get("interval"), lambda: me() is not None and me()._fire())

    def stop(self):
        if self._entry is not None:
            self._entry[2] = self._entry = None

    def _fire(self):
        self._entry = None
        self._emit("timeout")

    def _get_active(self):
        return self._entry is not None


class QColor(Recorded):
    """A colour, kept as 16 bit per channel like Qt does."""

    _channels = (0.0, 0.0, 0.0)

    def _construct(self, argument):
        """Take another colour, or the name of one as #rrggbb."""
        if isinstance(argument, QColor):
            self._channels = argument._channels
        else:
            self._channels = tuple(int(argument[i : i + 2], 16) / 255 for i in (1, 3, 5))

    @staticmethod
    def fromRgbF(red, green, blue):
        color = QColor()
        color._channels = tuple(round(channel * 65535) / 65535 for channel in (red, green, blue))
        return color

    def redF(self):
        return self._channels[0]

    def greenF(self):
        return self._channels[1]

    def blueF(self):
        return self._channels[2]

    def __eq__(self, other):
        return isinstance(other, QColor) and self._channels == other._channels

    __hash__ = None


class QIcon(Recorded):
    """A picture in a file."""

    def _construct(self, argument):
        """Take a path."""


class QSize(Recorded):
    """A height."""

    def _construct(self, argument):
        self._height = argument

    def height(self):
        return self._height


class QSettings(Recorded):
    """Settings, kept until the process ends."""

    _stored: dict = {}

    def value(self, key, default=None):
        return self._stored.get(key, default)

    def setValue(self, key, value):
        self._stored[key] = value


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
