"""Commands of README and docs: each one parses, and a chain of them from play to a benchmark runs."""

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from light_training import train_lightly
from pages import PAGES, ROOT, lines_of

from geort_drake import load_hand, load_scenario, run_trial, synthesize_play
from geort_drake.cli import COMMANDS, load_command, parser_of, run_command
from geort_drake.comparison import train as comparison_train
from geort_drake.console import console
from geort_drake.errors import OutputError
from geort_drake.files import locked
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner

SCRIPTS = ROOT / "scripts"
SCRIPT_COMMAND = re.compile(r'main\(\["([\w-]+)"')


def documented() -> Iterator[str]:
    """Command lines of all pages, in shell blocks and as inline code, as `COMMAND ARGUMENTS`."""
    for page in PAGES:
        for line in lines_of(page):
            program, _, rest = " ".join(line.split("  #")[0].split()).partition(" ")
            if program == "python" and (script := re.match(r"scripts/(\w+\.py) ?", rest)):
                called = SCRIPT_COMMAND.search((SCRIPTS / script[1]).read_text("utf-8"))
                program, rest = ("geort-drake", f"{called[1]} {rest[script.end() :]}") if called else ("", "")
            if program == "geort-drake" and rest[:1].islower() and "..." not in rest and "…" not in rest:
                yield rest.strip()


@pytest.mark.parametrize("line", sorted({*documented()}))
def test_a_documented_command_parses(line, tmp_path, monkeypatch):
    """The command exists, it has these options, and they take these values."""
    monkeypatch.chdir(tmp_path)
    name, *words = shlex.split(line.replace("[", "").replace("]", ""), comments=True)
    parser = parser_of(name)
    words = [{"N": "1", "K": "5"}.get(word, word) for word in words]
    required = [action for action in parser._actions if action.required]
    if words and words != ["--help"] and (len(words) > 2 or not required):
        parser.parse_args(words)
    else:  # inline code that names an option of the command
        known = {option for action in parser._actions for option in action.option_strings}
        assert {word.replace("_", "-") for word in words if word.startswith("--")} <= known


# -- running them

TINY = {"steps": 3}
SETTINGS = " ".join(f"--set {name}={value}" for name, value in TINY.items())
SHORT = "--scenario-text '{timeout: 0.3, monitor: {hold_time: 0.01}}'"
# Name → commands that follow each other, each with a key of the JSON that it prints, or None without --json.
CHAINS = {
    "recordings": {
        "synthesize play.npz --duration 60 --rate 30": None,
        "synthesize people --people 1 --duration 5": None,
        "convert hand.npy copy.npz": "verdict",
        "check-recording copy.npz": "verdict",
        "export copy.npz hand.rrd --format rrd": "episodes",
        "publish short.npz --to pub+ipc://glove": None,
    },
    "retargeters": {
        f"train --recording hand.npz --output map --robot-samples 1000 {SETTINGS}": "coverage",
        "pretrain --output everyone.safetensors --people 4 --set steps=2": None,
        "refit hand.npz refitted --map everyone.safetensors --steps 2": "coverage",
        "evaluate --recording hand.npz --methods nearest_neighbour --frames 10 --held-out 2": "methods",
        "explore --recording hand.npz --methods refitted hold --duration 0.5 --output e.rrd": None,
        "live --glove hand.npz --retargeter map --engage now --duration 0.5": "states",
    },
    "grasps": {
        f"grasp --objects cylinder --recording hand.npz --output run {SHORT}": "trials",
        f"grasp --objects cube --retargeter affine_ik --no-rerun --output untrained {SHORT}": "trials",
        "export run parquet": "episodes",
        "export run lerobot --format lerobot --fps 10": "episodes",
        "stand-in-robot --duration 0.2": None,
    },
    "benchmarks": {
        f"benchmark --methods hold --objects cylinder --trials 1 --jobs 1 --output five {SHORT}": "methods",
        "benchmark --report --output five": "methods",
        "benchmark --rrd hold cylinder 0 --output five": None,
        f"grasp --objects cube --retargeter tiny --no-rerun --output kept {SHORT}": "trials",
        f"replay kept/cube-0.glove.npz --retargeter tiny --trials 1 --jobs 1 --perturb mass=0.2 {SHORT}": (
            "errors"
        ),
    },
}


def tiny(hand, recording, path, method="geort_coupled", seed=0, device="cpu", settings=None, **_):
    """`train_checkpoint` that hardly trains."""
    return train_lightly(hand, recording, path, method, seed, **{**(settings or {}), **TINY})


@pytest.fixture(scope="module")
def desk(light_desk, play, light_benchmark):
    """A folder with recordings, where metrics and trainings are tiny and a plan is made once."""
    plans = GraspPlanner(load_scenario(), load_hand("allegro_right")).plans(2)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison_train, "train_checkpoint", tiny)
        patch.setattr(GraspPlanner, "plans", lambda _: plans)  # no trial lasts long enough to follow one
        patch.chdir(light_desk)
        np.save("hand.npy", play.p_HK.astype(float))
        play.save("hand.npz")
        synthesize_play(0, 0.3, 30.0).save("short.npz")
        tiny("allegro_right", play, light_desk / "tiny")
        yield
    console.quiet = False


@pytest.mark.slow
@pytest.mark.parametrize("chain", CHAINS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_commands_run(chain, desk, capsys):
    """Each ends with code 0, prints JSON alone on stdout if asked, and suggests commands that parse."""
    capsys.readouterr()
    for line, key in CHAINS[chain].items():
        name, *words = shlex.split(line)
        assert run_command(name, [*words, *(["--json"] if key else [])]) == 0
        captured = capsys.readouterr()
        assert key in json.loads(captured.out) if key else captured.out == ""
        for suggestion in re.findall(r"^next: (.*)$", captured.err, re.MULTILINE):
            check_suggestion(shlex.split(suggestion))


@pytest.mark.slow
def test_an_interrupted_grasp_keeps_whole_trials_and_their_scenario(desk, monkeypatch):
    """They can be exported; an interruption in the first trial leaves an earlier run as it was."""

    def one_trial(scenario, *arguments):
        with pytest.raises(OutputError, match="another process"), locked("stopped"):
            pass
        result = run_trial(scenario, *arguments)
        if scenario.random_seed > 0:
            raise KeyboardInterrupt
        return result

    monkeypatch.setattr("geort_drake.run_trial", one_trial, raising=False)
    kept = []
    for options in ("--trials 2", "--scenario-text '{random_seed: 1, timeout: 0.2}'"):
        line = f"--objects cylinder --retargeter hold --output stopped {SHORT} {options}"
        with pytest.raises(KeyboardInterrupt):
            run_command("grasp", shlex.split(line))
        kept.append({path.name: path.read_bytes() for path in Path("stopped").glob("*.*")})
    assert kept[0] == kept[1]
    assert Path("stopped/interrupted/cylinder-1.rrd").is_file()
    assert run_command("export", ["stopped", "stopped_table"]) == 0
    assert [path.name for path in Path("stopped_table/frames").iterdir()] == ["cylinder-0.parquet"]


def check_suggestion(words: list[str]) -> None:
    """A command that one can type here: its program, options and files exist."""
    if "rerun" in Path(words[0]).name:
        assert list(Path().glob(words[1]))
        return
    name, *rest = words[3 if words[1] == "-m" else 1 :]
    arguments = parser_of(name).parse_args(rest)
    given = [getattr(arguments, key, None) for key in ("recording", "retargeter", "input")]
    assert all(path.exists() for path in given if isinstance(path, Path) and name != "capture")


def test_every_command_is_run():
    """Those that are not run here have tests of their own."""
    ran = {line.split()[0] for chain in CHAINS.values() for line in chain}
    assert set(COMMANDS) - ran == {"add-hand", "capture", "screenshot"}


@pytest.mark.parametrize(
    ("edit", "options", "expected"),
    [
        ("", "", [("cylinder", 0), ("sphere", 0), ("cube", 0)]),
        ("object: { name: bottle }", "", [("bottle", 0)]),
        ("random_seed: 3", "--trials 2 --objects cube", [("cube", 3), ("cube", 4)]),
        ("object: { name: bottle }", "--objects cube", [("cube", 0)]),
        ("", "--scenario-text '{object: {name: rod}}'", [("rod", 0)]),
    ],
)
def test_one_line_gives_another_object_or_seed(edit, options, expected, tmp_path, monkeypatch):
    """In a copy of the shipped scenarios, or as text; --objects takes precedence."""
    monkeypatch.chdir(tmp_path)
    text = (diagrams_dir() / "grasp.scenarios.yaml").read_text("utf-8")
    line = {"o": "# object: { name: bottle }", "r": "random_seed: 0"}.get(edit[:1], "")
    assert line in text
    Path("edited.yaml").write_text(text.replace(line, edit, 1))
    arguments = parser_of("grasp").parse_args([*shlex.split(options), "--scenario-file", "edited.yaml"])
    base = load_scenario("edited.yaml", "Grasp", arguments.scenario_text)
    found = load_command("grasp").scenarios_of(arguments, base)
    assert [(scenario.object.name, scenario.random_seed) for scenario in found] == expected
