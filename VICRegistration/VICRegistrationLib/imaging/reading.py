"""Images from and to files: LPS on disk, RAS in memory."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ..files import replacing
from ..frames import RAS_TO_LPS
from . import nifti
from .image import Image

_LPS_TO_RAS = np.diag([*RAS_TO_LPS, 1.0])
# Formats that keep a volume in one file, so that replacing the file replaces the volume at once.
_WRITABLE = (".nii.gz", ".nii", ".nrrd", ".mha")
_SERIES_UID, _SERIES_DESCRIPTION = "0020|000e", "0008|103e"


def read_image(path, *, series: str | None = None, component: int | None = None) -> Image:
    """Read a volume from a file that SimpleITK reads, or from a folder of DICOM slices.

    Parameters
    ----------
    path : path-like
        File or folder.
    series : str, optional
        Which DICOM series of the folder to take: its UID or its description, if there are several.
    component : int, optional
        Which value to take of a file that has several in a voxel; such files are refused otherwise.

    Returns
    -------
    Image
        In RAS mm, with the file's own voxel type.

    Raises
    ------
    ValueError
        If there is nothing at `path`, it cannot be read, it is not one grey-level volume (colour, several
        frames, a single slice), voxels are not finite, a NIfTI file's spacing is not positive, or the DICOM series
        is not clear or has uneven slices.

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
    with _quiet_itk():
        if path.is_dir():
            volume = _read_dicom_folder(path, series)
        elif series is not None:
            msg = f"A series was named, but {path} is a file; give the folder of the DICOM slices instead."
            raise ValueError(msg)
        else:
            volume = _read_file(path, component)
    try:
        return Image(sitk.GetArrayFromImage(volume), _matrix(volume))
    except ValueError as error:
        msg = f"{path}: {error}"
        raise ValueError(msg) from None


def read_header(path) -> tuple[dict[str, str], int]:
    """Read what a file tells of its image without its voxels.

    Parameters
    ----------
    path : path-like
        File.

    Returns
    -------
    texts : dict of str to str
        Texts of the header by their keys; none if the file cannot be read.
    components : int
        Values in a voxel.
    """
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    with _quiet_itk():
        try:
            reader.ReadImageInformation()
        except RuntimeError:
            return {}, 1
    return {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}, reader.GetNumberOfComponents()


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
        If the ending is none of these, or the image's axes are not perpendicular (files cannot say so).
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
    with replacing(path) as draft, _quiet_itk():
        try:
            sitk.WriteImage(volume, str(draft), useCompression=suffix != ".nii")
            _check_written(draft, volume)
        except RuntimeError as error:
            raise OSError(_one_line(error)) from None


def _read_file(path, component):
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        _check_kind(reader, path, any_components=component is not None)
        if path.name.lower().endswith(nifti.ENDINGS):
            nifti.check_nifti(path)
        volume = reader.Execute()
    except RuntimeError as error:
        msg = (
            f"{path} cannot be read as an image ({_one_line(error)}); check that the file is complete and of "
            "a medical image format such as NIfTI, NRRD, MetaImage or DICOM."
        )
        raise ValueError(msg) from None
    if volume.GetNumberOfComponentsPerPixel() > 1:
        volume = sitk.VectorIndexSelectionCast(volume, component)
    return volume[:, :, :, 0] if volume.GetDimension() == 4 else volume


def _check_kind(reader, path, *, any_components):
    """Refuse what is not one grey-level volume, before its voxels are read."""
    components, size = reader.GetNumberOfComponents(), reader.GetSize()
    if components > 1 and not any_components:
        msg = (
            f"{path} has {components} values per voxel (a colour or vector image); a grey-level image is "
            "needed. Convert it, or choose one channel."
        )
        raise ValueError(msg)
    if len(size) > 3 and int(np.prod(size[3:])) > 1:
        msg = (
            f"{path} has {len(size)} dimensions with {int(np.prod(size[3:]))} frames; one volume is needed. "
            "Save the frame to be fitted as a file of its own."
        )
        raise ValueError(msg)
    if len(size) < 3 or size[2] == 1:
        advice = (
            "give the folder that holds all slices of the series"
            if reader.HasMetaDataKey(_SERIES_UID)
            else "choose the whole volume"
        )
        msg = f"{path} holds a single slice; a surface needs several slices, so {advice}."
        raise ValueError(msg)


def _read_dicom_folder(folder, series):
    found = {
        uid: sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), uid)
        for uid in sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    }
    if not found:
        msg = f"The folder {folder} holds no DICOM slices; choose the folder that holds the slices themselves."
        raise ValueError(msg)
    names = found[_chosen_series(found, series, folder)]
    try:
        _check_slices(names, folder)
        return sitk.ReadImage(names)
    except RuntimeError as error:
        msg = f"The DICOM slices in {folder} cannot be read ({_one_line(error)}); copy the series again."
        raise ValueError(msg) from None


def _chosen_series(found, series, folder):
    descriptions = {uid: _description(names[0]) for uid, names in found.items()}
    if series is None and len(found) == 1:
        return next(iter(found))
    matches = [uid for uid in found if series is not None and series in (uid, descriptions[uid])]
    if len(matches) == 1:
        return matches[0]
    listing = "; ".join(f"{uid} '{descriptions[uid]}', {len(found[uid])} slices" for uid in found)
    reason = "" if series is None else f", and {len(matches) or 'none'} of them match '{series}'"
    msg = (
        f"The folder {folder} holds {len(found)} DICOM series{reason}: {listing}. Choose one with the option "
        "series (its UID or description)."
    )
    raise ValueError(msg)


def _header(name):
    reader = sitk.ImageFileReader()
    reader.SetFileName(name)
    reader.ReadImageInformation()
    return reader


def _description(name):
    header = _header(name)
    return header.GetMetaData(_SERIES_DESCRIPTION).strip() if header.HasMetaDataKey(_SERIES_DESCRIPTION) else ""


def _check_slices(names, folder):
    """Refuse series that are not a grid: SimpleITK would stack them with the first distance found."""
    headers = [_header(name) for name in names]
    _check_kind_of_slice(headers[0], len(names), folder)
    directions = np.array([header.GetDirection() for header in headers])
    if np.abs(directions - directions[0]).max() > 1e-3:
        msg = f"The DICOM slices in {folder} are not parallel (a localizer?); choose another series."
        raise ValueError(msg)
    normal = directions[0].reshape(3, 3)[:, 2]
    gaps = np.abs(np.diff([np.dot(header.GetOrigin(), normal) for header in headers]))
    if len(gaps) and np.ptp(gaps) > 0.05 * np.median(gaps):
        msg = (
            f"The DICOM slices in {folder} are {gaps.min():.2f} to {gaps.max():.2f} mm apart; even distances "
            "are needed. Look for missing or repeated slices."
        )
        raise ValueError(msg)


def _check_kind_of_slice(header, count, folder):
    if header.GetNumberOfComponents() > 1:
        msg = f"The DICOM slices in {folder} are in colour; grey levels are needed. Choose another series."
        raise ValueError(msg)
    if count == 1 and (header.GetDimension() < 3 or header.GetSize()[2] == 1):
        msg = f"The folder {folder} holds a single DICOM slice; a surface needs several slices of one series."
        raise ValueError(msg)


def _matrix(volume):
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(volume.GetDirection(), (3, 3)) * volume.GetSpacing()
    matrix[:3, 3] = volume.GetOrigin()
    return _LPS_TO_RAS @ matrix


def _to_sitk(image):
    matrix = _LPS_TO_RAS @ image.ijk_to_ras
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
    """Read the file back: some of ITK's writers do not notice that the disk is full."""
    written = sitk.ReadImage(str(path))
    if not np.array_equal(sitk.GetArrayViewFromImage(written), sitk.GetArrayViewFromImage(volume)):
        msg = "the file is not complete"
        raise OSError(msg)


def _one_line(error):
    """Reduce SimpleITK's report of several lines, with source files and addresses, to its reason."""
    text = str(error).strip() or type(error).__name__
    reasons = re.findall(r"(?:ERROR: )+(?:\w+\(0x[0-9a-f]+\): |\w+\([^)]*\): )?(.+)", text)
    reason = reasons[-1] if reasons else text.splitlines()[-1]
    return " ".join(reason.split()).rstrip(".!:")


@contextlib.contextmanager
def _quiet_itk():
    """Keep ITK's warnings off the terminal while files are read and written."""
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        yield
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)
