"""VTK's XML files, written and read so that what is wrong is told by Python, in one sentence."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from vtkmodules.vtkCommonCore import vtkObject


def xml_text(writer, data) -> str:
    """Write data as VTK's XML into memory: a full disk is then noticed by Python, which says so.

    Parameters
    ----------
    writer : vtkXMLWriter
        Of the kind of the data.
    data : vtkDataObject

    Returns
    -------
    str
    """
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return writer.GetOutputString()


@contextlib.contextmanager
def silent_vtk() -> Iterator[None]:
    """Keep VTK from printing what is wrong with a file."""
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        yield
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
