"""What the command lines of the scripts share: how their help looks, and options and checks of several."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.files import require_writable

if TYPE_CHECKING:
    from geort_drake.simulation.scenario import Scenario


def make_parser(description: str | None, epilog: str | None = None) -> argparse.ArgumentParser:
    """A parser whose help shows both texts as they are laid out.

    Args:
        description: the script's docstring.
        epilog: what stands below the options.
    """
    return argparse.ArgumentParser(
        description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_scenario_options(parser: argparse.ArgumentParser, example: str = "{timeout: 30}") -> None:
    """The options that choose a scenario and change it, which `scenario_of` reads.

    Args:
        example: a change that makes sense for the script, in YAML.
    """
    add = parser.add_argument_group("scenario").add_argument
    add("--hand", help="robot hand, by name or file of its description (the scenario's)")
    add("--scenario_file", type=Path, help="scenarios in YAML (the package's)")
    add("--scenario_name", default="Grasp", help="which scenario of the file (Grasp)")
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
        if path is None:
            continue
        if path.suffix != suffix:
            parser.error(f"{path}: the name must end with {suffix}")
        require_writable(path)
