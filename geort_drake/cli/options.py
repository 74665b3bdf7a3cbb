"""Options, option types and outputs shared by all commands.

Messages go to stderr; `--quiet` leaves only warnings and errors. Only the JSON of `--json` goes to stdout. A
command's last lines name its results and suggest the next commands.
"""

import argparse
import contextlib
import json
import math
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geort_drake.errors import OutputError, UsageError
from geort_drake.files import finite_json, require_writable, write_text
from geort_drake.resources import hand_names

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario

# Copies of names from modules that import slowly, to keep --help fast; tests compare them.
DEFAULT_HAND = "allegro_right"
SIDES = ("left", "right")
DEFAULT_METHOD = "geort"
DEFAULT_SCENARIO = "Grasp"
SHIPPED_METHOD = "universal"
STDOUT = Path("-")
# File in a results folder → the only commands that write it.
RESULT_FILES = {
    "results.json": "grasp",
    "trials.jsonl": "benchmark",
    "episodes.parquet": "export",
    "meta/info.json": "export",
}


class _Help(argparse.RawDescriptionHelpFormatter):
    """Keeps the layout of texts and appends each option's default to its help."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text, default = action.help or "", action.default
        stated = "(default: " in text or not action.option_strings
        nothing = default is None or isinstance(default, bool) or default in (argparse.SUPPRESS, [], ())
        if stated or nothing:
            return text
        shown = " ".join(map(str, default)) if isinstance(default, list | tuple) else f"{default}"
        return f"{text} (default: {shown.removesuffix('.0')})".strip()


class CommandParser(argparse.ArgumentParser):
    """A parser with --quiet and the options that commands share.

    Options may appear between positional arguments.

    Args:
        program: name in the usage line.
        description, epilog: texts above and below the options, whose layout is kept. In the epilog,
            "{methods}", "{trained methods}" and "{formats}" stand for lists of these.
    """

    def __init__(self, program: str | None, description: str | None, epilog: str | None = None):
        epilog = re.sub(r"\{[a-z ]+\}", lambda found: _list(found[0]), epilog or "")
        super().__init__(prog=program, description=description, epilog=epilog, formatter_class=_Help)
        self.add_argument("--quiet", action="store_true", help="print only warnings and errors")

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        # Shells leave a ~ behind an equals sign, as in --output=~/run.
        parts = [word.partition("=") for word in (sys.argv[1:] if args is None else args)]
        words = [name + equals + os.path.expanduser(value) for name, equals, value in parts]
        return self.parse_intermixed_args(words, namespace)

    def add_json(self, what: str) -> None:
        """Adds --json, for `write_json`; `what` names the contents, such as "the metrics"."""
        text = f"write {what} as JSON to stdout, or to FILE (.json)"
        self.add_argument("--json", nargs="?", type=_json_file, const=STDOUT, metavar="FILE", help=text)

    def add_output(self, default: str, mark: str) -> None:
        """Adds --output, a folder for the results; `mark` is the file in it that the command writes."""
        kind = _results_folder(mark)
        self.add_argument("--output", type=kind, default=default, help="folder for the results")

    def add_hand(self, default: str | None = DEFAULT_HAND, note: str = "", group: Any = None) -> None:
        """Adds --hand; `note` describes the default in the help."""
        text = f"robot hand: one of {', '.join(hand_names())}, or a description file{note}"
        (group or self).add_argument("--hand", default=default, help=text)

    def add_seed(self, what: str) -> None:
        """Adds --seed; `what` names what the seed determines."""
        self.add_argument("--seed", type=at_least(0), default=0, help=f"seed of {what}")

    def add_side(self, default: str | None = None) -> None:
        """Adds --side, the side of the recorded hand."""
        note = "" if default else " (default: the robot hand's)"
        self.add_argument("--side", choices=SIDES, default=default, help=f"side of the recorded hand{note}")

    def add_workers(self) -> None:
        """Adds --jobs and --backend, for commands that run many trials."""
        text = "number of parallel trials (default: the number of processors)"
        self.add_argument("--jobs", type=at_least(1), default=os.cpu_count() or 1, help=text)
        text = "run on this machine (loky) or on a Ray cluster"
        self.add_argument("--backend", default="loky", choices=["loky", "ray"], help=text)

    def add_scenario(self, example: str = "{timeout: 30}") -> None:
        """Adds the options of a scenario, for `scenario_of`; `example` is a change in YAML."""
        group = self.add_argument_group("scenario")
        self.add_hand(None, " (default: the scenario's)", group)
        group.add_argument(
            "--scenario-file", type=Path, help="YAML file with scenarios (default: the package's)"
        )
        group.add_argument(
            "--scenario-name", default=DEFAULT_SCENARIO, help="name of the scenario in the file"
        )
        text = f"YAML merged into the scenario, for example '{example}'"
        group.add_argument("--scenario-text", help=text)


def methods_for(hand: str) -> tuple[str, ...]:
    """Returns all methods; the universal map only if one is shipped for the hand, a name or file."""
    from geort_drake.hands.description import load_hand
    from geort_drake.retargeting import METHODS
    from geort_drake.retargeting.store import shipped_maps

    shipped = load_hand(hand).name in shipped_maps()
    return tuple(name for name in METHODS if shipped or name != SHIPPED_METHOD)


def _list(name: str) -> str:
    """Returns the text for a placeholder of an epilog."""
    from geort_drake.people.formats import FORMATS
    from geort_drake.retargeting import METHODS

    if name == "{formats}":
        return "formats:\n" + "".join(f"  {name:16} {each.title}\n" for name, each in FORMATS.items())
    methods = {key: each for key, each in METHODS.items() if name == "{methods}" or each.is_trained}
    return "methods:\n" + "".join(f"  {key:18} {each.summary}\n" for key, each in methods.items())


# -- option types


def _number(read: Callable[[str], Any], fits: Callable[[Any], bool], expected: str) -> Callable[[str], Any]:
    def number(text: str) -> Any:
        with contextlib.suppress(ValueError):
            if fits(value := read(text)):
                return value
        raise argparse.ArgumentTypeError(f"must be {expected}, not '{text}'")

    return number


def at_least(lowest: int) -> Callable[[str], int]:
    """Returns the type of whole numbers from `lowest` on."""
    return _number(int, lambda value: value >= lowest, f"a whole number, at least {lowest}")


positive = _number(float, lambda value: value > 0, "a positive number")  # or inf
port = _number(int, lambda value: 0 <= value < 65536, "a port from 0 to 65535")
finite = _number(float, lambda value: 0 < value < math.inf, "a positive, finite number")


def output_file(suffix: str) -> Callable[[str], Path]:
    """Returns the type of a writable file (else OutputError) with that suffix (else UsageError)."""

    def path(text: str) -> Path:
        if Path(text).suffix != suffix:
            raise UsageError(f"{text}: the name must end with {suffix}")
        require_writable(text)
        return Path(text)

    return path


def output_folder(text: str) -> Path:
    """Option type: a folder to write, which may exist and must be writable (else OutputError)."""
    require_writable(text, directory=True)
    return Path(text)


def _results_folder(mark: str) -> Callable[[str], Path]:
    """Returns the type of a folder without results of other commands (else OutputError)."""

    def path(text: str) -> Path:
        folder = output_folder(text)
        for name, commands in RESULT_FILES.items():
            if name != mark and (folder / name).is_file() and (folder / name).stat().st_size:
                raise OutputError(
                    f"{folder}: contains results of geort-drake {commands} ({name}); choose another folder"
                )
        return folder

    return path


def _json_file(text: str) -> Path:
    if text == str(STDOUT):
        return STDOUT
    # The word after --json may be another argument, such as a recording, which must not be overwritten.
    if Path(text).suffix != ".json":
        raise argparse.ArgumentTypeError(
            f"{text}: the name must end with .json; to print on stdout, give --json last"
        )
    return output_file(".json")(text)


# -- objects that options select


def scenario_of(arguments: argparse.Namespace) -> "Scenario":
    """Loads the scenario that the options of `add_scenario` select; for errors see `load_scenario`."""
    from geort_drake import load_scenario

    return load_scenario(
        arguments.scenario_file, arguments.scenario_name, arguments.scenario_text, arguments.hand
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


def command(*words: str | os.PathLike | None) -> str:
    """Formats a `geort-drake` command to type in this folder; options whose value is None are left out."""
    kept: list[str] = []
    for word in words:
        if word is None:
            kept.pop()
        else:
            kept.append(str(word))
    return shlex.join([*_program("geort-drake"), *kept])


def view(path: str | os.PathLike | None, pattern: str = "") -> str | None:
    """Formats a command that opens a Rerun recording; appends `pattern`, such as "/*.rrd", to the path."""
    return None if path is None else shlex.join([*_program("rerun"), str(path)]) + pattern


def _program(name: str) -> list[str]:
    """Returns the name of a program installed next to this Python if the shell finds it, else its path."""
    installed = Path(sys.executable).with_name(name)
    found = shutil.which(name)
    if installed.exists():
        same = found is not None and Path(found) == installed
        return [name if same else min(str(installed), os.path.relpath(installed), key=len)]
    return [*_program("python"), "-m", "geort_drake"] if name == "geort-drake" else [name]
