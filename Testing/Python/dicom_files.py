"""Small DICOM files of many kinds, written with pydicom: the grey level of every pixel is its place."""

from __future__ import annotations

import numpy as np
import pydicom
from placed_levels import levels_at
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

MR, ENHANCED_MR = "1.2.840.10008.5.1.4.1.1.4", "1.2.840.10008.5.1.4.1.1.4.1"
AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
SAGITTAL = (0.0, 1.0, 0.0, 0.0, 0.0, -1.0)
CORONAL = (1.0, 0.0, 0.0, 0.0, 0.0, -1.0)
LPS_TO_RAS = np.array([-1.0, -1.0, 1.0])
ROWS, COLUMNS = 12, 10


def positions(orientation=AXIAL, count=6, step=3.0, shear=(0.0, 0.0), first=(-20.0, 15.0, -30.0)):
    """Places of the first pixels of a stack, LPS mm; `shear` moves each slice along its rows and columns, mm."""
    along, down = np.array(orientation[:3]), np.array(orientation[3:])
    shift = step * np.cross(along, down) + shear[0] * along + shear[1] * down
    return np.array(first) + np.arange(count)[:, None] * shift


def pixels(position, orientation=AXIAL, spacing=(0.8, 0.6)):
    """Grey levels of one slice."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    along, down = np.array(orientation[:3]), np.array(orientation[3:])
    lps = position + column[..., None] * spacing[1] * along + row[..., None] * spacing[0] * down
    return levels_at(lps * LPS_TO_RAS)


def image(array, *, sop=MR, series="1.2.3.4", study="1.2.3", **tags) -> Dataset:
    """An image with what all have; None for a keyword leaves it out."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = sop
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.PatientName, data.PatientID, data.Modality = "Phantom", "1", "MR"
    data.StudyInstanceUID, data.SeriesInstanceUID, data.FrameOfReferenceUID = study, series, "1.2.3.9"
    data.SeriesDescription, data.SeriesNumber = "T2", 3
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.Rows, data.Columns = array.shape[-2:]
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
    data.PixelData = np.ascontiguousarray(array, dtype=np.int16).tobytes()
    for keyword, value in tags.items():
        if value is not None:
            setattr(data, keyword, value)
    return data


def single(position, orientation=AXIAL, spacing=(0.8, 0.6), *, level=0, **tags) -> Dataset:
    """A classic image of one slice."""
    placing = {
        "ImagePositionPatient": [float(each) for each in np.round(position, 6)],
        "ImageOrientationPatient": list(orientation),
        "PixelSpacing": list(spacing),
    }
    return image(pixels(position, orientation, spacing) + level, **{**placing, **tags})


def write_series(folder, datasets):
    """Write images under names that are in no order."""
    folder.mkdir(parents=True, exist_ok=True)
    count = len(list(folder.iterdir()))
    for number, data in enumerate(datasets):
        data.setdefault("InstanceNumber", number + 1)
        save(data, folder / f"IM{(number * 7919) % 1000:03d}_{count + number}")
    return folder


def save(data, path):
    """Write one file."""
    pydicom.dcmwrite(path, data, enforce_file_format=True)
    return path


def item(**elements) -> Dataset:
    """An item of a sequence; values that are datasets are sequences of one item."""
    found = Dataset()
    for keyword, value in elements.items():
        setattr(found, keyword, Sequence([value]) if isinstance(value, Dataset) else value)
    return found


def multiframe(
    places, orientation=AXIAL, spacing=(0.8, 0.6), *, groups=None, levels=None, shared=True, arrays=None, **tags
) -> Dataset:
    """An enhanced MR image; `groups` are further functional groups of each frame, `levels` are added to its pixels."""
    arrays = [pixels(place, orientation, spacing) for place in places] if arrays is None else arrays
    stack = np.array([array + (levels[number] if levels else 0) for number, array in enumerate(arrays)])
    data = image(stack, sop=ENHANCED_MR, NumberOfFrames=len(places), **tags)
    oriented = {
        "PlaneOrientationSequence": item(ImageOrientationPatient=list(orientation)),
        "PixelMeasuresSequence": item(PixelSpacing=list(spacing), SliceThickness=3.0),
    }
    data.SharedFunctionalGroupsSequence = Sequence([item(**(oriented if shared else {}))])
    data.PerFrameFunctionalGroupsSequence = Sequence(
        [
            item(
                **({} if shared else oriented),
                PlanePositionSequence=item(ImagePositionPatient=[float(each) for each in np.round(place, 6)]),
                **(groups[number] if groups else {}),
            )
            for number, place in enumerate(places)
        ]
    )
    return data
