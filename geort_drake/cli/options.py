"""What the command lines of the scripts share: how their help looks, and options and checks of several.

Every script speaks on stderr; `--quiet` leaves warnings and errors of that. On stdout is nothing but the JSON
that `--json` asks for. What a script says last is where its results are and how to go on with them.
"""

import argparse
import json
import math
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import geort_drake
from geort_drake.cli.console import console
from geort_drake.files import finite_json, require_writable, write_text

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario

SCRIPTS = Path(geort_drake.__file__).resolve().parents[1] / "scripts"
# Name of a retargeting method → what --help says of it.
METHOD_SUMMARIES = {
    "geort_coupled": "all five criteria, by fingers that see each other; the default",
    "geort": "the paper's: one network per finger, each on its own",
    "linear_offline": "a network trained on Eq. 1 of the paper (Robotic Telekinesis)",
    "vector_online": "AnyTeleop's vectors, optimised at every frame",
    "dexpilot_online": "DexPilot's vectors, optimised at every frame",
    "nearest_neighbour": "the nearest of 300 stored hands",
    "hold": "ignores the person's fingers",
}
# Those that learn; the others need no training.
TRAINED_METHODS = ("geort_coupled", "geort", "linear_offline")
STDOUT = Path("-")


class _Help(argparse.RawDescriptionHelpFormatter):
    """Texts as they are laid out, and behind each option's help its default."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text, default = action.help or "", action.default
        told = "(default: " in text or not action.option_strings
        nothing = default is None or isinstance(default, bool) or default in (argparse.SUPPRESS, [], ())
        if told or nothing:
            return text
        return f"{text} (default: {_shown(default)})".strip()


class _Parser(argparse.ArgumentParser):
    """A parser that obeys --quiet, and refuses a file for --json that cannot be written."""

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        # Options may stand between the files as well.
        arguments = self.parse_intermixed_args(args, namespace)
        console.quiet = arguments.quiet
        check_outputs(self, (getattr(arguments, "json", None), ".json"))
        return arguments


def make_parser(description: str | None, epilog: str | None = None) -> argparse.ArgumentParser:
    """A parser with --quiet, whose help shows both texts as they are laid out, and every option's default.

    Args:
        description: the script's docstring.
        epilog: what stands below the options.
    """
    parser = _Parser(description=description, epilog=epilog, formatter_class=_Help)
    parser.add_argument("--quiet", action="store_true", help="say nothing but warnings and errors")
    return parser


def add_json_option(parser: argparse.ArgumentParser, what: str) -> None:
    """The option --json, which `write_json` obeys.

    Args:
        what: what is written, such as "the metrics".
    """
    parser.add_argument(
        "--json",
        nargs="?",
        type=_json_file,
        const=STDOUT,
        metavar="FILE",
        help=f"{what} as JSON: on stdout, or in FILE (.json)",
    )


def write_json(target: Path | None, content: Any, done: bool = True) -> None:
    """Writes `content` where the option --json said: to stdout, to a file, or nowhere.

    Args:
        target: what the option gave.
        content: what JSON can hold; numbers that are not finite become null.
        done: False where more will come, which a file is to show and stdout is not.
    """
    if target is None or (target == STDOUT and not done):
        return
    text = json.dumps(finite_json(content), indent=2, allow_nan=False)
    if target == STDOUT:
        print(text)
    else:
        write_text(target, text + "\n")


def method_help(names: Iterable[str] = tuple(METHOD_SUMMARIES)) -> str:
    """A paragraph for the epilog: what each of these methods is, in a line."""
    return "methods:\n" + "".join(f"  {name:18} {METHOD_SUMMARIES[name]}\n" for name in names)


def command(name: str, *words: str | os.PathLike) -> str:
    """A command as one would type it here.

    Args:
        name: a program installed beside this Python, such as "rerun", or a script's file, such as
            "simulate_grasp.py".
        words: its arguments.
    """
    if name.endswith(".py"):
        script = SCRIPTS / name
        start = [_program("python"), os.path.relpath(script) if script.exists() else f"scripts/{name}"]
    else:
        start = [_program(name)]
    return shlex.join([*start, *map(str, words)])


def add_scenario_options(parser: argparse.ArgumentParser, example: str = "{timeout: 30}") -> None:
    """The options that choose a scenario and change it, which `scenario_of` reads.

    Args:
        example: a change that makes sense for the script, in YAML.
    """
    add = parser.add_argument_group("scenario").add_argument
    add("--hand", help="robot hand, by name or file of its description (default: the scenario's)")
    add("--scenario_file", type=Path, help="scenarios in YAML (default: diagrams/grasp.scenarios.yaml)")
    add("--scenario_name", default="Grasp", help="which scenario of the file")
    add("--scenario_text", help=f"YAML merged into the scenario, for example '{example}'")


def scenario_of(arguments: argparse.Namespace) -> "Scenario":
    """The scenario that the options of `add_scenario_options` stand for.

    Raises:
        ScenarioError, HandError, UnknownNameError: see `load_scenario`.
    """
    # Here, so that --help does not load Drake.
    from geort_drake.simulation.scenario import load_scenario

    return load_scenario(
        arguments.scenario_file, arguments.scenario_name, arguments.scenario_text, arguments.hand
    )


def at_least(lowest: int) -> Callable[[str], int]:
    """The type of an option that takes a whole number from `lowest` on."""

    def whole_number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be a whole number, not '{text}'") from None
        if value < lowest:
            raise argparse.ArgumentTypeError(f"must be at least {lowest}, not {text}")
        return value

    return whole_number


def positive(text: str) -> float:
    """The type of an option that takes a positive, finite number."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, not '{text}'") from None
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be positive, not {text}")
    return value


def check_outputs(parser: argparse.ArgumentParser, *outputs: tuple[Path | None, str]) -> None:
    """Checks, before anything is written, all files that a script will write: a path and its suffix each.

    Raises:
        OutputError: a path cannot be written. Another suffix ends the program through `parser`.
    """
    for path, suffix in outputs:
        if path is None or path == STDOUT:
            continue
        if path.suffix != suffix:
            parser.error(f"{path}: the name must end with {suffix}")
        require_writable(path)


def _json_file(text: str) -> Path:
    # What stands behind --json may be meant for something else, and is not to be overwritten then.
    if text != str(STDOUT) and Path(text).suffix != ".json":
        raise argparse.ArgumentTypeError(
            f"{text}: the name must end with .json; to print on stdout, give --json last"
        )
    return Path(text)


def _program(name: str) -> str:
    """A program beside this Python: its name where the shell finds that one, else its path."""
    beside = Path(sys.executable).with_name(name)
    found = shutil.which(name)
    if not beside.exists() or (found and Path(found) == beside):
        return name
    return min(str(beside), os.path.relpath(beside), key=len)


def _shown(default: Any) -> str:
    if isinstance(default, list | tuple):
        return " ".join(map(_shown, default))
    if isinstance(default, Path) and default.is_absolute() and default.is_relative_to(Path.cwd()):
        return str(default.relative_to(Path.cwd()))
    return f"{default:g}" if isinstance(default, float) else str(default)
