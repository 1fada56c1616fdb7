"""NIfTI files, versions 1 and 2, by VTK's reader, placed by their sform or qform."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonMisc import vtkErrorCode
from vtkmodules.vtkIOImage import vtkNIFTIImageReader

from .library_messages import silent_vtk
from .volumes import volume_index

ENDINGS = (".nii", ".nii.gz", ".hdr", ".hdr.gz", ".img", ".img.gz")
# Voxel types that are no grey levels.
_NOT_GREY = {32: "complex numbers", 1792: "complex numbers", 128: "colours", 2304: "colours"}
# Factor to mm and name of a unit, by its code.
_UNITS = {1: (1e3, "metres"), 3: (1e-3, "micrometres")}
# Smallest offset of the voxels in a single file, by version.
_EARLIEST = {"n+1": 352, "n+2": 544}
# A warning is given if sform and qform place a corner of the image farther apart than this, mm, or if spacings differ
# by more than this fraction.
_WARNED_MM, _WARNED_SPACING = 0.5, 0.01
# The sum of the squares of b, c and d may exceed 1 by this, because of rounding.
_ROTATION = 1e-3


def is_nifti(path: Path) -> bool:
    """Whether a file holds a NIfTI volume, independent of its name."""
    reader = vtkNIFTIImageReader()
    with silent_vtk():
        if not reader.CanReadFile(str(path)):
            return False
        reader.SetFileName(str(path))
        reader.UpdateInformation()
    header = reader.GetNIFTIHeader()
    return header is not None and header.GetMagic() in _EARLIEST


def read_nifti(path: Path, frame: int | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read a NIfTI file.

    Parameters
    ----------
    path : Path
        .nii, .nii.gz, or one of a pair .hdr and .img.
    frame : int, optional
        Which volume of a file with several, from 1.

    Returns
    -------
    array : (nk, nj, ni) ndarray
        With the file's slope and intercept applied.
    ijk_to_ras : (4, 4) ndarray
        The sform if its code is not 0; else the qform; else from the spacing alone.
    notes : list of str
        Warnings about missing or contradictory information, a sentence each.

    Raises
    ------
    ValueError
        If it is no NIfTI file, is truncated, or holds no volume of grey levels.
    """
    reader = vtkNIFTIImageReader()
    reader.SetFileName(str(path))
    reader.TimeAsVectorOn()
    with silent_vtk():
        reader.UpdateInformation()
        header = reader.GetNIFTIHeader()
        _check_error(path, reader.GetErrorCode(), header)
        _check_header(path, header)
        done = reader.GetExecutive().Update()
        # If the other file of a pair is missing, VTK sets no error code.
        failed = vtkErrorCode.NoError if done else vtkErrorCode.CannotOpenFileError
        _check_error(path, reader.GetErrorCode() or failed, header)
    size = [max(1, header.GetDim(axis)) for axis in (3, 2, 1)]
    levels = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars()).reshape(*size, -1)
    array = levels[..., volume_index(frame, levels.shape[-1], str(path))]
    if reader.GetQFac() < 0:
        # VTK has reversed the order of the slices.
        array = array[::-1]
    matrix, notes = _placed(path, header, array.shape)
    return _scaled(array, header), matrix, notes


# ------------------------------------------------------------------ voxels


def _check_error(path: Path, code: int, header) -> None:
    if not code:
        return
    if code == vtkErrorCode.PrematureEndOfFileError:
        msg = f"{path} is cut short (its data end too soon); copy or download it again."
        raise ValueError(msg)
    reason = vtkErrorCode.GetStringFromErrorCode(code)
    if code == vtkErrorCode.UnrecognizedFileTypeError:
        reason = "its name says that it is a NIfTI file, but it is none"
    if code == vtkErrorCode.FileFormatError:
        reason = f"its voxels of NIfTI type {header.GetDataType()} or its sizes are not understood"
    if code == vtkErrorCode.CannotOpenFileError:
        reason = "its other half, .hdr or .img, is not beside it"
    msg = (
        f"{path} cannot be read as an image ({reason}); check that the file is complete and of a medical image format "
        "such as NIfTI, NRRD, MetaImage or DICOM."
    )
    raise ValueError(msg)


def _check_header(path: Path, header) -> None:
    """Refuse a file without a volume of grey levels, before its voxels are read."""
    if not header.GetMagic() and path.name.lower().endswith(ENDINGS[:2]):
        msg = (
            f"{path} is no NIfTI file, although its name says so (its header lacks the mark n+1); give the file it was "
            "made of."
        )
        raise ValueError(msg)
    kind = _NOT_GREY.get(header.GetDataType())
    sizes = [header.GetDim(axis) for axis in range(1, min(header.GetDim(0), 7) + 1)]
    if kind is None and int(np.prod(sizes[4:])) > 1:
        kind = f"vectors of {int(np.prod(sizes[4:]))} values"
    if kind:
        msg = f"{path} holds {kind}; a grey-level image is needed. Save one channel of it as a file of its own."
        raise ValueError(msg)
    if len(sizes) < 3 or sizes[2] < 2:
        msg = f"{path} holds a single slice; a surface needs several slices, so choose the whole volume."
        raise ValueError(msg)
    if min(sizes) < 1:
        # VTK would read outside of its memory.
        found = " x ".join(map(str, sizes[:3]))
        msg = f"{path} says that it has {found} voxels, so its header is damaged; copy it again."
        raise ValueError(msg)
    offset, earliest = header.GetVoxOffset(), _EARLIEST.get(header.GetMagic(), 0)
    if not offset >= earliest:
        msg = f"{path} says that its voxels begin at byte {offset}, inside of its header; write the file again."
        raise ValueError(msg)


def _scaled(array: np.ndarray, header) -> np.ndarray:
    """Apply slope and intercept, if they are valid and change anything."""
    slope, intercept = header.GetSclSlope(), header.GetSclInter()
    if (
        not header.GetMagic()
        or not np.isfinite([slope, intercept]).all()
        or slope == 0.0
        or (slope, intercept) == (1, 0)
    ):
        return np.ascontiguousarray(array)
    exact = np.float32 if array.dtype.itemsize <= 2 else np.float64
    # Values that overflow are refused later, with their number.
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(exact) * exact(slope) + exact(intercept)


# ------------------------------------------------------------------ place


def _placed(path: Path, header, shape: tuple[int, ...]) -> tuple[np.ndarray, list[str]]:
    """Find the matrix from voxels to RAS mm; returns also warnings about it."""
    scale, unit = _UNITS.get(int(header.GetXYZTUnits()) & 7, (1.0, ""))
    notes = [f"its lengths are in {unit}; they were converted to mm"] if unit else []
    spacing = np.array([header.GetPixDim(axis) for axis in (1, 2, 3)])
    usable = bool(np.isfinite(spacing).all() and np.all(spacing > 0.0))
    is_nifti = bool(header.GetMagic())
    qform = _qform(header, spacing) if usable and is_nifti and header.GetQFormCode() > 0 else None
    sform = _sform(header) if is_nifti and header.GetSFormCode() > 0 else None
    if sform is not None and _places(sform):
        matrix = sform
        notes += _about_sform(matrix, qform, spacing, shape)
    elif sform is not None and qform is None:
        rows = "; ".join(" ".join(f"{number:g}" for number in row) for row in sform[:3])
        msg = (
            f"{path} has an sform that places no voxels ({rows}), and no qform; three independent axes of finite "
            "length are needed. Give the file it was made of, or correct its header."
        )
        raise ValueError(msg)
    elif not usable:
        steps = " x ".join(f"{step:g}" for step in spacing)
        msg = f"{path} has the voxel spacing {steps} mm; every spacing must be positive. Correct its header (pixdim)."
        raise ValueError(msg)
    elif qform is not None:
        matrix = qform
        if sform is not None:
            notes.append(
                "its sform places no voxels (numbers that are not finite, or axes in one plane); the qform was taken"
            )
    elif is_nifti and header.GetQFormCode() > 0:
        numbers = ", ".join(f"{number:g}" for number in _quaternion(header))
        msg = (
            f"{path} has a qform whose quaternion is no rotation (b, c, d: {numbers}), and no sform; give the file it "
            "was made of, or correct its header."
        )
        raise ValueError(msg)
    else:
        # As in ITK and Slicer.
        matrix = np.diag([*(spacing * [-1, -1, 1]), 1.0])
        notes.append(
            "it does not say where in the patient it is, nor which way its axes point (no sform, no qform); "
            "they were taken as left, posterior and superior, as 3D Slicer does"
        )
    return np.diag([scale, scale, scale, 1.0]) @ matrix, notes


def _qform(header, spacing: np.ndarray) -> np.ndarray | None:
    """Matrix of the quaternion, as defined by the standard; None if quaternion or offset are invalid."""
    b, c, d = _quaternion(header)
    offset = header.GetQOffsetX(), header.GetQOffsetY(), header.GetQOffsetZ()
    if not (np.isfinite([b, c, d, *offset]).all() and b * b + c * c + d * d < 1.0 + _ROTATION):
        return None
    a = np.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    turn = Rotation.from_quat([b, c, d, a]).as_matrix()
    turn[:, 2] *= -1.0 if header.GetPixDim(0) < 0 else 1.0
    matrix = np.eye(4)
    matrix[:3, :3] = turn * spacing
    matrix[:3, 3] = offset
    return matrix


def _quaternion(header) -> tuple[float, float, float]:
    return header.GetQuaternB(), header.GetQuaternC(), header.GetQuaternD()


def _sform(header) -> np.ndarray:
    return np.array([header.GetSRowX(), header.GetSRowY(), header.GetSRowZ(), (0, 0, 0, 1)], dtype=float)


def _places(matrix: np.ndarray) -> bool:
    """Whether a matrix is finite and invertible."""
    return bool(np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix[:3, :3]) == 3)


def _about_sform(matrix, qform, spacing, shape) -> list[str]:
    """Collect warnings about spacings or a qform that contradict the sform."""
    steps = np.linalg.norm(matrix[:3, :3], axis=0)
    notes = []
    if not np.allclose(steps, spacing, rtol=_WARNED_SPACING, atol=0.0):
        own, other = (" x ".join(f"{step:.4g}" for step in each) for each in (steps, spacing))
        notes.append(f"its sform has voxels of {own} mm, its pixdim says {other} mm; the sform was taken")
    elif qform is not None:
        corners = np.array(np.meshgrid(*([0, count - 1] for count in shape[::-1]), indexing="ij")).reshape(3, -1)
        apart = np.linalg.norm(((matrix - qform)[:3] @ np.vstack([corners, np.ones(8)])), axis=0).max()
        if apart > _WARNED_MM:
            notes.append(f"its qform places it up to {apart:.1f} mm away from its sform; the sform was taken")
    return notes
