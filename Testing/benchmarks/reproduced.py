"""The paper's validation, as ``make reproduce`` prints it."""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path

from VICRegistrationLib.validation.report import SIZES, TABLE_MD, reproduce


def report(*, quick: bool) -> str:
    """Repeat it, and give its table."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        reproduce(folder, sizes=SIZES[: 1 if quick else None])
        text = Path(folder, TABLE_MD).read_text(encoding="utf-8")
    return text.partition("\n")[2].strip()
