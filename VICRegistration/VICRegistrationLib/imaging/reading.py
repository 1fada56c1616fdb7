"""Reading and writing of images: LPS in files, RAS in memory."""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ..files import reason, replacing
from ..frames import RAS_TO_LPS
from . import dicom, nifti, text_headers
from .image import Image
from .library_messages import itk_warnings, one_line
from .volumes import volume_index

LPS_TO_RAS = np.diag([*RAS_TO_LPS, 1.0])
# Formats with the whole volume in one file, so that it can be replaced in one step.
_WRITABLE = (".nii.gz", ".nii", ".nrrd", ".mha")
# A warning is given if axes are farther from perpendicular than this, degrees: more than rounding in NIfTI files.
_SHEAR_DEGREES = 0.2
# A warning is given if the longest side is within the first limits, mm, and voxels are smaller than the second:
# scanners of patients have pixels of 0.2 mm and more, and the longest side of a pelvis in centimetres is 20 to 50.
# Smaller volumes are refused by a fit.
_SMALL_MM, _FINE_MM = (4.0, 60.0), 0.15
# ITK's names of the formats, besides NIfTI and DICOM, whose position ITK reads correctly.
_VOLUMES = ("NrrdImageIO", "MetaImageIO", "VTKImageIO", "GiplImageIO", "HDF5ImageIO")
# Those of them of which ITK reads a truncated file without an error.
_UNNOTICED = ("VTKImageIO", "GiplImageIO")
_ARCHIVES = (".zip", ".7z", ".rar", ".tar", ".tgz", ".mrb")
_PICTURES = tuple(f"{name}ImageIO" for name in ("BMP", "BioRad", "JPEG", "JPEG2000", "LSM", "PNG", "TIFF"))


def read_image(
    path, *, series: str | None = None, frame: int | None = None, warn: Callable[[str], None] | None = None
) -> Image:
    """Read a volume from a file, or from a folder of DICOM slices.

    Parameters
    ----------
    path : path-like
        File or folder.
    series : str, optional
        Which DICOM series of the folder to take, if there are several: its UID, description or number.
    frame : int, optional
        Which volume to take, from 1, if there are several: time points, echoes, components of a voxel.
    warn : callable, optional
        Called with a sentence for every missing or contradictory information in the file. By default, Python's warnings
        are issued.

    Returns
    -------
    Image
        In RAS mm.

    Raises
    ------
    ValueError
        If `path` does not exist, cannot be read, or is not one grey-level volume with a known position; the message
        names the cause and a remedy.
    OSError
        If the file or folder may not be read.

    Examples
    --------
    >>> import numpy as np, os, tempfile
    >>> import VICRegistrationLib as vic
    >>> from VICRegistrationLib.imaging.reading import write_image
    >>> image = vic.Image.from_array(np.zeros((10, 20, 20), dtype=np.int16), np.diag([1, 1, 3, 1]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = os.path.join(folder, "mri.nii.gz")
    ...     write_image(image, path)
    ...     vic.read_image(path)
    Image(20 x 20 x 10 voxels of 1 x 1 x 3 mm, int16)
    """
    path = Path(path)
    if not path.exists():
        msg = f"There is no file or folder {path}; check the path."
        raise ValueError(msg)
    if series is not None and not path.is_dir():
        msg = f"--series was given, but {path} is a file; give the folder of the DICOM slices instead."
        raise ValueError(msg)
    try:
        with itk_warnings() as warned:
            array, matrix, notes = _read(path, series, frame)
    except OSError as error:
        msg = f"{path} cannot be read ({reason(error)}); give a file or folder that may be read."
        raise OSError(msg) from error
    try:
        image = Image(array, matrix)
    except ValueError as error:
        msg = f"{path}: {error}"
        raise ValueError(msg) from None
    for text in [*notes, *_about_shear(image), *_about_scale(image), *warned]:
        (warn or warnings.warn)(text if str(path) in text else f"{path}: {text}")
    return image


def _read(path: Path, series: str | None, frame: int | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read the voxels, the matrix to RAS mm, and warnings."""
    kind = "" if path.is_dir() else sitk.ImageFileReader().GetImageIOFromFileName(str(path))
    if path.is_dir() or kind == "GDCMImageIO" or dicom.is_dicom(path):
        if path.is_dir():
            array, matrix, notes = dicom.read_series(path, series, frame)
        else:
            array, matrix, notes = dicom.read_file(path, frame)
        return array, LPS_TO_RAS @ matrix, notes
    if not path.stat().st_size:
        msg = f"{path} cannot be read as an image (it is empty); copy or download it again, completely."
        raise ValueError(msg)
    if kind == "NiftiImageIO" or path.name.lower().endswith(nifti.ENDINGS) or (not kind and nifti.is_nifti(path)):
        return nifti.read_nifti(path, frame)
    return _read_by_itk(path, kind, frame)


def read_header(path) -> tuple[dict[str, str], int]:
    """Read the header of an image file.

    Parameters
    ----------
    path : path-like
        File.

    Returns
    -------
    texts : dict of str to str
        Texts of the header by their keys; empty if the file cannot be read.
    count : int
        Number of volumes: components of a voxel times frames.
    """
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    with itk_warnings():
        try:
            reader.ReadImageInformation()
        except RuntimeError:
            return {}, 1
    texts = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
    return texts, reader.GetNumberOfComponents() * int(np.prod(reader.GetSize()[3:]))


def write_image(image: Image, path) -> None:
    """Write a volume to one file, completely or not at all.

    Parameters
    ----------
    image : Image
        Masks are written as 8-bit numbers 0 and 1.
    path : path-like
        The ending chooses the format: .nii.gz, .nii, .nrrd or .mha. A file that exists is replaced.

    Raises
    ------
    ValueError
        If the ending is none of these, or the image's axes are not perpendicular, which files cannot represent.
    OSError
        If the folder does not exist or cannot be written to, or the disk is full.
    """
    path = Path(path)
    suffix = next((ending for ending in _WRITABLE if path.name.lower().endswith(ending)), None)
    if suffix is None:
        msg = f"Images cannot be written as {path.name}; choose one of the endings {', '.join(_WRITABLE)}."
        raise ValueError(msg)
    if not path.parent.is_dir():
        msg = f"The folder {path.parent} does not exist; create it or choose another."
        raise OSError(msg)
    volume = _to_sitk(image)
    with replacing(path) as draft, itk_warnings():
        try:
            sitk.WriteImage(volume, str(draft), useCompression=suffix != ".nii")
            _check_written(draft, volume)
        except RuntimeError as error:
            raise OSError(one_line(error)) from None


def _about_shear(image: Image) -> list[str]:
    """Warn of axes that are not perpendicular."""
    directions = image.ijk_to_ras[:3, :3] / image.spacing
    cosine = np.abs((directions.T @ directions)[np.triu_indices(3, 1)]).max()
    away = np.degrees(np.arcsin(min(1.0, cosine)))
    if away < _SHEAR_DEGREES:
        return []
    return [f"its axes are {away:.1f} degrees from perpendicular (a tilted gantry?); it is placed as it says"]


def _about_scale(image: Image) -> list[str]:
    """Warn of lengths that are probably in centimetres."""
    longest = float((image.size * image.spacing).max())
    if not _SMALL_MM[0] <= longest < _SMALL_MM[1] or image.spacing.min() >= _FINE_MM:
        return []
    steps = " x ".join(f"{step:.3g}" for step in image.spacing)
    return [
        f"its longest side is {longest:.3g} mm, with voxels of {steps} mm: are its lengths in centimetres? They were "
        "taken as mm"
    ]


def _read_by_itk(path: Path, kind: str, frame: int | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read a file of one of ITK's other formats."""
    if kind in _PICTURES:
        msg = (
            f"{path} is of a format ({kind.replace('ImageIO', '')}) that does not give the distance of its slices in "
            "mm; give the DICOM series it was made of, or a NIfTI, NRRD or MetaImage file."
        )
        raise ValueError(msg)
    if path.suffix.lower() in _ARCHIVES:
        msg = f"{path} is an archive; unpack it, and give the image file or the folder of DICOM slices that is in it."
        raise ValueError(msg)
    if kind and kind not in _VOLUMES:
        # ITK reads MINC files, for example, with left and right, and front and back exchanged.
        msg = (
            f"{path} is of a format ({kind.replace('ImageIO', '')}) of which ITK does not know the place in the "
            "patient for certain; convert it to NIfTI or NRRD with a program of that format."
        )
        raise ValueError(msg)
    text_headers.check_numbers(path, kind)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        _check_size(reader.GetSize(), path)
        notes = text_headers.notes_about(path, kind)
        text_headers.check_spacing(path, np.array(reader.GetSpacing()[:3]))
        directions = np.reshape(reader.GetDirection(), [reader.GetDimension()] * 2)[:3, :3]
        notes += text_headers.notes_about_directions(directions, np.array(reader.GetSpacing()[:3]))
        volume = _chosen(reader, frame, path)
    except RuntimeError as error:
        why = text_headers.cause(path, kind, str(error)) or one_line(error) if kind else "its format is not known"
        msg = (
            f"{path} cannot be read as an image ({why}); check that the file is complete and of a medical "
            "image format such as NIfTI, NRRD, MetaImage or DICOM."
        )
        raise ValueError(msg) from None
    array = sitk.GetArrayFromImage(volume)
    _check_length(path, kind, array, reader)
    return array, _matrix(volume), notes


def _check_size(size: tuple[int, ...], path: Path) -> None:
    """Refuse a single slice, before its voxels are read."""
    if len(size) < 3 or size[2] == 1:
        msg = f"{path} holds a single slice; a surface needs several slices, so choose the whole volume."
        raise ValueError(msg)


def _check_length(path: Path, kind: str, array: np.ndarray, reader: sitk.ImageFileReader) -> None:
    """Refuse a truncated file of the formats of which ITK reads it without an error."""
    if kind not in _UNNOTICED:
        return
    count = int(np.prod(reader.GetSize())) * reader.GetNumberOfComponents()
    content = path.read_bytes()
    if path.name.lower().endswith(".gz"):
        try:
            content = gzip.decompress(content)
        except (EOFError, OSError, zlib.error):
            content = b""
    head, table, values = content.partition(b"LOOKUP_TABLE default")
    is_text = kind == "VTKImageIO" and re.search(rb"^\s*ASCII\s*$", head, re.M | re.I) is not None
    if len(values.split()) < count if is_text and table else len(content) < count * array.itemsize:
        msg = f"{path} is cut short (its data end too soon); copy or download it again."
        raise ValueError(msg)


def _chosen(reader: sitk.ImageFileReader, frame: int | None, path: Path) -> sitk.Image:
    """Read the chosen volume of a file with several components of a voxel, or several frames."""
    components, frames = reader.GetNumberOfComponents(), int(np.prod(reader.GetSize()[3:]))
    count = components * frames
    if not count:
        msg = f"{path} says that it has no values in its voxels; a grey level is needed. Correct its header."
        raise ValueError(msg)
    found = f"{path} has {reader.GetDimension()} dimensions with {frames} frames"
    if components > 1:
        found = f"{path} has {components} values per voxel (a colour or vector image, or several volumes)"
    number, component = divmod(volume_index(frame, count, str(path), found), components)
    volume = reader.Execute()
    if components > 1:
        volume = sitk.VectorIndexSelectionCast(volume, component)
    if volume.GetDimension() > 3:
        sizes = volume.GetSize()
        rest = np.unravel_index(number, sizes[3:], order="F")
        volume = sitk.Extract(volume, [*sizes[:3], *([0] * len(rest))], [0, 0, 0, *map(int, rest)])
    return volume


def _matrix(volume):
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(volume.GetDirection(), (3, 3)) * volume.GetSpacing()
    matrix[:3, 3] = volume.GetOrigin()
    return LPS_TO_RAS @ matrix


def _to_sitk(image):
    matrix = LPS_TO_RAS @ image.ijk_to_ras
    directions = matrix[:3, :3] / image.spacing
    if np.abs(directions.T @ directions - np.eye(3)).max() > 1e-4:
        msg = "The image's axes are not perpendicular, which image files cannot hold; resample it first."
        raise ValueError(msg)
    array = np.ascontiguousarray(image.array)
    if array.dtype == bool:
        array = array.astype(np.uint8)
    elif array.dtype.kind == "f" and array.dtype.itemsize not in (4, 8):
        array = array.astype(np.float32 if array.dtype.itemsize == 2 else np.float64)
    volume = sitk.GetImageFromArray(array)
    volume.SetSpacing(image.spacing.tolist())
    volume.SetDirection(directions.ravel().tolist())
    volume.SetOrigin(matrix[:3, 3].tolist())
    return volume


def _check_written(path, volume):
    """Read the file back, because some of ITK's writers do not report a full disk."""
    msg = "the file is not complete"
    try:
        written = sitk.ReadImage(str(path))
    except RuntimeError:
        raise OSError(msg) from None
    if not np.array_equal(sitk.GetArrayViewFromImage(written), sitk.GetArrayViewFromImage(volume)):
        raise OSError(msg)
