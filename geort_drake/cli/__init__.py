"""The command `geort-drake` and its subcommands, one module each.

A subcommand's module has a docstring whose first line is its summary, `add_arguments(parser)`,
`run(arguments)`, which returns the exit code, and optionally `EPILOG`, the text below its options. It imports
NumPy, Drake, PyTorch and Rerun inside `run`, so that `--help` answers at once.
"""

import importlib
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from geort_drake.cli.options import CommandParser

# In the order of `geort-drake --help`.
COMMANDS = (
    "grasp",
    "train",
    "pretrain",
    "refit",
    "evaluate",
    "explore",
    "benchmark",
    "add-hand",
    "check-recording",
    "convert",
    "synthesize",
    "capture",
    "live",
    "publish",
    "stand-in-robot",
    "export",
)
_USAGE = "usage: geort-drake COMMAND ...\n       geort-drake COMMAND --help\n       geort-drake --version\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `geort-drake` with `argv` (default: the arguments of this process).

    Returns:
        The exit code: 0 success, 1 partial success, 2 invalid input, 130 interrupted.
    """
    try:
        return _run(argv)
    except KeyboardInterrupt:  # while modules are imported; later `exit_code_of` handles it
        print("interrupted", file=sys.stderr)
        return 130


def _run(argv: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    first = arguments[0] if arguments else "--help"
    if first in ("-h", "--help"):
        print(_overview())
        return 0
    if first == "--version":
        from geort_drake import __version__

        print(__version__)
        return 0
    if first not in COMMANDS:
        print(
            f"{_USAGE}error: unknown command '{first}'; choose one of: {', '.join(COMMANDS)}", file=sys.stderr
        )
        return 2
    if {"-h", "--help"} & {*arguments}:
        return run_command(first, arguments[1:])  # prints the help and exits
    from geort_drake.console import exit_code_of

    return exit_code_of(lambda: run_command(first, arguments[1:]))


def run_command(name: str, argv: Sequence[str]) -> int:
    """Runs a subcommand in this process and returns its exit code.

    Raises:
        GeortError: the input is invalid; `main` prints the message and returns exit code 2.
        SystemExit: the arguments cannot be parsed, or request help.
    """
    arguments = parser_of(name).parse_args(argv)
    from geort_drake.console import console

    console.quiet = arguments.quiet
    return load_command(name).run(arguments)


def parser_of(name: str) -> "CommandParser":
    """Returns the argument parser of a subcommand."""
    from geort_drake.cli.options import CommandParser

    command = load_command(name)
    parser = CommandParser(f"geort-drake {name}", command.__doc__, getattr(command, "EPILOG", None))
    command.add_arguments(parser)
    return parser


def load_command(name: str) -> ModuleType:
    """Imports the module of a subcommand."""
    return importlib.import_module(f"{__name__}.{name.replace('-', '_')}")


def _overview() -> str:
    lines = [f"  {name:16} {(load_command(name).__doc__ or '').splitlines()[0]}" for name in COMMANDS]
    return "\n".join(
        [
            _USAGE,
            "Retarget a human hand to a robot hand, and test the result in a Drake simulation.",
            "",
            "commands:",
            *lines,
        ]
    )
