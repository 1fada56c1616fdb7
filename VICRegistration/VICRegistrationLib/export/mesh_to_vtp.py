"""Program that copies a mesh into a VTP file, because some damaged files crash the process in which VTK reads them."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

from vtkmodules.vtkCommonCore import vtkObject
from vtkmodules.vtkIOGeometry import vtkOBJReader, vtkSTLReader
from vtkmodules.vtkIOLegacy import vtkPolyDataReader
from vtkmodules.vtkIOPLY import vtkPLYReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

READERS = {
    ".stl": vtkSTLReader,
    ".ply": vtkPLYReader,
    ".vtp": vtkXMLPolyDataReader,
    ".vtk": vtkPolyDataReader,
    ".obj": vtkOBJReader,
}


# Flags of SetErrorMode on Windows (SEM_FAILCRITICALERRORS, SEM_NOGPFAULTERRORBOX): a crash opens no dialog.
_NO_DIALOGS = 0x0001 | 0x0002


def main(source: str, target: str) -> str | None:
    """Copy a mesh.

    Parameters
    ----------
    source : str
        A file with a suffix of `READERS`.
    target : str
        The .vtp file to write; it has no points if the source holds no mesh.

    Returns
    -------
    str or None
        Why no file was written; None when it was.
    """
    if sys.platform == "win32":
        ctypes.windll.kernel32.SetErrorMode(_NO_DIALOGS)
    # On Windows, VTK opens a window for warnings.
    vtkObject.GlobalWarningDisplayOff()
    reader = READERS[Path(source).suffix.lower()]()
    reader.SetFileName(source)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(target)
    writer.SetInputConnection(reader.GetOutputPort())
    writer.SetCompressorTypeToNone()
    writer.EncodeAppendedDataOff()
    # Write returns 1 even if the disk is full.
    written = writer.Write() and not writer.GetErrorCode()
    return None if written else f"{target} cannot be written; is the disk full?"


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
