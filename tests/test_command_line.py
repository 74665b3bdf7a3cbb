"""The command geort-drake: finding commands, options, messages, exit codes, and what it refuses."""

import errno
import json
import logging
import os
import re
import shlex
import signal
import subprocess
import sys
import typing
import warnings
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from hand_family import HandSpec, write_hand
from light_training import train_lightly

from geort_drake import Hand, synthesize_play
from geort_drake.cli import COMMANDS, base, main, parse, run_command
from geort_drake.cli.base import write_json
from geort_drake.console import console, exit_code_of, progress_bar, run_main, track, warn
from geort_drake.errors import OutputError, RecordingError
from geort_drake.hands.description import write_description
from geort_drake.hands.importers.proposal import propose
from geort_drake.retargeting import train as retargeting_train
from geort_drake.simulation.plan.grasp import GraspPlanner

pytestmark = pytest.mark.usefixtures("light_benchmark")  # no command synthesizes five minutes of play
SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
HEAVY = {"rich", "torch", "pydrake", "rerun", "scipy", "matplotlib", "pyarrow", "joblib"}


def test_help_imports_no_heavy_package():
    """So it answers at once."""
    code = (
        "import contextlib, sys; from geort_drake.cli import COMMANDS, main\n"
        "for words in ([], *(name.split() for name in COMMANDS)):\n"
        "    with contextlib.suppress(SystemExit): main([*words, '--help'])\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("usage: geort-drake") == 1 + len(COMMANDS)
    assert HEAVY & {*done.stderr.split()} == set()


def test_the_overview_lists_every_command_in_a_line(capsys):
    """Without arguments, with --help, and as `geort-drake help`."""
    assert main([]) == main(["--help"]) == main(["help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in COMMANDS:
        told = [line for line in lines if line.startswith(f"  {name:22} ")]
        assert len(told) == 3 and all(line.endswith(".") for line in told)  # whole sentences
    assert all(len(line) < 120 for line in lines)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_for_a_command_is_the_same_in_both_orders(name, capsys):
    texts = []
    for words in (["help", *name.split()], [*name.split(), "--help"]):
        with pytest.raises(SystemExit) as stopped:
            main(words)
        assert stopped.value.code == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] and f"usage: geort-drake {name}" in texts[0]


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["gras"], "did you mean 'grasp'?"),
        (["benchmrak", "--quick"], "did you mean 'benchmark'?"),
        (["hand", "ad"], "did you mean 'hand add'?"),
        (["hand"], "choose one of: hand add, hand list"),
        (["check-recording", "hand.npy"], "did you mean 'recording check'?"),
    ],
)
def test_a_mistyped_command_gets_a_suggestion(words, hint, capsys):
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == "" and hint in said.err


def test_debug_adds_the_traceback_of_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["recording", "check", "missing.npy"]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["recording", "check", "missing.npy", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_an_error_of_the_operating_system_that_names_no_file_is_not_the_users(capsys):
    def fault():
        raise OSError(errno.EBADF, "Bad file descriptor")

    with pytest.raises(OSError, match="Bad file descriptor"):
        exit_code_of(fault)


def test_python_m_is_the_same_program(tmp_path):
    """It refuses with code 2 and one line on stderr."""
    words = [sys.executable, "-m", "geort_drake", "recording", "synthesize", "--output", "out.npy"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: out.npy: the name must end with .npz\n"
    assert list(tmp_path.iterdir()) == []


def test_facts_repeated_for_help_agree_with_their_modules():
    """Methods, sides and units, which help lists without importing them."""
    from geort_drake import retargeting
    from geort_drake.benchmark import log
    from geort_drake.cli.recording import ConvertRecording
    from geort_drake.cli.train import Train
    from geort_drake.export import episode, lerobot, parquet
    from geort_drake.people import recording
    from geort_drake.people.checks import UNITS_M

    def choices(command, field):
        return set(re.findall(r"'(\w+)'", str(typing.get_type_hints(command)[field])))

    assert Train.method == retargeting.DEFAULT_METHOD and "universal" in retargeting.METHODS
    assert set(typing.get_args(base.Side)) == set(recording.SIDES)
    assert choices(ConvertRecording, "unit") == set(UNITS_M)
    files = [episode.RESULTS, log.TRIALS, parquet.EPISODES, lerobot.INFO]
    assert list(base.RESULT_FILES) == files


def test_a_path_after_an_equals_sign_begins_at_home_too(tmp_path, monkeypatch):
    """Shells insert the home folder only where ~ begins a word."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["hand", "list", "--json=~/results.json"]) == 0
    assert (tmp_path / "results.json").is_file()
    assert not (tmp_path / "~").exists()


def test_a_quiet_run_prints_warnings_alone(monkeypatch, capsys):
    """Neither progress nor words; with --json one object on stdout. The next run prints everything again."""
    monkeypatch.setattr(console, "quiet", False)  # restores it after the test

    def words():
        with progress_bar() as progress:
            progress.add_task("training", total=1, note="")
        console.print("done")
        warn("few frames [0]")
        return capsys.readouterr().err

    monkeypatch.setattr(console, "quiet", False)  # as it is afterwards
    run_command("recording protocol", ["--quiet"])
    assert words() == "warning: few frames [0]\n"
    run_command("recording protocol", [])
    said = words()
    assert "training" in said and said.endswith("done\nwarning: few frames [0]\n")


def test_a_bar_appears_before_its_first_item_and_beside_a_long_note(capsys):
    with progress_bar() as display:
        assert [*track("planning", (len(display.task_ids) for _ in [0]), 1)] == [1]
        display.counter("training")(1860, 1860, "direction 0.036  " * 5)
    assert "1860/1860" in capsys.readouterr().err


def test_json_goes_to_stdout_or_into_a_file(tmp_path, capsys):
    """One object; nothing without the option; null for what is not finite; drafts only into files."""
    file = tmp_path / "new" / "figures.json"
    targets = [parse("hand list", words).json for words in ([], ["--json", "-"], ["--json", str(file)])]
    for target in targets:
        write_json(target, {"draft": 1}, done=False)
    assert capsys.readouterr().out == "" and json.loads(file.read_text()) == {"draft": 1}
    for target in targets:
        write_json(target, {"a": [1.5, float("nan")], "b": (float("inf"), "x", True)})
    finite = {"a": [1.5, None], "b": [None, "x", True]}
    assert json.loads(capsys.readouterr().out) == json.loads(file.read_text()) == finite
    assert parse("hand list", ["--json=~/figures.json"]).json == Path.home() / "figures.json"
    # A recording behind --json must not be overwritten.
    assert main(["hand", "list", "--json", "hand.npy"]) == 2
    assert "hand.npy: the name must end with .json" in capsys.readouterr().err


STOPPED_IMPORT = ImportError("initialization failed")  # what pybind11 makes of Ctrl-C during an import
STOPPED_IMPORT.__cause__ = KeyboardInterrupt()


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (None, 0, ""),
        (RecordingError("hand.npy: no frames [1]"), 2, "error: hand.npy: no frames [1]\n"),
        (PermissionError(13, "not allowed", "a.npz"), 2, "error: [Errno 13] not allowed: 'a.npz'\n"),
        (MemoryError("of 3 GB"), 2, "error: not enough memory: of 3 GB\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (STOPPED_IMPORT, 130, "interrupted\n"),
    ],
)
def test_errors_and_warnings_are_printed_as_their_text_alone(error, code, said, capsys, caplog):
    """Without the code they come from or markup; exit codes tell them apart. Of a kind, Drake warns once."""

    def main(_):
        warnings.simplefilter("always")
        warnings.warn("joint [0] has moved little", stacklevel=1)
        for n in (1, 2):
            logging.getLogger("drake").error(f"<literal-string>.urdf:{n}: warning: geom g{n}: {error}")
        if error:
            raise error

    shown = warnings.showwarning
    with pytest.raises(SystemExit) as stopped:
        run_main(main)
    assert stopped.value.code == code
    assert capsys.readouterr() == ("", f"warning: joint [0] has moved little\n{said}")
    assert warnings.showwarning is shown and caplog.messages == [f"warning: geom g1: {error}"]


def test_sigterm_interrupts_like_ctrl_c(monkeypatch, capsys):
    """So that the work's drafts are removed; schedulers and containers stop programs by it."""
    interrupt = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("geort_drake.cli.load_command", interrupt)
    assert main([]) == 130, "before a command has begun"
    before = signal.getsignal(signal.SIGTERM)
    code = exit_code_of(lambda: os.kill(os.getpid(), signal.SIGTERM))
    signal.signal(signal.SIGTERM, before)
    assert code == 130
    assert capsys.readouterr().err == "interrupted\ninterrupted\n"


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


@pytest.fixture(scope="module")
def inputs(light_desk, play):
    """Folder of recordings, maps and scenarios with one fault each, and of good ones."""
    folder = light_desk
    p_HK = play.p_HK.astype(float)
    lost = p_HK.copy()
    lost[100 : 100 + len(lost) // 5] = np.nan
    arrays = {"good": p_HK, "shape": p_HK[:, :20], "millimetres": 1000 * p_HK, "nan": lost}
    for name, array in (arrays | {"three": p_HK[:3]}).items():
        np.save(folder / f"{name}.npy", array)
    (folder / "table.csv").write_text("0,0,0\n")
    play.save(folder / "no_wrist.npz")
    train_lightly("allegro_right", play, folder / "map.safetensors")
    changes = {"(?s)<inertial>.*?</inertial>": ""}
    weightless = write_hand(folder, HandSpec(4, mimic=False), "weightless", changes)
    write_description(propose(weightless)[0], folder / "weightless.yaml")
    (folder / "run").mkdir()
    (folder / "run" / "results.json").write_text("{}")
    return folder


@pytest.fixture
def refused(tmp_path, inputs, monkeypatch, capsys):
    """Runs a command that must refuse its arguments, where @/ is the folder of inputs."""

    def too_early(*_arguments, **_keywords):
        raise AssertionError("planning or training began before the input was checked")

    monkeypatch.setattr("geort_drake.retargeting.geort.fit", too_early)
    monkeypatch.setattr(GraspPlanner, "plans", too_early)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    work = tmp_path / "work"
    work.mkdir()
    (work / "file").write_text("in the way")
    monkeypatch.chdir(work)

    def run(line: str, *parts: str) -> None:
        try:
            code = main(shlex.split(line.replace("@/", f"{inputs}/")))
        except SystemExit as stopped:
            code = stopped.code
        output = capsys.readouterr()
        assert (code, output.out) == (2, ""), output.err
        assert "Traceback" not in output.err
        assert output.err.count("error: ") == 1, output.err
        assert [path.name for path in work.rglob("*")] == ["file"], "something was written"
        assert (work / "file").read_text() == "in the way"
        assert not [part for part in parts if part not in " ".join(output.err.split())], output.err

    return run


REFUSED = yaml.safe_load(Path(__file__).with_name("refused_requests.yaml").read_text("utf-8"))
READERS = {
    "grasp": "grasp --output out --recording {}",
    "train": "train --output out.safetensors --recording {}",
    "convert": "recording convert {} --output out.npz",
    "synthesize": "recording synthesize --output out.npz --hand-of {}",
}
UNREADABLE = {
    "missing.npy": ["missing.npy: no such file"],
    "shape.npy": ["shape.npy", "shape (T, 21, 3)", "(1800, 20, 3)"],
    "millimetres.npy": ["millimetres.npy", "60 to 110 mm", "millimetres", "--unit mm"],
    "nan.npy": ["nan.npy", "360 of 1800 frames", "the first is 100", "one in ten"],
    "table.csv": ["table.csv", "manus_csv"],
}


@pytest.mark.parametrize("fault", UNREADABLE)
def test_an_unusable_recording_is_refused(refused, fault):
    """Every command that reads a recording names the file, what was expected and what was found."""
    for line in READERS.values():
        refused(line.format(f"@/{fault}"), *UNREADABLE[fault])


@pytest.mark.parametrize("line", REFUSED)
def test_an_impossible_request_is_refused(refused, line):
    """Names, numbers, inputs and outputs are checked before anything is trained, planned or simulated."""
    refused(line, *REFUSED[line])


@pytest.mark.parametrize("command", READERS)
def test_a_folder_without_write_permission_is_refused(refused, monkeypatch, command):
    """Nothing is computed for an output that cannot be stored, nor for a cache."""
    # Permissions themselves do not stop the superuser, who runs tests in many containers.
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    refused(READERS[command].format("@/good.npy"), "is not a directory that can be written to")
    with pytest.raises(OutputError, match="is not a directory that can be written to"):
        retargeting_train.cached_map(Hand("allegro_right"), synthesize_play(0, 1.0))


def test_live_says_before_it_trains_that_this_takes_minutes(tmp_path, inputs, monkeypatch, capsys):
    """A user who waits for a robot to move must know."""

    def train(*_arguments, **_keywords):
        raise InterruptedError(capsys.readouterr().err)

    monkeypatch.setattr(retargeting_train, "train_map", train)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("geort_drake.methods.shipped_maps", dict)  # a hand without one
    with pytest.raises(InterruptedError, match=r"no geort map.*takes minutes"):
        run_command("live", ["--glove", str(inputs / "no_wrist.npz")])
