"""The event loop of the stand-ins: timers in virtual time, which passes as fast as it is asked to."""

from __future__ import annotations

import heapq
import itertools

# So many rounds without anything to do are no wait any more.
IDLE_ROUNDS = 1000


class EventLoop:
    """Runs what is due, in order of time."""

    def __init__(self):
        self._queue, self._order, self.now, self._idle = [], itertools.count(), 0, 0

    def post(self, milliseconds, call):
        """Have something called later.

        Parameters
        ----------
        milliseconds : int
        call : callable

        Returns
        -------
        list
            The entry; put None in its last place to call it off.
        """
        entry = [self.now + max(0, milliseconds), next(self._order), call]
        heapq.heappush(self._queue, entry)
        return entry

    def processEvents(self, *arguments):
        """One round: what is due now, or else what comes next; what is posted meanwhile waits for another round.

        Raises
        ------
        AssertionError
            If nothing was waiting in many rounds in a row: what the caller waits for never comes.
        """
        self._idle = 0 if self._drop() else self._idle + 1
        if self._idle > IDLE_ROUNDS:
            self._idle = 0
            msg = "the condition does not hold, and no timer is waiting"
            raise AssertionError(msg)
        if self._queue:
            self._round(max(self.now, self._queue[0][0]))

    def waitFor(self, condition):
        """Process events until a condition holds; AssertionError if nothing is left to wait for."""
        while not condition():
            self.processEvents()

    def clear(self):
        """Forget what waits."""
        self._queue.clear()

    def _drop(self):
        """Forget what was called off; whether anything waits."""
        while self._queue and self._queue[0][2] is None:
            heapq.heappop(self._queue)
        return bool(self._queue)

    def _round(self, time):
        self.now = time
        due = []
        while self._queue and self._queue[0][0] <= time:
            due.append(heapq.heappop(self._queue))
        for entry in due:
            if entry[2] is not None:
                entry[2]()


LOOP = EventLoop()
