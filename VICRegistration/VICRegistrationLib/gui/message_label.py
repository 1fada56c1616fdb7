"""A message in the panel: one line for each of its lines, the whole of it on demand."""

from __future__ import annotations

import html

from slicer.i18n import tr as _

# What a panel of 400 pixels has room for in one line.
_LONGEST_LINE = 58


class MessageLabel:
    """Shows a message in a label; lines that are too long are shortened until all is asked for.

    Parameters
    ----------
    label : QLabel
        With links that can be clicked. Its own tooltip is shown where no line is shortened.
    """

    def __init__(self, label):
        self._label, self._text, self._isWhole = label, "", False
        self._toolTip = label.toolTip
        label.connect("linkActivated(QString)", self._linkClicked)

    def show(self, text):
        """Show a message.

        Parameters
        ----------
        text : str
            The first line is shown as it is, those after it shortened to one line each.
        """
        if text != self._text:
            self._text, self._isWhole = text, False
        self._fill()

    def _fill(self):
        first, *others = self._text.split("\n")
        short = [_shortened(line) for line in others]
        self._label.toolTip = self._text if short != others else self._toolTip
        if short == others:
            self._label.text = self._text
            return
        link = _("Show less") if self._isWhole else _("Show all")
        lines = [first, *(others if self._isWhole else short)]
        self._label.text = "<br>".join([*map(html.escape, lines), f'<a href="#">{html.escape(link)}</a>'])

    def _linkClicked(self, _link=None):
        self._isWhole = not self._isWhole
        self._fill()


def _shortened(line):
    """Cut a line at a word, with dots for the rest."""
    if len(line) <= _LONGEST_LINE:
        return line
    return line[: line.rfind(" ", 0, _LONGEST_LINE)].rstrip(" ,;:") + " ..."
