"""JSON files with a schema, which store numbers exactly; RAS mm, one key of the outer object in each line."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

_FRAME_AND_UNIT = {"frame": "RAS", "unit": "mm"}


def json_text(content: Mapping[str, object]) -> str:
    """Return the text of a file, with enough digits that each number is read as the same double.

    Parameters
    ----------
    content : mapping of str to object
        All numbers must be finite.

    Returns
    -------
    str
    """
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def file_bytes(path: Path, *, kind: str) -> bytes:
    """Read a file.

    Parameters
    ----------
    path : Path
    kind : str
        Kind of content, for messages: "surface".

    Returns
    -------
    bytes

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        msg = f"The {kind} file {path} cannot be read ({error.strerror}); give a file that exists."
        raise OSError(msg) from error


def checked_content(
    text: str | bytes, where: str, *, kind: str, schema: str, version: int, keys: Sequence[str] = ()
) -> dict[str, object]:
    """Parse the text of a file; refuse another schema, version, frame or unit, and missing or repeated keys.

    Parameters
    ----------
    text : str or bytes
    where : str
        What holds it, for messages: "file bladder.json".
    kind : str
        Kind of content, for messages: "surface".
    schema : str
    version : int
    keys : sequence of str
        Required keys. If "frame" and "unit" are among them, their values must be "RAS" and "mm".

    Returns
    -------
    dict of str to object

    Raises
    ------
    ValueError
        With a sentence for the user.
    """
    try:
        content = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_without_duplicates)
    except (ValueError, RecursionError) as error:
        msg = f"The {where} is not valid JSON ({error}); correct it, or give another {kind} file."
        raise ValueError(msg) from error
    if not isinstance(content, dict) or content.get("schema") != schema:
        found = content.get("schema") if isinstance(content, dict) else None
        given = "no schema" if found is None else f"the schema {found!r}"
        msg = f'The {where} has {given}; "schema": "{schema}" is needed, give a {kind} file.'
        raise ValueError(msg)
    found = content.get("version")
    if isinstance(found, bool) or found != version:
        msg = f"The {where} has version {found!r}; version {version} is understood, update the program."
        raise ValueError(msg)
    missing = [key for key in keys if key not in content]
    if missing:
        msg = f"The {where} lacks {', '.join(missing)}; write the {kind} again with all keys."
        raise ValueError(msg)
    for key, needed in _FRAME_AND_UNIT.items():
        if key in keys and content[key] != needed:
            msg = f"The {where} has the {key} {content[key]!r}; convert the {kind} to {needed!r}."
            raise ValueError(msg)
    return content


def _refuse_constant(text: str) -> float:
    msg = f"{text} is not a number"
    raise ValueError(msg)


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    keys = [key for key, _ in pairs]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        msg = f"the key {twice[0]!r} occurs twice in one object"
        raise ValueError(msg)
    return dict(pairs)
