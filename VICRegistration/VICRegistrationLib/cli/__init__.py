"""The command line ``vic-registration``: the function that runs a command, and its exit codes."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Sequence

from .console import LOG, lines_to
from .process import Terminated, flush_or_drop, stoppable

PROGRAM = "vic-registration"
USAGE_ERROR, SOME_FAILED, INTERRUPTED, BROKEN_PIPE, TERMINATED = 2, 3, 130, 141, 143


def main(arguments: Sequence[str] | None = None, *, program: str = PROGRAM) -> int:
    """Run a command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments after the program's name; those of the process if not given.
    program : str
        Name at the beginning of an error message; empty for callers that show the message themselves.

    Returns
    -------
    int
        0; 2 for an error, after one line on stderr that says what is wrong and what to do; 3 if some of several organs
        could not be fitted; 130 after Ctrl-C and 143 after SIGTERM; 141 if the reader of stdout has closed it. Nothing
        is written with 2, 130 and 143.

    Raises
    ------
    SystemExit
        With the same numbers, for ``--help``, ``--version`` and wrong usage.
    """
    name = f"{program}: " if program else ""
    error_name = f"{name}error: " if program else ""
    try:
        with stoppable(), lines_to(sys.stderr):
            # Imported here, because it takes about a second, in which the user may press Ctrl-C.
            from .arguments import parsed_arguments

            options = parsed_arguments(sys.argv[1:] if arguments is None else arguments)
            if getattr(options, "quiet", False):
                LOG.setLevel(logging.WARNING)
            code = options.run(options) or 0
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        return BROKEN_PIPE
    except KeyboardInterrupt:
        return _ended(f"{name}interrupted; nothing was written", INTERRUPTED)
    except Terminated:
        return _ended(f"{name}terminated; nothing was written", TERMINATED)
    except OverflowError as error:
        return _ended(f"{error_name}A number is too large ({error}); check the options.", USAGE_ERROR)
    except MemoryError:
        return _ended(
            f"{error_name}There is not enough memory; crop the image, or give a coarser net, mesh or chord error.",
            USAGE_ERROR,
        )
    except (ValueError, OSError, RuntimeError) as error:
        return _ended(f"{error_name}{error}", USAGE_ERROR)
    finally:
        # After --help too: Python reports an error if stdout is a closed pipe at its end.
        flush_or_drop(sys.stdout)


def _ended(line: str, code: int) -> int:
    with contextlib.suppress(BrokenPipeError):
        print(" ".join(line.split()), file=sys.stderr)
    flush_or_drop(sys.stderr)
    return code
