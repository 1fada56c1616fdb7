"""The command line of the library in a process of its own, observed from Qt's event loop."""

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
    """A command of ``vic-registration`` that runs while the panel stays responsive.

    Parameters
    ----------
    arguments : list of str
        Arguments of ``vic-registration``.
    onLine : callable
        Called with every line of progress; if the command fails, the last line says why.
    onEnd : callable
        Called once, with the exit code (0, or another one if the command failed, crashed or was cancelled) and with
        the text that it printed as its result.
    patience : int
        How long the process may take to remove its drafts after it was cancelled, before it is killed, ms.
    """

    def __init__(self, arguments, onLine, onEnd, *, patience=3000):
        self._onLine, self._onEnd, self._rest, self._patience = onLine, onEnd, "", patience
        self._process = qt.QProcess()
        # Progress comes on standard error, the result on standard output.
        self._process.setProcessChannelMode(qt.QProcess.SeparateChannels)
        self._process.connect("readyReadStandardError()", self._read)
        self._process.connect("finished(int,QProcess::ExitStatus)", self._finished)
        self._process.connect("errorOccurred(QProcess::ProcessError)", self._failed)
        # In Slicer, sys.executable is PythonSlicer. Without utf8 mode, pipes on Windows have another encoding.
        self._process.start(sys.executable, ["-X", "utf8", "-c", _PROGRAM, str(_LIBRARY), *arguments])

    def cancel(self):
        """Ask the process to end, and kill it if it does not."""
        # By closing its input: Slicer's launcher of Python passes on input, but no signals.
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
            # Later, because this may be called from the constructor.
            qt.QTimer.singleShot(0, lambda: self._onEnd(-1, ""))


def _text(content):
    return content.data().decode("utf-8", "replace").replace("\r\n", "\n")
