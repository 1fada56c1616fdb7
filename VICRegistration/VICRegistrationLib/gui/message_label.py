"""A message in the panel: its long lines are shortened, and shown completely on demand."""

from __future__ import annotations

import html

from slicer.i18n import tr as _

# Characters that fit into one line of a panel that is 400 pixels wide.
_LONGEST_LINE = 58


class MessageLabel:
    """Shows a message in a label; long lines are shortened until the user clicks on "Show all".

    Parameters
    ----------
    label : QLabel
        Its links must be clickable. Its own tooltip is shown if no line is shortened.
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
            The first line is shown completely, each of the others shortened to one line.
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
    """Cut a line between words, with dots for the rest; within a word if that one fills the line."""
    if len(line) <= _LONGEST_LINE:
        return line
    gap = line.rfind(" ", 0, _LONGEST_LINE)
    return line[: gap if gap > 0 else _LONGEST_LINE].rstrip(" ,;:") + " ..."
