"""Checks of names that become names of files."""

from __future__ import annotations

import os
import re
import unicodedata

_FORBIDDEN = '<>:"/\\|?*'
_LONGEST_NAME = 100
# Most bytes of a file name, and those of the longest ending of an organ's files.
_LONGEST_FILE_NAME, _LONGEST_ENDING = 255, len("_convergence.csv")
# Names of the files for all organs: report.json, overview.png, organs.step and model.json.
_RESERVED = ("report", "overview", "organs", "model")
# Names of devices on Windows, with any suffix.
_DEVICES = ("con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10)))


def organ_name(value: object) -> str:
    """Check the name of an organ, which becomes the name of its files."""
    if not isinstance(value, str) or not value.strip():
        msg = f"the name {value!r} is empty or no text; give the organ a name such as bladder"
        raise ValueError(msg)
    bad = sorted({letter for letter in value if letter in _FORBIDDEN or not letter.isprintable()})
    if bad or value != value.strip(" .") or value.startswith("-"):
        what = f"holds {' '.join(map(repr, bad))}" if bad else "begins or ends with a blank, a dot or a hyphen"
        msg = f"the name {value!r} {what}, but it becomes a file name; use letters, digits and underscores"
        raise ValueError(msg)
    if len(value) > _LONGEST_NAME:
        msg = f"the name has {len(value)} letters; give one of at most {_LONGEST_NAME}"
        raise ValueError(msg)
    most = _LONGEST_FILE_NAME - _LONGEST_ENDING
    if len(_encoded(value)) > most:
        msg = f"the name takes {len(_encoded(value))} bytes, and file names have room for {most}; give a shorter one"
        raise ValueError(msg)
    if file_key(value) in _RESERVED:
        msg = f"the name {value!r} is that of a file with all organs; choose another"
        raise ValueError(msg)
    if file_key(value).split(".")[0].strip() in _DEVICES:
        msg = f"the name {value!r} is that of a device on Windows; choose another"
        raise ValueError(msg)
    return value


def file_key(name: str) -> str:
    """Return a key that is equal for names of one file where case and the encoding of accents do not matter."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def folder_name(value: object) -> str:
    """Check the name of a folder for results."""
    if not isinstance(value, str) or not value.strip():
        msg = "the name of the folder is empty; name one, or use . for the current one"
        raise ValueError(msg)
    if any(len(_encoded(part)) > _LONGEST_FILE_NAME for part in re.split(r"[/\\]", value)):
        msg = f"the folder has a name of more than {_LONGEST_FILE_NAME} bytes; give a shorter one"
        raise ValueError(msg)
    return value


def _encoded(name: str) -> bytes:
    return os.fsencode(name) if os.name != "nt" else name.encode("utf-8", "surrogateescape")
