"""Warnings and errors of ITK and VTK: collected for the user instead of printed."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

import SimpleITK as sitk
from vtkmodules.vtkCommonCore import vtkObject


class _Warnings(sitk.LoggerBase):
    """Collects the warnings of ITK and ignores its other output."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def DisplayWarningText(self, text: str) -> None:  # noqa: N802, D102
        self.texts.append(text)

    def _drop(self, text: str) -> None:
        """Ignore a text."""

    DisplayText = DisplayErrorText = DisplayDebugText = DisplayGenericOutputText = _drop


@contextlib.contextmanager
def itk_warnings() -> Iterator[list[str]]:
    """Keep ITK's warnings off the terminal and collect them.

    Yields
    ------
    list of str
        One line for each different warning; filled when the block ends.
    """
    lines: list[str] = []
    logger = _Warnings()
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    before = logger.SetAsGlobalITKLogger()
    sitk.ProcessObject.SetGlobalWarningDisplay(True)
    try:
        yield lines
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)
        before.SetAsGlobalITKLogger()
        lines.extend(dict.fromkeys(map(_warning, logger.texts)))


@contextlib.contextmanager
def silent_vtk() -> Iterator[None]:
    """Keep VTK from printing warnings."""
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        yield
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)


def one_line(error: Exception) -> str:
    """Extract the reason from SimpleITK's report of several lines with source files and addresses.

    Parameters
    ----------
    error : Exception

    Returns
    -------
    str
        Without a full stop.
    """
    text = str(error).strip() or type(error).__name__
    reasons = re.findall(r"(?:ERROR: )+(?:\w+\(0x[0-9a-f]+\): |\w+\([^)]*\): )?(.+)", text)
    reason = reasons[-1] if reasons else text.splitlines()[-1]
    return " ".join(reason.split()).rstrip(".!:")


def _warning(text: str) -> str:
    """Remove the source file, the class and its address from a warning."""
    text = re.sub(r"WARNING: In \S+, line \d+\s*\w+ \((?:0x)?[0-9a-fA-F]+\): ", "", text)
    return " ".join(text.split()).rstrip(".")
