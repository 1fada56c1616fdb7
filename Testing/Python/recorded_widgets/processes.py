"""Stand-in of QProcess: a real process, looked at from the event loop."""

from __future__ import annotations

import subprocess
import threading

from .base import Recorded
from .event_loop import LOOP

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
        self._process, self._readers, self._lock = None, [], threading.Lock()
        self._buffers = {"StandardOutput": b"", "StandardError": b""}
        self._merged = False

    def setProcessChannelMode(self, mode):
        self._merged = mode == self.MergedChannels

    def start(self, program, arguments):
        try:
            self._process = subprocess.Popen(
                [program, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT if self._merged else subprocess.PIPE,
            )
        except OSError:
            self._emit("errorOccurred", self.FailedToStart)
            return
        streams = {"StandardOutput": self._process.stdout, "StandardError": self._process.stderr}
        for channel, stream in streams.items():
            if stream is not None:
                self._readers.append(threading.Thread(target=self._collect, args=(channel, stream), daemon=True))
                self._readers[-1].start()
        LOOP.post(_LOOK_MS, self._look)

    def readAllStandardOutput(self):
        return self._taken("StandardOutput")

    def readAllStandardError(self):
        return self._taken("StandardError")

    def state(self):
        return self.Running if self._process is not None and self._process.poll() is None else self.NotRunning

    def closeWriteChannel(self):
        self._process.stdin.close()

    def kill(self):
        if self.state() == self.Running:
            self._process.kill()

    def _taken(self, channel):
        with self._lock:
            read, self._buffers[channel] = self._buffers[channel], b""
        return Bytes(read)

    def _collect(self, channel, stream):
        with stream:
            for line in stream:
                with self._lock:
                    self._buffers[channel] += line

    def _look(self):
        # Virtual time passes at once: the look waits a little, or it would turn idly.
        self._readers[0].join(timeout=_LOOK_MS / 1000)
        ended = not any(reader.is_alive() for reader in self._readers)
        for channel, content in self._buffers.items():
            if content:
                self._emit(f"readyRead{channel}")
        if not ended:
            LOOP.post(_LOOK_MS, self._look)
            return
        code = self._process.wait()
        self._process.stdin.close()
        crashed = code < 0
        if crashed:
            self._emit("errorOccurred", self.Crashed)
        self._emit("finished", code, self.CrashExit if crashed else self.NormalExit)
