"""What the scripts' command lines share."""

import argparse
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from script_modules import SCRIPTS, load_script

from geort_drake.cli import options as command_line
from geort_drake.cli.console import console, progress_bar, warn
from geort_drake.cli.options import (
    METHOD_SUMMARIES,
    TRAINED_METHODS,
    add_json_option,
    add_scenario_options,
    at_least,
    check_outputs,
    command,
    make_parser,
    method_help,
    positive,
    scenario_of,
    write_json,
)
from geort_drake.errors import OutputError


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "many", "", "nan"])
def test_a_count_that_is_none_is_refused(text):
    """Too low, or no whole number."""
    with pytest.raises(argparse.ArgumentTypeError, match=rf"must be .*, not '?{text}'?$"):
        at_least(1)(text)
    assert (at_least(1)("1"), at_least(0)("0")) == (1, 0)


@pytest.mark.parametrize("text", ["0", "-0.5", "inf", "nan", "long", ""])
def test_a_measure_that_is_none_is_refused(text):
    """Not positive, not finite, or no number."""
    with pytest.raises(argparse.ArgumentTypeError, match=rf"must be .*, not '?{text}'?$"):
        positive(text)
    assert positive("1e-3") == 0.001


def test_the_options_of_a_scenario_choose_and_change_it():
    """Without any, it is the package's; the hand and the text given take the place of the file's."""
    parser = make_parser("What it does.\n\n  as it is laid out")
    add_scenario_options(parser, "{timeout: 7}")
    assert "\n  as it is laid out\n" in parser.format_help()
    usual = scenario_of(parser.parse_args([]))
    changed = scenario_of(parser.parse_args(["--hand", "allegro_left", "--scenario_text", "{timeout: 7}"]))
    assert (usual.hand, changed.hand) == ("allegro_right", "allegro_left")
    assert usual.timeout != changed.timeout == 7


def test_outputs_are_checked_before_the_work(tmp_path, capsys):
    """An option that is not given is none; of the others name and place must do."""
    parser = make_parser(None)
    check_outputs(parser, (None, ".rrd"), (tmp_path / "new" / "a.npz", ".npz"))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(SystemExit):
        check_outputs(parser, (tmp_path / "a.npy", ".npz"))
    assert "the name must end with .npz" in capsys.readouterr().err
    with pytest.raises(OutputError, match="not a directory"):
        check_outputs(parser, (Path("/dev/null/a.npz"), ".npz"))


# -- what scripts say, and to whom


@pytest.fixture
def loud():
    """The console as it was, whatever a test makes of it."""
    yield
    console.quiet = False


def test_a_quiet_run_says_warnings_alone(loud, capsys):
    """Neither progress nor words; the next run, which is not quiet, says everything again."""
    parser = make_parser(None)

    def run(*argv):
        parser.parse_args(argv)
        with progress_bar() as progress:
            progress.add_task("training", total=1, note="")
        console.print("done")
        warn("few frames [0]")
        return capsys.readouterr()

    assert run("--quiet") == ("", "warning: few frames [0]\n")
    said = run()
    assert said.out == ""
    assert "training" in said.err and said.err.endswith("done\nwarning: few frames [0]\n")


def test_json_goes_to_stdout_or_into_a_file(tmp_path, capsys):
    """One object; nothing without the option; what is not finite is null; a draft is for files alone."""
    parser = make_parser(None)
    add_json_option(parser, "the figures")
    parser.add_argument("recording", nargs="?")

    def target(*argv):
        return parser.parse_args(argv).json

    file = tmp_path / "new" / "figures.json"
    for given in (target(), target("--json"), target("--json", str(file))):
        write_json(given, {"draft": 1}, done=False)
    assert capsys.readouterr().out == "" and json.loads(file.read_text()) == {"draft": 1}
    figures = {"a": [1.5, float("nan")], "b": (float("inf"), "x", True)}
    for given in (target(), target("--json"), target("--json", str(file))):
        write_json(given, figures)
    assert json.loads(capsys.readouterr().out) == {"a": [1.5, None], "b": [None, "x", True]}
    assert json.loads(file.read_text()) == {"a": [1.5, None], "b": [None, "x", True]}


def test_json_does_not_take_another_argument_for_its_file(tmp_path, capsys):
    """A recording that stands behind it is not overwritten; a place that cannot be written to is refused."""
    parser = make_parser(None)
    add_json_option(parser, "the figures")
    parser.add_argument("recording", nargs="?")
    with pytest.raises(SystemExit):
        parser.parse_args(["--json", "hand.npy"])
    assert "hand.npy: the name must end with .json; to print on stdout, give --json last" in (
        capsys.readouterr().err
    )
    with pytest.raises(OutputError, match="not a directory"):
        parser.parse_args(["--json", "/dev/null/figures.json"])


def test_every_default_is_told_in_one_form(tmp_path, monkeypatch):
    """Behind the help of each option that has one, unless its help says it already."""
    monkeypatch.chdir(tmp_path)
    parser = make_parser(None)
    add = parser.add_argument
    add("--seed", type=int, default=0, help="of it")
    add("--methods", nargs="+", default=["a", "b"], help="to try")
    add("--output", type=Path, default=tmp_path / "out", help="folder")
    add("--rate", type=float, default=20.0, help="Hz")
    add("--side", help="of the hand (default: the robot's)")
    add("--set", action="append", default=[], help="more")
    add("--flag", action="store_true", help="or not")
    add("file", nargs="?", default="x", help="to read")
    told = " ".join(parser.format_help().split())
    for text in (
        "of it (default: 0)",
        "to try (default: a b)",
        "folder (default: out)",
        "Hz (default: 20)",
        "of the hand (default: the robot's)",
    ):
        assert text in told
    assert told.count("(default: ") == 5


def test_every_option_of_every_script_is_explained(monkeypatch):
    """And none tells its default in another form, such as "(0)" at the end."""

    class Parsed(Exception):
        pass

    def stop(parser, *_):
        raise Parsed(parser)

    monkeypatch.setattr(command_line._Parser, "parse_args", stop)
    for path in sorted(SCRIPTS.glob("*.py")):
        with pytest.raises(Parsed) as stopped:
            load_script(path.name).main([])
        for action in stopped.value.args[0]._actions:
            told = f"{path.name}: {action.dest}: {action.help}"
            assert action.help, told
            assert re.search(r"\((\d[\d.]*|[a-z_' ]+)\)$", action.help) is None, told
            assert action.help.count("(default: ") <= 1, told


def test_every_method_is_explained():
    """In one line each, and which of them are trained is told apart."""
    from geort_drake.comparison.comparison import method_names
    from geort_drake.comparison.train import DEFAULT_METHOD, METHODS

    assert set(METHOD_SUMMARIES) == set(method_names())
    assert set(TRAINED_METHODS) == set(METHODS)
    assert TRAINED_METHODS[0] == DEFAULT_METHOD
    assert method_help().count("\n") == 1 + len(METHOD_SUMMARIES)
    assert all(len(line) < 100 for line in method_help().splitlines())


def test_a_command_can_be_typed_as_it_is_told(tmp_path, monkeypatch):
    """Here and elsewhere it names this Python's programs, by name where the shell finds them."""
    beside = Path(sys.executable).parent
    monkeypatch.setenv("PATH", str(beside))
    monkeypatch.chdir(SCRIPTS.parent)
    assert command("simulate_grasp.py", "--output", Path("a b")) == (
        "python scripts/simulate_grasp.py --output 'a b'"
    )
    assert command("rerun", "a.rrd") == "rerun a.rrd"
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.chdir(tmp_path)
    python, script, *rest = shlex.split(command("add_hand.py", "hand.yaml"))
    assert Path(python).samefile(sys.executable)
    assert Path(script).samefile(SCRIPTS / "add_hand.py")
    assert rest == ["hand.yaml"]
