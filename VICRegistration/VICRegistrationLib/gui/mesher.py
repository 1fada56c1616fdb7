"""Meshing in a process of its own while the panel stays responsive."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import shutil
import subprocess
import tempfile
from pathlib import Path

import slicer
from slicer.i18n import tr as _

from ..mrml.exporting import loadMesh
from .command import Command

_VTU = ".vtu"


def meshFormats():
    """List the suffixes of mesh files, and their names in the panel.

    Returns
    -------
    tuple of (str, str)
    """
    return (
        (_VTU, _("Tetrahedra, shown in the scene (.vtu)")),
        (".msh", _("Tetrahedra for Gmsh (.msh)")),
        (".inp", _("Tetrahedra for Abaqus (.inp)")),
        (".med", _("Tetrahedra for Code_Aster, Salome (.med)")),
        (".bdf", _("Tetrahedra for Nastran (.bdf)")),
    )


class Mesher:
    """Runs ``vic-registration mesh``, one mesh at a time.

    Parameters
    ----------
    show : callable
        Called with a text: progress, the result, or an error.
    onChanged : callable
        Called without arguments when the process has begun or ended.
    """

    def __init__(self, show, onChanged):
        self._show, self._onChanged = show, onChanged
        self._command = self._work = self._path = None
        self._lines, self._cancelled = [], False

    @property
    def running(self):
        """Whether a mesh is being made."""
        return self._command is not None

    def mesh(self, arguments):
        """Begin a mesh; one in .vtu is loaded into the scene at the end.

        Parameters
        ----------
        arguments : callable
            Takes a folder for the input of the mesher; returns the arguments of the command and the path of the mesh.

        Raises
        ------
        ValueError, OSError
            Those that `arguments` raises; no file is left then.
        """
        if not _gmshIsThere() and not _installGmsh():
            self._show(
                _(
                    "A mesh needs the package gmsh, which is not installed. Press Export again to install it; if that "
                    "has failed, the log says why (Help > Report a Bug)."
                )
            )
            return
        self._work, self._lines, self._cancelled = tempfile.mkdtemp(prefix="vic-export-"), [], False
        try:
            command, path = arguments(self._work)
        except (ValueError, OSError):
            self._tidyUp()
            raise
        self._path = Path(path)
        self._show(_("Meshing ..."))
        self._command = Command(command, self._lineRead, self._meshed)
        self._onChanged()

    def stop(self):
        """Stop the mesher if it runs; it leaves no file."""
        if self._command is not None:
            self._cancelled = True
            self._command.cancel()

    def _lineRead(self, line):
        self._lines.append(line)
        self._show(line)

    def _meshed(self, code, report):
        self._command = None
        self._tidyUp()
        if code != 0 and self._cancelled:
            self._show(_("Cancelled; no mesh was written."))
        elif code != 0:
            self._show(self._lines[-1] if self._lines else _("No mesh was made. Try another size of the elements."))
        else:
            self._show("\n".join([_("Written: {files}").format(files=self._path), report]))
            if self._path.suffix == _VTU:
                self._load()
        self._onChanged()

    def _load(self):
        try:
            loadMesh(self._path)
        except ValueError as error:
            self._show(str(error))

    def _tidyUp(self):
        shutil.rmtree(self._work, ignore_errors=True)


def _gmshIsThere():
    return importlib.util.find_spec("gmsh") is not None


def _installGmsh():
    """Install gmsh if the user agrees, never in tests. Returns whether it is installed; the log has errors of pip."""
    question = _("A mesh of tetrahedra needs the package gmsh, which is not part of Slicer. Install it now?")
    if slicer.app.testingEnabled() or not slicer.util.confirmOkCancelDisplay(question):
        return False
    try:
        with slicer.util.WaitCursor():
            slicer.util.pip_install("gmsh")
    except (subprocess.CalledProcessError, RuntimeError, OSError):
        logging.exception("The package gmsh could not be installed")
        return False
    importlib.invalidate_caches()
    return _gmshIsThere()
