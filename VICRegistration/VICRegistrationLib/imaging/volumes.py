"""Choice of one volume from a file or a series with several."""

from __future__ import annotations

from numbers import Integral


class SeveralVolumes(ValueError):
    """There are several volumes or series, and none was chosen.

    Parameters
    ----------
    found : str
        Sentence that lists them, without its full stop.
    way_out : str
        Continuation of the message: what to do.
    """

    def __init__(self, found: str, way_out: str) -> None:
        super().__init__(f"{found}{way_out}")
        self.found = found


def volume_index(frame: int | None, count: int, what: str, found: str = "") -> int:
    """Return the index of the chosen volume.

    Parameters
    ----------
    frame : int, optional
        Its number from 1.
    count : int
        Number of volumes.
    what : str
        The file or series, for messages.
    found : str
        Sentence about them, without its full stop.

    Returns
    -------
    int
        From 0.

    Raises
    ------
    SeveralVolumes
        If there are several and none was chosen.
    ValueError
        If there is no volume with this number, or it is no integer.
    """
    if frame is not None and (isinstance(frame, bool) or not isinstance(frame, Integral)):
        msg = f"Volume {frame!r} was asked for; its number is a whole one, from 1."
        raise ValueError(msg)
    if frame is not None and not 1 <= frame <= count:
        found, needed = ("1 volume", "leave it out") if count == 1 else (f"{count} volumes", f"give 1 to {count}")
        msg = f"Volume {frame} was asked for, but {what} holds {found}; {needed}."
        raise ValueError(msg)
    if frame is None and count > 1:
        way_out = f"; one volume is needed. Choose it with --frame 1 to --frame {count}."
        raise SeveralVolumes(found or f"{what} holds {count} volumes", way_out)
    return int(frame or 1) - 1
