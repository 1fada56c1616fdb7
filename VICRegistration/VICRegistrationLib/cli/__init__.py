"""The command line ``vic-registration``: one function that runs it, and the codes it ends with."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .process import Terminated, stoppable

PROGRAM = "vic-registration"
USAGE_ERROR, INTERRUPTED, TERMINATED = 2, 130, 143


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
        after Ctrl-C and 143 after SIGTERM, with nothing written.

    Raises
    ------
    SystemExit
        With the same numbers, for ``--help``, ``--version`` and wrong usage.
    """
    try:
        with stoppable():
            # Takes about a second, in which Ctrl-C is pressed too.
            from .arguments import parsed_arguments

            options = parsed_arguments(sys.argv[1:] if arguments is None else arguments)
            options.run(options)
    except KeyboardInterrupt:
        return _ended(f"{PROGRAM}: interrupted; nothing was written", INTERRUPTED)
    except Terminated:
        return _ended(f"{PROGRAM}: terminated; nothing was written", TERMINATED)
    except OverflowError as error:
        return _ended(
            f"{PROGRAM}: error: A number is too large to be worked with ({error}); check the options.", USAGE_ERROR
        )
    except MemoryError:
        return _ended(
            f"{PROGRAM}: error: There is not enough memory; crop the image, or ask for a coarser net, mesh or chord "
            "error.",
            USAGE_ERROR,
        )
    except (ValueError, OSError, RuntimeError) as error:
        return _ended(f"{PROGRAM}: error: {error}", USAGE_ERROR)
    return 0


def _ended(line: str, code: int) -> int:
    print(" ".join(line.split()), file=sys.stderr)
    return code
