"""Numbers behind the names of Qt's enums, as far as they matter."""

from __future__ import annotations

QT = {
    "UserRole": 256,
    "DisplayRole": 0,
    "DecorationRole": 1,
    "EditRole": 2,
    "ToolTipRole": 3,
    "StatusTipRole": 4,
    "FontRole": 6,
    "TextAlignmentRole": 7,
    "BackgroundRole": 8,
    "ForegroundRole": 9,
    "CheckStateRole": 10,
    "NoItemFlags": 0,
    "ItemIsSelectable": 1,
    "ItemIsEditable": 2,
    "ItemIsUserCheckable": 16,
    "ItemIsEnabled": 32,
    "Unchecked": 0,
    "PartiallyChecked": 1,
    "Checked": 2,
    "AlignLeft": 1,
    "AlignRight": 2,
    "AlignHCenter": 4,
    "AlignTop": 32,
    "AlignBottom": 64,
    "AlignVCenter": 128,
    "AlignCenter": 132,
    "Horizontal": 1,
    "Vertical": 2,
    "PlainText": 0,
    "RichText": 1,
    "AutoText": 2,
    "NoTextInteraction": 0,
    "TextSelectableByMouse": 1,
    "TextSelectableByKeyboard": 2,
    "ArrowCursor": 0,
    "WaitCursor": 3,
    "BusyCursor": 16,
    "NoContextMenu": 0,
    "CustomContextMenu": 3,
    "NoFocus": 0,
    "StrongFocus": 11,
    "NoModifier": 0,
    "Key_Return": 0x01000004,
    "Key_Delete": 0x01000007,
    "Key_Escape": 0x01000000,
    "ToolButtonIconOnly": 0,
    "ToolButtonTextBesideIcon": 2,
}

# Enums that carry numbers which code adds up or compares; others get numbers of their own.
NUMBERS = {
    "QHeaderView": {"Interactive": 0, "Stretch": 1, "Fixed": 2, "ResizeToContents": 3},
    "QTableWidget": {
        **{"NoEditTriggers": 0, "CurrentChanged": 1, "DoubleClicked": 2, "SelectedClicked": 4, "EditKeyPressed": 8},
        **{"NoSelection": 0, "SingleSelection": 1, "MultiSelection": 2, "ExtendedSelection": 3},
        **{"SelectItems": 0, "SelectRows": 1, "SelectColumns": 2},
    },
    "qSlicerMarkupsPlaceWidget": {
        **{"ForcePlaceSingleMarkup": 0, "ForcePlaceMultipleMarkups": 1},
        **{"HidePlaceMultipleMarkupsOption": 2, "ShowPlaceMultipleMarkupsOption": 3},
    },
    "QMessageBox": {
        **{"Ok": 0x400, "Cancel": 0x400000, "Yes": 0x4000, "No": 0x10000, "Retry": 0x80000, "Close": 0x200000},
        **{"NoIcon": 0, "Information": 1, "Warning": 2, "Critical": 3, "Question": 4, "NoButton": 0},
    },
}
NUMBERS["QAbstractItemView"] = NUMBERS["QTableWidget"]

SIZE_POLICY = {
    **{"Fixed": 0, "Minimum": 1, "Maximum": 4, "Preferred": 5, "MinimumExpanding": 3, "Expanding": 7, "Ignored": 13}
}


class Named(int):
    """A member of an enum, or an enum itself, through which its members can be reached too."""

    def __new__(cls, owner, name, number):
        value = super().__new__(cls, number)
        value.owner, value.name = owner, name
        return value

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.owner, name)

    def __repr__(self):
        return f"{self.owner.__name__}.{self.name}"


def member(cls, name, names):
    """Member `name` of a class with recorded enum names."""
    known = NUMBERS.get(cls.__name__, {})
    number = known.get(name, 1000 + sorted(names).index(name))
    return Named(cls, name, number)


class Namespace(type):
    """Class of nothing but enum members, such as qt.Qt."""

    def __getattr__(cls, name):
        if name in cls.numbers:
            return Named(cls, name, cls.numbers[name])
        msg = f"'{cls.__name__}' has no attribute '{name}' in the stand-in"
        raise AttributeError(msg)


class Qt(metaclass=Namespace):
    """Enums of Qt itself."""

    numbers = QT


class QSizePolicy(metaclass=Namespace):
    """How a widget takes space."""

    numbers = SIZE_POLICY

    def __init__(self, horizontal=5, vertical=5):
        self.horizontal, self.vertical = horizontal, vertical


class QEventLoop(metaclass=Namespace):
    """Which events are processed; loops of their own are not needed."""

    numbers = {"AllEvents": 0, "ExcludeUserInputEvents": 1}
