"""What every script shares: one console, progress bars, warnings, and errors that end with exit code 2."""

import logging
import sys
import warnings
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from geort_drake.errors import GeortError

# Progress and tables go to stderr so that a script's stdout stays machine-readable. With --quiet it is quiet;
# warnings and errors are said all the same.
console = Console(stderr=True, highlight=False)


def progress_bar() -> Progress:
    """A progress display for work that may take over two seconds; use as a context manager."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
        transient=False,
        disable=console.quiet,
    )


def warn(message: Warning | str) -> None:
    """Says on stderr what a user should know even of a quiet run."""
    _say("warning", "yellow", message)


def run_main(main: Callable[[Sequence[str] | None], int | None]) -> None:
    """Runs a script's `main` and exits: 0 when it worked, 2 when the user can correct something.

    Warnings and errors are printed on stderr as their text alone.
    """
    logging.getLogger("drake").addFilter(_first_of_its_kind())
    try:
        with warnings.catch_warnings():
            # Where in the code a warning was raised says nothing to a user.
            warnings.showwarning = lambda message, *_, **__: warn(message)
            sys.exit(main(None) or 0)
    except (GeortError, OSError) as error:
        _say("error", "red", error)
        sys.exit(2)
    except MemoryError as error:
        _say("error", "red", f"there is not enough memory for what was asked for: {error}")
        sys.exit(2)
    except KeyboardInterrupt:
        console.print("interrupted")
        sys.exit(130)


def _say(kind: str, colour: str, message: Warning | Exception | str) -> None:
    quiet, console.quiet = console.quiet, False
    try:
        console.print(f"[bold {colour}]{kind}:[/]", end=" ")
        console.print(str(message), markup=False, soft_wrap=True)
    finally:
        console.quiet = quiet


def _first_of_its_kind() -> Callable[[logging.LogRecord], bool]:
    """A filter that passes a warning once and no notices: Drake repeats some of both at every step."""
    seen: set[str] = set()

    def passes(record: logging.LogRecord) -> bool:
        kind = record.getMessage()[:40]
        new = record.levelno >= logging.WARNING and kind not in seen
        seen.add(kind)
        return new

    return passes
