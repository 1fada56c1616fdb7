"""Stand-in of QProcess: a real process, looked at from the event loop."""

from __future__ import annotations

import subprocess
import threading

from .base import Recorded
from .loop import LOOP

_LOOK_MS = 20


class Bytes:
    """What is read off a process, as a QByteArray."""

    def __init__(self, content):
        self._content = content

    def data(self):
        return self._content


class QProcess(Recorded):
    """Starts a process; its output and its end are told when events are processed."""

    MergedChannels, SeparateChannels = 1, 0
    NotRunning, Starting, Running = 0, 1, 2
    NormalExit, CrashExit = 0, 1
    FailedToStart, Crashed = 0, 1

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._process, self._reader, self._buffer, self._lock = None, None, b"", threading.Lock()
        self._merged = False

    def setProcessChannelMode(self, mode):
        self._merged = mode == self.MergedChannels

    def start(self, program, arguments):
        try:
            self._process = subprocess.Popen(
                [program, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT if self._merged else subprocess.DEVNULL,
            )
        except OSError:
            self._emit("errorOccurred", self.FailedToStart)
            return
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()
        LOOP.post(_LOOK_MS, self._look)

    def readAllStandardOutput(self):
        with self._lock:
            read, self._buffer = self._buffer, b""
        return Bytes(read)

    def state(self):
        return self.Running if self._process is not None and self._process.poll() is None else self.NotRunning

    def terminate(self):
        if self.state() == self.Running:
            self._process.terminate()

    def kill(self):
        if self.state() == self.Running:
            self._process.kill()

    def _collect(self):
        with self._process.stdout as output:
            for line in output:
                with self._lock:
                    self._buffer += line

    def _look(self):
        # Virtual time passes at once: the look waits a little, or it would turn idly.
        self._reader.join(timeout=_LOOK_MS / 1000)
        ended = not self._reader.is_alive()
        if self._buffer:
            self._emit("readyReadStandardOutput")
        if not ended:
            LOOP.post(_LOOK_MS, self._look)
            return
        code = self._process.wait()
        crashed = code < 0
        if crashed:
            self._emit("errorOccurred", self.Crashed)
        self._emit("finished", code, self.CrashExit if crashed else self.NormalExit)
