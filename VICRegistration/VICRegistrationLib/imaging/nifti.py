"""What ITK's NIfTI reader repairs in silence: values that are not finite, broken spacings, files cut short."""

from __future__ import annotations

import contextlib
import gzip
import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .image import check_finite_count

ENDINGS = (".nii", ".nii.gz")
# By the length of the header, which is its first number: where its fields lie, and how their numbers are written.
_LAYOUTS = {
    348: {"dim": (40, "8h"), "datatype": (70, "h"), "bitpix": (72, "h"), "pixdim": (76, "8f"), "offset": (108, "f")},
    540: {"dim": (16, "8q"), "datatype": (12, "h"), "bitpix": (14, "h"), "pixdim": (104, "8d"), "offset": (168, "q")},
}
_FLOATING = {16: "f4", 64: "f8"}
_BLOCK_BYTES = 1 << 24


@dataclass(frozen=True)
class _Header:
    """Fields of a header; `order` is the byte order, "<" or ">"."""

    order: str
    datatype: int
    bytes_each: int
    n_voxels: int
    spacing: tuple[float, ...]
    offset: int


def check_nifti(path: Path) -> None:
    """Refuse a file that ITK would read with other grey levels or another spacing than it holds.

    Parameters
    ----------
    path : Path
        File that ends in .nii or .nii.gz. One without a NIfTI header is left to ITK to refuse.

    Raises
    ------
    ValueError
        If the file is cut short, a spacing is not a positive number, or voxels are not finite.
    """
    try:
        with contextlib.suppress(OSError, zlib.error), _opened(path) as file:
            header = _header(file.read(544))
            if header is None:
                return
            _check_length(path, header)
            _check_spacing(path, header)
            if header.datatype in _FLOATING:
                _check_voxels(path, header, file)
    except EOFError:
        msg = f"{path} is cut short (its compressed data end too soon); copy or download it again."
        raise ValueError(msg) from None


def _opened(path):
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return gzip.open(path) if packed else path.open("rb")


def _header(content):
    """Read the fields of a header; None if there is no header."""
    for order in "<>":
        length = struct.unpack_from(order + "i", content)[0] if len(content) >= 348 else 0
        if length in _LAYOUTS and len(content) >= length:
            break
    else:
        return None
    fields = {name: struct.unpack_from(order + code, content, at) for name, (at, code) in _LAYOUTS[length].items()}
    dim, offset = fields["dim"], fields["offset"][0]
    if not (1 <= dim[0] <= 7 and np.isfinite(offset)):
        return None
    n_voxels = 1
    for size in dim[1 : dim[0] + 1]:
        n_voxels *= max(size, 1)
    return _Header(order, fields["datatype"][0], fields["bitpix"][0] // 8, n_voxels, fields["pixdim"][1:4], int(offset))


def _check_length(path, header):
    needed = header.offset + header.n_voxels * header.bytes_each
    found = _size(path, needed)
    if found < needed:
        msg = f"{path} is cut short ({found} of {needed} bytes); copy or download it again."
        raise ValueError(msg)


def _check_spacing(path, header):
    if all(np.isfinite(step) and step > 0 for step in header.spacing):
        return
    steps = " x ".join(f"{step:g}" for step in header.spacing)
    msg = (
        f"{path} has the voxel spacing {steps} mm; every spacing must be positive. Correct the file's header (pixdim)."
    )
    raise ValueError(msg)


def _check_voxels(path, header, file):
    """Count in blocks what is not finite: a copy of the whole volume might not fit into the memory."""
    kind = np.dtype(header.order + _FLOATING[header.datatype])
    file.seek(header.offset)
    left, bad = header.n_voxels * kind.itemsize, 0
    while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
        left -= len(block)
        levels = np.frombuffer(block[: len(block) // kind.itemsize * kind.itemsize], kind)
        bad += len(levels) - int(np.count_nonzero(np.isfinite(levels)))
    try:
        check_finite_count(bad, header.n_voxels)
    except ValueError as error:
        msg = f"{path}: {error}"
        raise ValueError(msg) from None


def _size(path, expected):
    """Size of the content: of a packed file from its last four bytes if they agree, else by unpacking it."""
    with path.open("rb") as file:
        magic = file.read(2)
        file.seek(-4, os.SEEK_END)
        noted = int.from_bytes(file.read(4), "little")
    if magic != b"\x1f\x8b":
        return path.stat().st_size
    if noted == expected % 2**32:
        return expected
    size = 0
    with contextlib.suppress(EOFError, OSError, zlib.error), gzip.open(path) as file:
        while block := file.read(1 << 16):
            size += len(block)
    return size
