"""The command `geort-drake` and its subcommands.

A subcommand is a dataclass in one of this package's modules, which tyro reads: see `base.Command`. Its module
imports NumPy, Drake, PyTorch and Rerun inside `run`, so that `--help` answers at once.
"""

import contextlib
import difflib
import importlib
import inspect
import os
import sys
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from geort_drake.cli.base import Command

# Purpose → command → its module and class, in the order of `geort-drake --help`.
GROUPS: dict[str, dict[str, str]] = {
    "try and drive": {
        "grasp": "simulate:Grasp",
        "simulate": "simulate:Simulate",
        "live": "live:Live",
        "live publish": "live:Publish",
        "live stand-in-robot": "live:StandInRobot",
    },
    "record": {
        "recording check": "recording:CheckRecording",
        "recording convert": "recording:ConvertRecording",
        "recording synthesize": "recording:SynthesizeRecording",
        "recording protocol": "recording:ShowProtocol",
    },
    "train": {"train": "train:Train"},
    "compare": {
        "evaluate": "compare:Evaluate",
        "explore": "compare:Explore",
        "benchmark": "benchmark:Benchmark",
    },
    "hands and data": {
        "hand add": "hand:AddHand",
        "hand list": "hand:ListHands",
        "export": "export:Export",
    },
}
COMMANDS = {name: place for group in GROUPS.values() for name, place in group.items()}
_USAGE = "usage: geort-drake COMMAND ...\n       geort-drake COMMAND --help\n       geort-drake --version\n"
_HELP = {"-h", "--help"}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `geort-drake` with `argv` (default: the arguments of this process).

    Returns:
        The exit code: 0 success, 1 partial success, 2 invalid input, 130 interrupted.
    """
    try:
        return _run(list(sys.argv[1:] if argv is None else argv))
    except KeyboardInterrupt:  # while modules are imported; later `exit_code_of` handles it
        print("interrupted", file=sys.stderr)
        return 130
    except ModuleNotFoundError as error:  # where the package was installed without its dependencies
        package = (error.name or "geort_drake").partition(".")[0]
        if package == "geort_drake":
            raise
        print(
            f"error: the package '{package}' is not installed; commands need all dependencies:"
            " pip install geort-drake. To call a map in a program, you need only NumPy and safetensors.",
            file=sys.stderr,
        )
        return 2


def _run(words: list[str]) -> int:
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    if not words or words[0] in _HELP:
        name = " ".join(word for word in words if word not in _HELP)
        if name in COMMANDS:
            return run_command(name, ["--help"])
        print(_overview())
        return 0
    if words[0] == "--version":
        from geort_drake import __version__

        print(__version__)
        return 0
    command, rest = split_command(words)
    if command is None:
        return _refuse(words)
    if _HELP & {*rest}:
        return run_command(command, rest)  # prints the help and exits
    from geort_drake.console import exit_code_of

    return exit_code_of(lambda: run_command(command, rest), debug="--debug" in rest)


def split_command(words: Sequence[str]) -> tuple[str | None, list[str]]:
    """Separates the name of a command, of one or two words, from its arguments."""
    for count in (2, 1):
        name = " ".join(words[:count])
        if name in COMMANDS:
            return name, list(words[count:])
    return None, list(words)


def _refuse(words: Sequence[str]) -> int:
    """Names the commands that an unknown one may stand for, and returns the exit code."""
    within = [name for name in COMMANDS if name.startswith(f"{words[0]} ")]
    if within and len(words) > 1 and not words[1].startswith("-"):
        matches = difflib.get_close_matches(" ".join(words[:2]), within, 1, 0.5)
    elif within:
        if _HELP & {*words}:
            print(_overview(within))
            return 0
        matches = []
    else:
        matches = difflib.get_close_matches(words[0], COMMANDS, 1, 0.5)
    choices = within or list(COMMANDS)
    hint = f"did you mean '{matches[0]}'?" if matches else f"choose one of: {', '.join(choices)}"
    name = " ".join(words[:2] if within and len(words) > 1 else words[:1])
    print(f"{_USAGE}error: unknown command '{name}'; {hint}", file=sys.stderr)
    return 2


def run_command(name: str, argv: Sequence[str]) -> int:
    """Runs a subcommand in this process and returns its exit code.

    Raises:
        GeortError: the input is invalid; `main` prints the message and returns exit code 2.
        SystemExit: the arguments cannot be parsed, or request help.
    """
    options = parse(name, argv)
    from geort_drake.console import console

    console.quiet = options.quiet
    options.check()
    return options.run()


def parse(name: str, argv: Sequence[str]) -> "Command":
    """Reads the arguments of a subcommand; raises SystemExit if they are wrong or request help."""
    import tyro

    command = load_command(name)
    # Shells insert the home folder only where a word begins, not in --output=~/run.
    parts = [word.partition("=") for word in argv]
    words = [option + equals + os.path.expanduser(value) for option, equals, value in parts]
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone)
    return tyro.cli(
        command, prog=f"geort-drake {name}", args=words, config=config, description=description_of(name)
    )


def load_command(name: str) -> "type[Command]":
    """Imports a subcommand."""
    module, _, attribute = COMMANDS[name].partition(":")
    return getattr(importlib.import_module(f"{__name__}.{module}"), attribute)


def description_of(name: str) -> str:
    """Returns the help text of a subcommand, without its options."""
    command = load_command(name)
    paragraphs = (inspect.getdoc(command) or "").split("\n\n")
    if epilog := getattr(command, "epilog", None):
        paragraphs.append(epilog())
    return "\n\n".join(text if "\n  " in f"\n{text}" else textwrap.fill(text, 88) for text in paragraphs)


def summary_of(name: str) -> str:
    """Returns the first sentence of a subcommand's help, on one line however long it is."""
    return " ".join((inspect.getdoc(load_command(name)) or "").partition("\n\n")[0].split())


def help_of(name: str) -> str:
    """Returns the whole help of a subcommand."""
    import io

    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        parse(name, ["--help"])
    return text.getvalue()


def _overview(names: Sequence[str] = ()) -> str:
    lines = [_USAGE, "Retarget a human hand to a robot hand, and judge the result in a Drake simulation."]
    for purpose, group in GROUPS.items():
        group_names = {name for name in group if not names or name in names}
        if group_names:
            lines += ["", f"{purpose}:"]
            lines += [f"  {name:22} {summary_of(name)}" for name in group if name in group_names]
    return "\n".join(lines)
