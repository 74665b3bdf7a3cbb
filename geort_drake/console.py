"""Messages, warnings and progress bars on stderr, in the same style for commands and library."""

import contextlib
import errno
import logging
import re
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

from geort_drake.errors import GeortError

if TYPE_CHECKING:
    from geort_drake.retargeting.descent import Report

# Messages go to stderr, so stdout stays machine-readable; `quiet` silences all but warnings and errors.
console = Console(stderr=True, highlight=False)
# The extra that brings a package, which pip leaves out by default.
_EXTRAS = {
    "torch": "train",
    "mujoco": "mjcf",
    "onnxruntime": "onnx",
    "zmq": "live",
    "msgspec": "live",
    "aiohttp": "live",
    "cryptography": "live",
}
# The losses shown while a method trains.
_SHOWN_LOSSES = ("direction", "matching", "cover", "pinch", "collision")


def say(text: str) -> None:
    """Prints one line without markup or wrapping, so that paths and commands can be copied."""
    console.print(text, markup=False, soft_wrap=True)


def warn(message: Warning | str) -> None:
    """Prints a warning, also in a quiet run."""
    _print_labelled("warning", "yellow", message)


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str = "",
    caption: str = "",
    text: Sequence[str] = (),
) -> None:
    """Prints a table.

    Args:
        rows: cells, which may contain rich's markup.
        text: headings of further text columns, aligned left like the first; others contain numbers.
    """
    table = Table(title=title, caption=caption)
    for heading in headings:
        left = heading == headings[0] or heading in text
        table.add_column(heading, justify="left" if left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)


class Display(Progress):
    """Progress bars on stderr, one per task."""

    def counter(self, label: str) -> Callable[..., None]:
        """Returns a callback (done, total, note="") that draws a bar, from its first call on."""
        task: TaskID | None = None

        def update(done: int, total: int | None, note: str = "") -> None:
            nonlocal task
            if task is None:
                task = self.add_task(label, total=total, note="")
            self.update(task, completed=done, total=total, note=note)

        return update

    def losses(self, label: str) -> "Report":
        """Returns a `Report` callback that shows the losses of a training."""
        update = self.counter(label)

        def report(step: int, steps: int, losses: dict[str, float]) -> None:
            note = "  ".join(f"{key} {losses[key]:.3f}" for key in _SHOWN_LOSSES if key in losses)
            update(step, steps, note)

        return report


_NUMBERS = (MofNCompleteColumn, TimeElapsedColumn, TimeRemainingColumn)
_display: Display | None = None


@contextlib.contextmanager
def progress_bar(enabled: bool = True) -> Iterator[Display]:
    """Yields a display for work that may take over two seconds.

    A nested display adds its bars to the outer one, and removes them at the end of its block.
    """
    global _display  # noqa: PLW0603 (a terminal has one display)
    if not enabled or console.quiet:
        yield Display(disable=True)
    elif _display is not None:
        outer_tasks = {*_display.task_ids}
        yield _display
        for task in {*_display.task_ids} - outer_tasks:
            _display.remove_task(task)
    else:
        numbers = [each(table_column=Column(no_wrap=True)) for each in _NUMBERS]
        note = TextColumn("{task.fields[note]}", table_column=Column())  # wraps in a narrow terminal
        with Display("{task.description}", BarColumn(), *numbers, note, console=console) as _display:
            try:
                yield _display
            finally:
                _display = None


def track(
    label: str, items: Iterable[Any], total: int | None, note: Callable[[Any], str] = str
) -> Iterator[Any]:
    """Yields `items` and shows a bar that advances after each.

    Args:
        total: how many items there are; None if unknown.
        note: text shown for the last item.
    """
    with progress_bar() as display:
        update = display.counter(label)
        update(0, total)  # drawn before the first item is there
        for done, item in enumerate(items):
            update(done, total, note(item))
            yield item
            update(done + 1, total, note(item))


# Errors of the operating system that a user can correct, whichever file they concern.
_CORRECTABLE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}


def exit_code_of(function: Callable[[], int | None], debug: bool = False) -> int:
    """Runs a program and returns its exit code: its own result, 2 for an error that the user can correct.

    Warnings and errors are printed on stderr without traceback; `debug` adds it. SIGTERM interrupts like
    Ctrl-C, so that temporary files are removed. An OSError that names no file is ours, and is raised.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.getLogger("drake").addFilter(_first_of_its_kind())
    try:
        with warnings.catch_warnings():
            # Without the code location of the warning, which does not help a user.
            warnings.showwarning = lambda message, *_, **__: warn(message)
            return function() or 0
    except (GeortError, OSError) as error:
        if not isinstance(error, GeortError) and error.filename is None and error.errno not in _CORRECTABLE:
            raise
        if debug:
            traceback.print_exc()
        _print_labelled("error", "red", error)
        return 2
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        install = f"pip install 'geort-drake[{_EXTRAS[package]}]'"
        message = f"this needs the package {package}, which is not installed: {install}"
        _print_labelled("error", "red", message)
        return 2
    except MemoryError as error:
        _print_labelled("error", "red", f"not enough memory: {error}")
        return 2
    except (KeyboardInterrupt, ImportError) as error:
        # The import of an extension that is interrupted raises ImportError from the interruption.
        if KeyboardInterrupt not in (type(error), type(error.__cause__)):
            raise
        console.print("interrupted")
        return 130


def run_main(main: Callable[[Sequence[str] | None], int | None]) -> None:
    """Runs `main(None)` of a program and exits; see `exit_code_of`."""
    sys.exit(exit_code_of(lambda: main(None)))


def _print_labelled(label: str, colour: str, message: Warning | Exception | str) -> None:
    quiet, console.quiet = console.quiet, False
    try:
        console.print(f"[bold {colour}]{label}:[/]", end=" ")
        console.print(str(message), markup=False, soft_wrap=True)
    finally:
        console.quiet = quiet


def _first_of_its_kind() -> Callable[[logging.LogRecord], bool]:
    """Returns a filter that drops notices, and warnings that Drake repeats at every step."""
    seen: set[str] = set()

    def passes(record: logging.LogRecord) -> bool:
        record.msg = re.sub(r"^<literal-string>\S* ", "", record.getMessage())  # MJCF is parsed as a text
        record.args = ()
        kind = re.sub(r"^.*?warning: (geom \S+)?", "", record.msg)[:40]  # of any line or geometry
        new = record.levelno >= logging.WARNING and kind not in seen
        seen.add(kind)
        return new

    return passes
