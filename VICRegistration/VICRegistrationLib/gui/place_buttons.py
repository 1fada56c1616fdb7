"""The buttons of a widget that places points, and the mode that they switch on."""

from __future__ import annotations


def showPlaceButtons(widget):
    """Show the buttons that place and delete points, and none of the others.

    Parameters
    ----------
    widget : qSlicerMarkupsPlaceWidget
    """
    widget.buttonsVisible = False
    widget.placeButton().show()
    widget.deleteButton().show()


def stopPlacing(widget):
    """Leave the mode in which clicks place points of a widget's list; the mode of another list stays.

    Parameters
    ----------
    widget : qSlicerMarkupsPlaceWidget
    """
    if widget.placeModeEnabled:
        widget.setPlaceModeEnabled(False)
