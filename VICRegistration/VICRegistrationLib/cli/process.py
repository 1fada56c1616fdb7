"""The process of a command: its signals, and messages that C libraries print on its stderr."""

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


# What each signal raises, and the handlers that may be replaced.
_ENDS = {signal.SIGTERM: Terminated, signal.SIGINT: KeyboardInterrupt}
_USUAL = (signal.SIG_DFL, signal.default_int_handler)
# Delay before a signal is sent again, s.
_SOON_S = 0.01


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM and Ctrl-C end the block by an exception, so that drafts are removed, even during imports.

    Raises
    ------
    Terminated
        When SIGTERM arrives. Nothing is changed outside of the main thread, where Python handles no signals, nor for
        a signal that is ignored or has a handler of its own.
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
        # Python drops exceptions that are raised while it deletes objects, so the signal is sent again.
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
        # During an import, Python and libraries may wrap the signal's exception into one of their own.
        if arrived:
            raise arrived[0] from None
        raise
    finally:
        sys.unraisablehook = usual_hook
        for number, usual in mine.items():
            signal.signal(number, usual)


def end_with_stdin() -> None:
    """End the process as by SIGTERM when its stdin is closed, or the program that started it has ended.

    For programs that start it through a launcher, as Slicer does: their signals reach only the launcher.
    """

    def watch() -> None:
        # Not by sys.stdin, whose lock would block Python at its end.
        with contextlib.suppress(OSError):
            while os.read(0, 1024):
                pass
        # SIGTERM, because SIGINT is ignored in processes that were started in the background.
        _send_to_main_thread(signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def _send_to_main_thread(number: int) -> None:
    """Send a signal to the main thread, where Python handles it, even while that thread waits."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident, number)
    else:
        signal.raise_signal(number)


def flush_or_drop(stream: TextIO) -> None:
    """Flush a stream; if its reader has closed it, discard its contents and all later output.

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
    """Discard what C libraries write to file descriptor 2: image readers print there.

    Errors are not lost, because SimpleITK raises them too.
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
