"""Setting widgets without their signals."""

from __future__ import annotations

import contextlib


@contextlib.contextmanager
def signalsBlocked(widget):
    """Let a widget emit no signals meanwhile, so that what it is made to show is not taken for a choice of the user.

    Parameters
    ----------
    widget : QWidget
    """
    blocked = widget.blockSignals(True)
    try:
        yield
    finally:
        widget.blockSignals(blocked)
