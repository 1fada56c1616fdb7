"""Further stacks of an organ: their arguments, and their entries in ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..imaging.reading import read_image
from ..messages import Diagnostic
from ..registration.stacks import StackUse

# Missing in reports of earlier versions.
_DEVIATIONS = ("translation_sd_mm", "rotation_sd_degrees")


def stack_place(given: str) -> tuple[str, dict[str, object]]:
    """Parse the argument of a further stack: IMAGE, FOLDER@SERIES or FILE@FRAME.

    Parameters
    ----------
    given : str

    Returns
    -------
    path : str
        The whole argument if it is a file or folder, or has no @.
    choice : dict
        `series` or `frame` as :func:`..imaging.reading.read_image` takes them.

    Raises
    ------
    ValueError
        If a frame is no whole number.
    """
    path, at, which = given.rpartition("@")
    if Path(given).exists() or not at or not Path(path).exists():
        return given, {}
    if Path(path).is_dir():
        return path, {"series": which}
    if not which.isascii() or not which.isdecimal():
        msg = f"{given} was given for a further stack; after a file and @ the number of a volume is needed, from 1."
        raise ValueError(msg)
    return path, {"frame": int(which)}


def motion_text(stack: StackUse) -> str:
    """Text with the motion of an organ from the first image to a stack, and its standard deviations."""
    shift = ", ".join(f"{value:+.1f}" for value in stack.translation_mm)
    return (
        f"R A S {shift} (± {stack.translation_sd_mm:.1g}) mm and {stack.rotation_degrees:.1f} "
        f"(± {stack.rotation_sd_degrees:.1g}) degrees"
    )


def stack_entry(stack: StackUse) -> dict[str, object]:
    """Make the entry of a stack for JSON.

    Parameters
    ----------
    stack : StackUse
        Named by the path of its file.

    Returns
    -------
    dict
        `translation_mm` and `rotation_degrees` are those of the organ about its centre, from the first image to this
        stack, those with `sd` their standard deviations, None where the stack was not compared with the first image,
        and `motion` is the whole matrix, RAS mm. `cost` is None where the stack shows no difference between both
        sides of the surface.
    """
    return {
        "file": stack.name,
        "used": stack.used,
        "reason": None if stack.reason is None else stack.reason.record(),
        "translation_mm": [float(value) for value in stack.translation_mm],
        "translation_sd_mm": _finite(stack.translation_sd_mm),
        "rotation_degrees": stack.rotation_degrees,
        "rotation_sd_degrees": _finite(stack.rotation_sd_degrees),
        "motion": stack.motion.tolist(),
        "center": [float(value) for value in stack.center],
        "share_of_area_seen": float(stack.seen),
        "cost": _finite(stack.cost),
    }


def _finite(value: float) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def restored_stack(entry: Mapping[str, object]) -> StackUse:
    """Restore a stack of an earlier run; its file must still exist.

    Raises
    ------
    OSError, ValueError
        If it is not, or the entry is damaged.
    """
    why, (path, choice) = entry["reason"], stack_place(entry["file"])
    return StackUse(
        name=entry["file"],
        # The earlier run has reported the warnings about its file.
        image=read_image(path, warn=lambda note: None, **choice),
        reason=None if why is None else Diagnostic.restored(why),
        motion=np.array(entry["motion"]),
        center=np.array(entry["center"]),
        seen=entry["share_of_area_seen"],
        cost=np.inf if entry["cost"] is None else entry["cost"],
        **{name: np.nan if entry.get(name) is None else entry[name] for name in _DEVIATIONS},
    )
