"""Runs a generator from Qt's event loop in short slices of time, so that the panel stays responsive."""

from __future__ import annotations

import logging
import time

import qt
from slicer.i18n import tr as _

# Length of a slice of time, s; a step that takes longer is not interrupted.
SLICE_S = 0.05


class StepRunner:
    """Takes steps of a generator whenever Qt has time, until it ends or is cancelled.

    Parameters
    ----------
    steps : generator
    onStep : callable
        Called with the newest step after every slice of time.
    onEnd : callable
        Called once, with a text that says why there is no result; empty if there is one.
    """

    def __init__(self, steps, onStep, onEnd):
        self._steps, self._onStep, self._onEnd = steps, onStep, onEnd
        self._running, self._cancelled = True, False
        qt.QTimer.singleShot(0, self._slice)

    def cancel(self):
        """End before the next step."""
        self._cancelled = True

    def stop(self):
        """End now, because the scene is closed."""
        if self._running:
            self._end(_("Cancelled; everything is as it was before."))

    def _slice(self):
        # An exception in a timer's slot would be printed and forgotten, and the run would hang.
        if self._cancelled:
            self.stop()
        if not self._running:
            return
        end = time.perf_counter() + SLICE_S
        try:
            step = next(self._steps)
            while time.perf_counter() < end:
                step = next(self._steps)
            self._onStep(step)
        except StopIteration:
            self._end("")
        except ValueError as error:
            self._end(str(error))
        except Exception:
            logging.exception("The fit failed")
            self._end(_("The fit failed because of an unexpected error. The log has it (Help > Report a Bug)."))
        else:
            qt.QTimer.singleShot(0, self._slice)

    def _end(self, problem):
        self._running = False
        self._steps.close()
        self._onEnd(problem)
