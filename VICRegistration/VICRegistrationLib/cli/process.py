"""The process around a command: its signals, and what libraries written in C print on its stderr."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator


class Terminated(BaseException):
    """SIGTERM arrived."""


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that drafts are removed.

    Raises
    ------
    Terminated
        When the signal arrives. Nothing changes where Python handles no signals (outside of the main thread), nor
        where the signal is ignored.
    """
    arrived = []

    def end(number, frame):
        arrived.append(number)
        raise Terminated

    if threading.current_thread() is not threading.main_thread() or (
        signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield
        return
    signal.signal(signal.SIGTERM, end)
    try:
        yield
    except Exception:
        # Python wraps what is raised while a class is made (an import may be under way) into an error of its own.
        if arrived:
            raise Terminated from None
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def silenced_stderr() -> Iterator[None]:
    """Send to nowhere what is written to file descriptor 2, past Python: readers of images complain there.

    An error they report through SimpleITK is not lost.
    """
    with contextlib.suppress(AttributeError, OSError, ValueError):
        sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:
        # There is no stderr.
        yield
        return
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, 2)
        finally:
            os.close(nowhere)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
