"""Reading of triangles (STL, PLY, OBJ, VTK and VTP files), and of B-spline surfaces in VTP files."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from ..files import reason
from ..frames import RAS_TO_LPS
from ..geometry.surface_file import SurfaceRecord
from ..imaging.library_messages import silent_vtk
from . import mesh_to_vtp
from .surface_data import surface_in, triangles_in

READABLE_MESHES = tuple(mesh_to_vtp.READERS)
FRAMES = ("LPS", "RAS")
# The frame is marked within so many bytes: in the header of an STL or VTK file, or comments of a PLY or OBJ file.
_HEADER_BYTES = 2000


def read_triangles(path: str | os.PathLike, *, frame: str | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Read the triangles of a mesh; other polygons are cut into triangles.

    Parameters
    ----------
    path : path
        .stl, .ply, .vtp, .vtk or .obj; mm.
    frame : {"LPS", "RAS"}, optional
        Frame of its coordinates. By default the one that the file is marked with ("SPACE=RAS" in the header, as by
        Slicer), else LPS, as in Slicer.

    Returns
    -------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no such file, is damaged or has no triangles.
    """
    path = Path(path)
    if path.suffix.lower() not in mesh_to_vtp.READERS:
        msg = f"The mesh {path} was given; a file {', '.join(mesh_to_vtp.READERS)} is needed."
        raise ValueError(msg)
    header = _header(path)
    data = _read(path)
    _check_corners(path, data)
    with silent_vtk():
        points, triangles = triangles_in(data)
    if not len(triangles) and path.suffix.lower() == ".stl":
        points, triangles = _lenient_stl(path)
    if not len(triangles):
        msg = (
            f"The file {path} holds no triangles that can be read; copy it again, or give a closed mesh as a "
            f"{path.suffix} file."
        )
        raise ValueError(msg)
    return points * (RAS_TO_LPS if (frame or _marked_frame(data, header)) == "LPS" else 1.0), triangles


def is_image(path: str | os.PathLike) -> bool:
    """Whether a .vtk file holds an image, not a mesh; false if it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            return re.search(rb"^DATASET\s+STRUCTURED_POINTS", file.read(_HEADER_BYTES), re.I | re.M) is not None
    except OSError:
        return False


def holds_surface(path: str | os.PathLike) -> bool:
    """Whether a VTP file has the control net of a B-spline surface; false if it cannot be read."""
    try:
        return b'Name="control_net"' in Path(path).read_bytes()
    except OSError:
        return False


def read_vtp_record(path: str | os.PathLike) -> SurfaceRecord:
    """Read the B-spline surface of a VTP file with its name.

    Parameters
    ----------
    path : path
        File written by :func:`.mesh_files.write_vtp`, or by Slicer from a model made of one.

    Returns
    -------
    SurfaceRecord
        RAS mm. The name is empty if the file has none; net and closure are empty.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged or holds no surface.
    """
    path = Path(path)
    _header(path)
    data = _read(path).GetFieldData()
    surface = surface_in(data, f"file {path}", remedy="give a VTP file as the program writes it")
    name = data.GetAbstractArray("name")
    has_name = isinstance(name, vtkStringArray) and name.GetNumberOfValues() == 1
    return SurfaceRecord(surface, name.GetValue(0) if has_name else "")


def _header(path: Path) -> bytes:
    """Read the first bytes of a file, or raise an error with a sentence for the user."""
    try:
        with path.open("rb") as file:
            return file.read(_HEADER_BYTES)
    except OSError as error:
        msg = f"The file {path} cannot be read ({reason(error)}); give a file that exists."
        raise OSError(msg) from error


def _check_corners(path: Path, data: vtkPolyData) -> None:
    """Refuse polygons whose corners are not among the points: VTK would read beyond its memory."""
    for cells in (data.GetPolys(), data.GetStrips()):
        corners = vtk_to_numpy(cells.GetConnectivityArray())
        if len(corners) and not 0 <= corners.min() <= corners.max() < data.GetNumberOfPoints():
            msg = (
                f"{path} has polygons with corners that are not among its {data.GetNumberOfPoints()} points, so it is "
                "damaged; copy it again, or export it again where it was made."
            )
            raise ValueError(msg)


def _read(path: Path) -> vtkPolyData:
    """Read a file in a process of its own, because some damaged files crash VTK; it takes 0.2 s more."""
    with tempfile.TemporaryDirectory(prefix="vic-mesh-") as folder:
        copy = str(Path(folder) / "copy.vtp")
        # In Slicer, sys.executable is PythonSlicer.
        command = [sys.executable, mesh_to_vtp.__file__, str(path), copy]
        # On Windows no console window opens.
        hidden = {"creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0), "stdin": subprocess.DEVNULL}
        done = subprocess.run(command, capture_output=True, check=False, **hidden)
        if done.returncode == 1:
            # The exit code if a package is missing or the copy cannot be written; a crash has another one.
            line = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
            msg = f"The file {path} cannot be read, because the process that reads it has failed ({line})."
            raise OSError(msg)
        if done.returncode != 0:
            code = done.returncode
            msg = f"{path} is cut short or damaged (its reader ended with exit code {code}); copy or download it again."
            raise ValueError(msg)
        reader = vtkXMLPolyDataReader()
        reader.SetFileName(copy)
        with silent_vtk():
            reader.Update()
        return reader.GetOutput()


def _lenient_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read an STL text file that VTK does not recognize as text: in capitals, or with a byte order mark."""
    number = rb"\s+([-+.\deE]+)"
    corners = re.findall(rb"vertex" + 3 * number, path.read_bytes(), re.IGNORECASE)
    try:
        points = np.array(corners, dtype=float).reshape(-1, 3)
    except ValueError:
        points = np.empty((0, 3))
    return points, np.arange(len(points) // 3 * 3).reshape(-1, 3)


def _marked_frame(data: vtkPolyData, header: bytes) -> str:
    """Return the frame that a file is marked with; LPS by default."""
    array = data.GetFieldData().GetAbstractArray("SPACE")
    if isinstance(array, vtkStringArray) and array.GetNumberOfValues() == 1:
        frame = array.GetValue(0)
    else:
        match = re.search(rb"SPACE=([\w-]+)", header)
        frame = match[1].decode("ascii", "replace") if match else ""
    return "RAS" if frame.upper() in ("RAS", "RIGHT-ANTERIOR-SUPERIOR") else "LPS"
