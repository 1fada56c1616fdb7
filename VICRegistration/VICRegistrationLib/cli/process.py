"""The process around a command: its signals, and what libraries written in C print on its stderr."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import TextIO


class Terminated(BaseException):
    """SIGTERM arrived."""


# What each signal raises, and who handles it where nobody has asked to.
_ENDS = {signal.SIGTERM: Terminated, signal.SIGINT: KeyboardInterrupt}
_USUAL = (signal.SIG_DFL, signal.default_int_handler)
# How long to wait until a signal is sent again, s.
_SOON_S = 0.01


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that drafts are removed, and both even while modules are imported.

    Raises
    ------
    Terminated
        When SIGTERM arrives. Nothing changes where Python handles no signals (outside of the main thread), nor for a
        signal that is ignored or that somebody else handles.
    KeyboardInterrupt
        After Ctrl-C.
    """
    arrived = []

    def end(number, frame):
        arrived.append(_ENDS[number])
        raise arrived[-1]

    def dropped(unraisable):
        numbers = [number for number, end in _ENDS.items() if unraisable.exc_type is end]
        if not (numbers and arrived):
            usual_hook(unraisable)
            return
        # Python drops what is raised while it throws objects away: again, once it is done with that.
        threading.Timer(_SOON_S, _send_to_main_thread, numbers).start()

    usual_hook = sys.unraisablehook
    mine = {}
    if threading.current_thread() is threading.main_thread():
        mine = {number: signal.getsignal(number) for number in _ENDS if signal.getsignal(number) in _USUAL}
    try:
        for number in mine:
            signal.signal(number, end)
        sys.unraisablehook = dropped
        yield
    except Exception:
        # Python wraps what is raised while a class is made (an import may be under way) into an error of its own, and
        # libraries what is raised while they are imported.
        if arrived:
            raise arrived[0] from None
        raise
    finally:
        sys.unraisablehook = usual_hook
        for number, usual in mine.items():
            signal.signal(number, usual)


def end_with_stdin() -> None:
    """Have the process end as by SIGTERM once its stdin is closed, or whoever has started it is gone.

    For programs that start it through a launcher, as Slicer does: signals reach the launcher only.
    """

    def watch() -> None:
        # Not through sys.stdin, whose lock would be held while Python ends.
        with contextlib.suppress(OSError):
            while os.read(0, 1024):
                pass
        # Not as by Ctrl-C, which is ignored in what was started in the background.
        _send_to_main_thread(signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def _send_to_main_thread(number: int) -> None:
    """Send a signal to the main thread, where Python handles it: it wakes up even if it waits for something."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident, number)
    else:
        signal.raise_signal(number)


def flush_or_drop(stream: TextIO) -> None:
    """Send what a stream holds; if nobody reads it any more, send it and what comes after it to nowhere.

    Parameters
    ----------
    stream : text file
        stdout or stderr.
    """
    try:
        stream.flush()
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, stream.fileno())
        finally:
            os.close(nowhere)


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
