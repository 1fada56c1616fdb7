"""The buttons of a widget that places points."""

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
