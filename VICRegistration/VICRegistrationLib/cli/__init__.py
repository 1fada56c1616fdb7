"""The command line: ``vic-registration fit``, ``phantom`` and ``reproduce``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .arguments import PROGRAM, parsed_arguments

USAGE_ERROR, INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name; those of the process if not given.

    Returns
    -------
    int
        0; or 2 after one line on stderr that says what is wrong and what to do, with nothing half written; or 130
        after Ctrl-C.

    Raises
    ------
    SystemExit
        With the same numbers, for ``--help``, ``--version`` and wrong usage.
    """
    options = parsed_arguments(sys.argv[1:] if arguments is None else arguments)
    try:
        options.run(options)
    except KeyboardInterrupt:
        return _ended(f"{PROGRAM}: interrupted; nothing was written", INTERRUPTED)
    except MemoryError:
        return _ended(
            f"{PROGRAM}: error: There is not enough memory; crop the image or use a smaller net.", USAGE_ERROR
        )
    except (ValueError, OSError, RuntimeError) as error:
        return _ended(f"{PROGRAM}: error: {error}", USAGE_ERROR)
    return 0


def _ended(line: str, code: int) -> int:
    print(" ".join(line.split()), file=sys.stderr)
    return code
