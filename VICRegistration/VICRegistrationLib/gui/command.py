"""The command line of the library in a process of its own, watched from Qt's event loop."""

from __future__ import annotations

import sys
from pathlib import Path

import qt

_LIBRARY = Path(__file__).resolve().parents[2]
_PROGRAM = """\
import sys
sys.path.insert(0, sys.argv.pop(1))
from VICRegistrationLib.cli.process import end_with_stdin
end_with_stdin()
from VICRegistrationLib.cli import main
sys.exit(main(program=""))
"""


class Command:
    """A command of ``vic-registration`` that runs while the panel stays alive.

    Parameters
    ----------
    arguments : list of str
        Words of the command.
    onLine : callable
        Called with every line of progress; where it fails, the last one is the sentence that says why.
    onEnd : callable
        Called once with its exit code, which is 0, or another one if it failed, crashed or was cancelled; and with what
        it printed as its result.
    patience : int
        How long the process may take to remove its drafts after it was cancelled, before it is killed, ms.
    """

    def __init__(self, arguments, onLine, onEnd, *, patience=3000):
        self._onLine, self._onEnd, self._rest, self._patience = onLine, onEnd, "", patience
        self._process = qt.QProcess()
        # Progress comes by the one channel, the result by the other.
        self._process.setProcessChannelMode(qt.QProcess.SeparateChannels)
        self._process.connect("readyReadStandardError()", self._read)
        self._process.connect("finished(int,QProcess::ExitStatus)", self._finished)
        self._process.connect("errorOccurred(QProcess::ProcessError)", self._failed)
        # Slicer sets it to PythonSlicer. Windows has other encodings for pipes.
        self._process.start(sys.executable, ["-X", "utf8", "-c", _PROGRAM, str(_LIBRARY), *arguments])

    def cancel(self):
        """Ask the process to end, and end it if it does not."""
        # Slicer's Python runs behind a launcher, which hands on what is written, but no signal.
        self._process.closeWriteChannel()
        qt.QTimer.singleShot(self._patience, self._kill)

    def _kill(self):
        if self._process.state() != qt.QProcess.NotRunning:
            self._process.kill()

    def _read(self):
        self._rest += _text(self._process.readAllStandardError())
        *lines, self._rest = self._rest.split("\n")
        for line in lines:
            if line.strip():
                self._onLine(line.strip())

    def _finished(self, code, status):
        self._read()
        output = _text(self._process.readAllStandardOutput())
        self._onEnd(code if status == qt.QProcess.NormalExit else -1, output.strip())

    def _failed(self, error):
        # A process that has crashed finishes as well.
        if error == qt.QProcess.FailedToStart:
            # It may be called while the process is being started.
            qt.QTimer.singleShot(0, lambda: self._onEnd(-1, ""))


def _text(content):
    return content.data().decode("utf-8", "replace").replace("\r\n", "\n")
