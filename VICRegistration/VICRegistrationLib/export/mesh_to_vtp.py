"""A program that copies any mesh into a VTP file: some damaged files end the process in which VTK reads them."""

from __future__ import annotations

import sys
from pathlib import Path

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


def main(source: str, target: str) -> int:
    """Copy a mesh; returns 0 when it is written."""
    reader = READERS[Path(source).suffix.lower()]()
    reader.SetFileName(source)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(target)
    writer.SetInputConnection(reader.GetOutputPort())
    writer.SetCompressorTypeToNone()
    writer.EncodeAppendedDataOff()
    return 0 if writer.Write() else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
