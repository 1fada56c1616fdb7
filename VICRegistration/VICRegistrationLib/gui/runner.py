"""Runs a generator from Qt's event loop, a slice of time after the other, so that the panel stays alive."""

from __future__ import annotations

import enum
import logging
import time

import qt
from slicer.i18n import tr as _


class End(enum.Enum):
    """How a run ended."""

    DONE = "done"
    CANCELLED = "cancelled"
    FAILED = "failed"


# Length of a slice of time; a step that takes longer is not interrupted.
SLICE_S = 0.05


class StepRunner:
    """Takes steps of a generator whenever Qt has time, until it ends or is cancelled.

    Parameters
    ----------
    steps : generator
    onStep : callable
        Called with the newest step after every slice of time: screens cannot show more.
    onEnd : callable
        Called once with an :class:`End` and the generator's result, what is to be said of its failure, or None.
    """

    def __init__(self, steps, onStep, onEnd):
        self._steps, self._onStep, self._onEnd = steps, onStep, onEnd
        self._cancelled = False
        self.running = True
        qt.QTimer.singleShot(0, self._slice)

    def cancel(self):
        """End before the next step."""
        self._cancelled = True

    def stop(self):
        """End now: for when the scene goes."""
        if self.running:
            self._end(End.CANCELLED, None)

    def _slice(self):
        # An exception in a timer's slot would be printed and forgotten, and the run would hang.
        if not self.running:
            return
        if self._cancelled:
            self._end(End.CANCELLED, None)
            return
        end = time.perf_counter() + SLICE_S
        try:
            step = next(self._steps)
            while time.perf_counter() < end:
                step = next(self._steps)
            self._onStep(step)
        except StopIteration as finished:
            self._end(End.DONE, finished.value)
        except ValueError as error:
            self._end(End.FAILED, error)
        except Exception:
            logging.exception("The fit failed")
            self._end(
                End.FAILED,
                _("The fit failed for a reason that was not foreseen; the log has it (Help > Report a Bug)."),
            )
        else:
            qt.QTimer.singleShot(0, self._slice)

    def _end(self, end, value):
        self.running = False
        self._steps.close()
        self._onEnd(end, value)
