"""What all commands share: common options, checks of their values, and outputs.

A command is a dataclass: its docstring is the help, its fields are the options, and `run` does the work.
Messages go to stderr; `--quiet` leaves only warnings and errors. Only the JSON of `--json -` goes to stdout.
A command's last lines name its results and suggest the next commands.
"""

import json
import math
import os
import shlex
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    dataclass_transform,
    get_type_hints,
)

from tyro.conf import arg

from geort_drake.errors import OutputError, UsageError
from geort_drake.files import finite_json, require_writable, write_text
from geort_drake.resources import hand_names

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario

STDOUT = Path("-")
Side = Literal["left", "right"]
_HANDS = f"robot hand: one of {', '.join(hand_names())}, or a description file"
HandName = Annotated[str, arg(metavar="NAME", help=_HANDS)]
# File in a results folder → the commands that write it.
RESULT_FILES = {
    "results.json": "grasp",
    "trials.jsonl": "benchmark",
    "episodes.parquet": "export",
    "meta/info.json": "export",
}


T = TypeVar("T")


class Check(NamedTuple):
    """A condition on an option's value, or on each of several; part of the annotation of its field."""

    fits: Callable[[Any], bool]
    expected: str  # such as "a positive number"


class OutputFile(NamedTuple):
    """Marks an option as a file to write, whose name has this suffix; part of the annotation of its field."""

    suffix: str


SEED = Check(lambda number: number >= 0, "a whole number from 0")
COUNT = Check(lambda number: number >= 1, "a whole number from 1")
POSITIVE = Check(lambda number: 0 < number < math.inf, "a positive number")
Seed = Annotated[int, SEED]
Json = Annotated[
    Path | None,
    arg(metavar="FILE", help="also write the results as JSON to a file; - writes them to stdout"),
    OutputFile(".json"),
]


def _hint(default: str) -> str:
    """Returns what help says of a default; nothing for one that says nothing."""
    return "" if default in ("None", "False", "True", "") else f"(default: {default})"


@dataclass_transform(kw_only_default=True)
def options(cls: type[T]) -> type[T]:
    """Makes a class a dataclass of keyword-only options, whose help leaves out defaults that say nothing."""
    for name, hint in get_type_hints(cls, include_extras=True).items():
        if name in cls.__annotations__:
            cls.__annotations__[name] = Annotated[hint, arg(help_behavior_hint=_hint)]
    return dataclass(kw_only=True)(cls)


@options
class Command:
    """Options of every command."""

    quiet: bool = False
    """print only warnings and errors"""
    debug: bool = False
    """print the traceback of an error"""

    def check(self) -> None:
        """Checks every option by itself, as its annotation says, before any work begins.

        Raises:
            UsageError: a value does not fit; the message names the option.
            OutputError: an output file cannot be written.
        """
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            value = getattr(self, name)
            for mark in getattr(hint, "__metadata__", ()):
                if isinstance(mark, OutputFile) and value not in (None, STDOUT):
                    require_output_file(value, mark.suffix)
                elif isinstance(mark, Check) and value is not None:
                    several = isinstance(value, tuple)
                    for item in value if several else (value,):
                        if not mark.fits(item):
                            option = f"--{name.replace('_', '-')}"
                            raise UsageError(f"{option}: must be {mark.expected}, not {item}")

    def run(self) -> int:
        """Does the work and returns the exit code: 0 success, 1 partial success.

        Raises:
            GeortError: the input is invalid; `geort-drake` prints the message and exits with code 2.
        """
        raise NotImplementedError


@options
class ScenarioOptions:
    """Options that select a scenario; a base of commands that simulate."""

    hand: Annotated[str | None, arg(metavar="NAME", help=f"{_HANDS} (default: the scenario's)")] = None
    scenario_file: Annotated[Path | None, arg(metavar="FILE")] = None
    """YAML file with scenarios (default: the package's)"""
    scenario_name: Annotated[str, arg(metavar="NAME")] = "Grasp"
    """name of the scenario in the file"""
    scenario_text: Annotated[str | None, arg(metavar="YAML")] = None
    """YAML merged into the scenario, for example '{timeout: 30}'"""

    def load_scenario(self) -> "Scenario":
        """Loads the scenario; for errors see `load_scenario`."""
        from geort_drake import load_scenario

        return load_scenario(self.scenario_file, self.scenario_name, self.scenario_text, self.hand)


def methods_epilog(trained_only: bool = False) -> str:
    """Returns the help's list of all methods, or of those that are trained."""
    from geort_drake.retargeting import METHODS

    methods = {name: each for name, each in METHODS.items() if each.is_trained or not trained_only}
    lines = [f"  {name:12} {each.summary}" for name, each in methods.items()]
    return "\n".join(["methods:", *lines])


# -- checks of options, before any work begins


def require_output_file(path: Path, suffix: str) -> None:
    """Raises UsageError unless the file's name has this suffix, OutputError unless it can be written."""
    if path.suffix != suffix:
        raise UsageError(f"{path}: the name must end with {suffix}")
    require_writable(path)


def require_output_folder(folder: Path, mark: str = "") -> None:
    """Checks that results may be written to a folder.

    Args:
        mark: the file that the command writes there; results of other commands are refused.

    Raises:
        OutputError: the folder cannot be written to, or contains results of another command.
    """
    require_writable(folder, directory=True)
    for name, commands in RESULT_FILES.items() if mark else ():
        if name != mark and (folder / name).is_file() and (folder / name).stat().st_size:
            raise OutputError(
                f"{folder}: contains results of geort-drake {commands} ({name}); choose another folder"
            )


# -- outputs


def write_json(target: Path | None, content: Any, done: bool = True) -> None:
    """Writes `content` as --json requests: to stdout, to a file, or nowhere.

    Args:
        target: value of the option.
        content: JSON data; non-finite numbers become null.
        done: False for intermediate content, which is written to a file but not to stdout.
    """
    if target is None or (target == STDOUT and not done):
        return
    text = json.dumps(finite_json(content), indent=2, allow_nan=False)
    if target == STDOUT:
        print(text)
    else:
        write_text(target, text + "\n")


def finish(results: dict[str, Any], *commands: str | None) -> None:
    """Prints a command's last lines: results with their paths, then suggested commands."""
    from geort_drake.console import say

    for what, where in results.items():
        say(f"{what}: {where}")
    for line in commands:
        if line is not None:
            say(f"next: {line}")


def command(*words: str | os.PathLike, **options: Any) -> str:
    """Formats a `geort-drake` command to type in this folder.

    Args:
        words: the command's name, and its positional arguments.
        options: values of options by name; an option whose value is None is left out.
    """
    line = [str(word) for word in words]
    for name, value in options.items():
        if value is not None:
            line += [f"--{name.replace('_', '-')}", str(value)]
    return shlex.join([*_program("geort-drake"), *line])


def view(path: str | os.PathLike | None, pattern: str = "") -> str | None:
    """Formats a command that opens a Rerun recording; appends `pattern`, such as "/*.rrd", to the path."""
    return None if path is None else shlex.join([*_program("rerun"), str(path)]) + pattern


def _program(name: str) -> list[str]:
    """Returns the name of a program installed next to this Python if the shell finds it, else its path."""
    script = Path(sys.executable).with_name(name)
    on_path = shutil.which(name)
    if script.exists():
        same = on_path is not None and Path(on_path) == script
        return [name if same else min(str(script), os.path.relpath(script), key=len)]
    return [*_program("python"), "-m", "geort_drake"] if name == "geort-drake" else [name]
