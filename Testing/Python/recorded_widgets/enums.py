"""Numbers behind the names of Qt's enums, as far as they matter."""

from __future__ import annotations

QT = {
    "UserRole": 256,
    **{
        "DisplayRole": 0,
        "DecorationRole": 1,
        "EditRole": 2,
        "ToolTipRole": 3,
        "BackgroundRole": 8,
        "ForegroundRole": 9,
    },
    **{"NoItemFlags": 0, "ItemIsSelectable": 1, "ItemIsEditable": 2, "ItemIsEnabled": 32},
    **{"AlignLeft": 1, "AlignRight": 2, "AlignHCenter": 4, "AlignTop": 32, "AlignVCenter": 128, "AlignCenter": 132},
    **{"Horizontal": 1, "Vertical": 2, "WaitCursor": 3},
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
}
NUMBERS["QAbstractItemView"] = NUMBERS["QTableWidget"]


class Named(int):
    """A member of an enum."""

    def __new__(cls, owner, name, number):
        value = super().__new__(cls, number)
        value.owner, value.name = owner, name
        return value


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
