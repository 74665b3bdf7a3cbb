"""The command `geort-drake`: finding commands, options, settings, messages, exit codes, imports."""

import dataclasses
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from geort_drake.cli import COMMANDS, main, parser_of, run_command
from geort_drake.cli.options import (
    DEFAULT_METHOD,
    SHIPPED_METHOD,
    SIDES,
    CommandParser,
    command,
    view,
    write_json,
)
from geort_drake.console import console, progress_bar, run_main, warn
from geort_drake.errors import GeortError, RecordingError
from geort_drake.settings import parse_settings

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
HEAVY = {"rich", "torch", "pydrake", "rerun", "scipy", "matplotlib", "pyarrow", "joblib"}


# -- commands


def test_help_imports_no_heavy_package():
    """So it answers at once; benchmarks/bench_startup.py has the times."""
    code = (
        "import contextlib, sys; from geort_drake.cli import COMMANDS, main\n"
        "for words in ([], *([name] for name in COMMANDS)):\n"
        "    with contextlib.suppress(SystemExit): main([*words, '--help'])\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("usage: geort-drake") == 1 + len(COMMANDS)
    assert HEAVY & {*done.stderr.split()} == set()


def test_the_overview_lists_every_command_in_a_line(capsys):
    """Without arguments as well; each file in cli/ that is a command is listed."""
    assert main([]) == main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in COMMANDS:
        assert sum(line.startswith(f"  {name} ") for line in lines) == 2
    assert all(len(line) < 110 for line in lines)
    files = {
        path.stem.replace("_", "-") for path in (SCRIPTS.parent / "geort_drake" / "cli").glob("[a-z]*.py")
    }
    assert files - {"options", "benchmark-tables", "live-session", "live-web"} == set(COMMANDS)


def test_python_m_and_scripts_are_the_same_program(tmp_path):
    """Both refuse with code 2 and one line on stderr."""
    for program in (["-m", "geort_drake", "synthesize"], [str(SCRIPTS / "synthesize_recording.py")]):
        words = [sys.executable, *program, "out.npy"]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr == "error: out.npy: the name must end with .npz\n"
        assert list(tmp_path.iterdir()) == []


def test_facts_repeated_for_help_agree_with_their_modules():
    """Methods and sides, which help lists without importing them."""
    from geort_drake.people import recording
    from geort_drake.people.checks.anatomy import UNITS_M
    from geort_drake.retargeting import methods
    from geort_drake.retargeting.methods.geort.config import FORWARD_KINEMATICS, PRESETS

    assert DEFAULT_METHOD == methods.DEFAULT_METHOD
    assert [SHIPPED_METHOD] == list(methods.shipped_methods())
    assert set(SIDES) == set(recording.SIDES)
    choices = {action.dest: action.choices for action in parser_of("train")._actions}
    assert (choices["preset"], choices["fk"]) == (list(PRESETS), list(FORWARD_KINEMATICS))
    (unit,) = (action for action in parser_of("convert")._actions if action.dest == "unit")
    assert unit.choices == list(UNITS_M)


# -- outputs


@pytest.fixture
def loud():
    """Restores the console after a test."""
    yield
    console.quiet = False


def test_a_quiet_run_prints_warnings_alone(loud, capsys):
    """Neither progress nor words; with --json one object on stdout. The next run prints everything again."""

    def words():
        with progress_bar() as progress:
            progress.add_task("training", total=1, note="")
        console.print("done")
        warn("few frames [0]")
        return capsys.readouterr().err

    run_command("capture", ["--quiet"])
    assert words() == "warning: few frames [0]\n"
    run_command("capture", [])
    said = words()
    assert "training" in said and said.endswith("done\nwarning: few frames [0]\n")


def test_json_goes_to_stdout_or_into_a_file(tmp_path, capsys):
    """One object; nothing without the option; null for what is not finite; drafts only into files."""
    parser = CommandParser(None, None)
    parser.add_json("the figures")
    parser.add_argument("recording", nargs="?")
    file = tmp_path / "new" / "figures.json"
    targets = [parser.parse_args(words).json for words in ([], ["--json"], ["--json", str(file)])]
    for target in targets:
        write_json(target, {"draft": 1}, done=False)
    assert capsys.readouterr().out == "" and json.loads(file.read_text()) == {"draft": 1}
    for target in targets:
        write_json(target, {"a": [1.5, float("nan")], "b": (float("inf"), "x", True)})
    finite = {"a": [1.5, None], "b": [None, "x", True]}
    assert json.loads(capsys.readouterr().out) == json.loads(file.read_text()) == finite
    # A recording behind --json must not be overwritten.
    with pytest.raises(SystemExit):
        parser.parse_args(["--json", "hand.npy"])
    assert "the name must end with .json; to print on stdout, give --json last" in capsys.readouterr().err


def test_a_printed_command_can_be_typed(tmp_path, monkeypatch):
    """It names this Python's programs: by name if the shell finds them, by path if not, and as modules."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("python", "rerun", "geort-drake"):
        (folder / name).touch(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    monkeypatch.setenv("PATH", str(folder))
    assert command("grasp", "--output", Path("a b")) == "geort-drake grasp --output 'a b'"
    assert view("a b", "/*.rrd") == "rerun 'a b'/*.rrd"
    monkeypatch.setenv("PATH", "/nowhere")
    assert command("grasp") == "bin/geort-drake grasp"
    (folder / "geort-drake").unlink()
    assert command("grasp") == "bin/python -m geort_drake grasp"


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (None, 0, ""),
        (RecordingError("hand.npy: no frames [1]"), 2, "error: hand.npy: no frames [1]\n"),
        (PermissionError("a.npz: not allowed"), 2, "error: a.npz: not allowed\n"),
        (MemoryError("of 3 GB"), 2, "error: not enough memory: of 3 GB\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_errors_and_warnings_are_printed_as_their_text_alone(error, code, said, capsys):
    """Nothing of the code they come from, and no markup is interpreted; exit codes tell them apart."""

    def main(_):
        warnings.simplefilter("always")
        warnings.warn("joint [0] has moved little", stacklevel=1)
        if error:
            raise error

    shown = warnings.showwarning
    with pytest.raises(SystemExit) as stopped:
        run_main(main)
    assert stopped.value.code == code
    assert capsys.readouterr() == ("", f"warning: joint [0] has moved little\n{said}")
    assert warnings.showwarning is shown


# -- the package


def test_every_public_name_imports_and_a_wrong_one_does_not():
    """The package's names come from their modules when first used, and its docstring explains each."""
    import geort_drake

    for name in geort_drake.__all__:
        assert getattr(geort_drake, name).__name__ == name
        assert re.search(rf"\b{name}\b", geort_drake.__doc__)
    assert set(geort_drake.__all__) <= set(dir(geort_drake))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        geort_drake.nothing  # noqa: B018
    assert (Path(geort_drake.__file__).parent / "py.typed").is_file()


def test_importing_the_package_loads_nothing_else():
    code = "import sys; before = {*sys.modules}; import geort_drake; print(*({*sys.modules} - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0].lstrip("_") for name in done.stdout.split()}
    assert loaded - {"geort_drake"} <= {name.lstrip("_") for name in sys.stdlib_module_names}


@dataclasses.dataclass
class Config:
    steps: int = 10
    rate: float = 0.5
    exact: bool = True
    mode: str = "slow"
    extent: tuple = (1, 2)


def test_values_get_the_type_of_the_default():
    """Numbers, truth values and texts, also those with an equals sign; the last of a name counts."""
    texts = ["steps=20", "rate=1e-3", "exact=False", "mode=a=b", "steps=30"]
    assert parse_settings(texts, Config, "x") == {"steps": 30, "rate": 1e-3, "exact": False, "mode": "a=b"}
    assert parse_settings([], Config(), "x") == {}
    for text, message in (
        ("exact=1", "true or false, not '1'"),
        ("extent=3", "of: exact, mode, rate, steps"),
    ):
        with pytest.raises(GeortError, match=message):
            parse_settings([text], Config, "the toy")
