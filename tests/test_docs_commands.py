"""Every command that README and docs show is run, with arguments that make it small.

What a command's last words are, and that it writes what it says, is looked at too. Commands that other tests
run with the same options are named below with these tests.
"""

import functools
import importlib.util
import json
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from glove_files import manus_table, write_manus_csv
from hand_family import HandSpec, write_hand
from light_metrics import lighten
from moving_hands import moving
from script_modules import SCRIPTS, load_script
from test_docs import PAGES, ROOT, fences

from geort_drake.comparison import checkpoint_cache, sweep
from geort_drake.comparison.train import train_checkpoint
from geort_drake.console import console
from geort_drake.hands.description import hand_names
from geort_drake.people.play import synthesize_play
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner

pytestmark = pytest.mark.slow

TINY = {
    "steps": 3, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8, "classifier_steps": 5,
    "refreshes": 0, "kinematics_steps": 5,
}  # fmt: skip
SETTINGS = " ".join(f"--set {name}={value}" for name, value in TINY.items() if name != "steps")
SHORT = "--scenario_text '{timeout: 0.3, monitor: {hold_time: 0.01}}'"
GRASPS = f"--methods hold --objects cylinder --trials 1 --jobs 1 {SHORT}"

# For each script what makes its commands small; argparse takes the last of an option that is given twice.
# What follows "if" is for commands with those words alone, in place of the line before.
SMALL = {
    "add_hand.py": "",
    "add_hand.py if my_hand.urdf": "--overwrite --output models/hands/my_hand.yaml",
    "benchmark_grasping.py": GRASPS,
    "benchmark_grasping.py if --rrd": "--rrd hold cylinder 0",
    "benchmark_grasping.py if --report": "",
    "evaluate_replay.py": f"--trials 1 --jobs 1 --perturb position=5 {SHORT}",
    "evaluate_retargeting.py": "--frames 10 --seeds 0",
    "evaluate_retargeting.py if --held_out": "--frames 10 --held_out 2",
    "evaluate_retargeting.py if --sweep": "--sweep coverage_weight=0 --seeds 0 --jobs 1",
    "explore_retargeting.py": "--duration 0.5",
    "export_run.py": "",
    "import_recording.py": "",
    "publish_recording.py": "--to pub+ipc://glove",
    "refit_retargeter.py": "--steps 2",
    "simulate_grasp.py": f"--trials 1 {SHORT}",
    "stand_in_robot.py": "--duration 0.2",
    "synthesize_recording.py": "--duration 5",
    "teleoperate.py": "--duration 0.5 --retargeter runs/allegro_right",
    "train_retargeter.py": f"--steps 3 --robot_samples 1000 {SETTINGS}",
}
# Words that are replaced, in commands that hold the first of them.
REPLACED = {
    "--unit": {"hand.csv": "hand_mm.csv"},
    "--loop": {"--loop": "", "hand.npz": "short.npz"},
    "[--seed": {"[--seed": "--seed", "N]": "1"},
}
# Part of a command → the test that runs it, as it needs other processes, a viewer, or what is made there.
ELSEWHERE = {
    "--backend ray": "test_grasp_benchmark.py",
    "--sensitivity": "test_sensitivity.py",
    "--watch": "test_capture.py",
    "draw_diagram.py": "test_draw_diagram.py",
    "make_pictures.py": "test_rerun_pictures.py",
    "screenshot.py": "test_rerun_pictures.py",
    "show_capture_protocol.py": "test_capture.py",
    "--robot lcm": "test_live_loop.py",
}


def shown(folder: str) -> dict[str, str]:
    """Every command that runs a program of a folder → the first page that shows it."""
    found: dict[str, str] = {}
    for page in PAGES:
        lines = [line for body in fences(page, "sh", "bash") for line in body.splitlines()]
        lines += re.findall(r"`((?:\w+=\w+ )?python [^`]+)`", page.read_text("utf-8"))
        for line in lines:
            words = line.split("  #")[0].split()
            if f"{folder}/" in line and "..." not in words:
                found.setdefault(" ".join(words), page.name)
    return found


def elsewhere(line: str) -> str | None:
    return next((test for part, test in ELSEWHERE.items() if part in line), None)


COMMANDS = [
    pytest.param(line, id=f"{page}: {line}")
    for line, page in shown("scripts").items()
    if elsewhere(line) is None
]


# -- where the commands are run


class Desk:
    """A folder in which the files are made that a command names."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.plans: dict[str, object] = {}

    def make(self, words: list[str]) -> None:
        """Makes those of the files that some words name and that are not there yet."""
        if "--output" in words and not {"--report", "--rrd"} & {*words}:
            words = words[: words.index("--output")] + words[words.index("--output") + 2 :]
        for name, maker in self.makers().items():
            if any(word.startswith(name) for word in words) and not (self.folder / name).exists():
                maker(self.folder / name)

    def makers(self) -> dict[str, Callable[[Path], object]]:
        def npy(seed: int) -> Callable[[Path], None]:
            return lambda path: np.save(path, play(seed).p_HK.astype(float))

        def npz(seed: int, seconds: float = 60.0) -> Callable[[Path], None]:
            return lambda path: play(seed, seconds).save(path)

        return {
            "hand.npy": npy(0),
            "human_alex.npy": npy(1),
            "hand.npz": npz(0),
            "short.npz": npz(0, 0.3),
            "left.npz": lambda path: play(0).mirrored().save(path),
            "other_hand.npz": npz(2),
            "manus.npz": npz(3),
            "play.npz": npz(4),
            "hand.csv": lambda path: write_manus_csv(self.folder, moving(), name="hand"),
            "hand_mm.csv": lambda path: write_manus_csv(self.folder, moving(), millimetres(), name="hand_mm"),
            "my_hand.urdf": lambda path: shutil.copy(
                write_hand(self.folder, HandSpec(4, "urdf", names="plain")), path
            ),
            "models/hands/my_hand.yaml": lambda path: self.run("python scripts/add_hand.py my_hand.urdf"),
            "my.yaml": self.edited_scenario,
            "runs/allegro_right": lambda path: train("allegro_right", play(0), path),
            "runs/allegro_right_other": lambda path: train("allegro_right", play(2), path),
            "runs/allegro_left": lambda path: train("allegro_left", play(0).mirrored(), path),
            "runs/leap_right": lambda path: train("leap_right", play(0), path),
            "runs/grasp": lambda path: self.run(
                "python scripts/simulate_grasp.py --objects cylinder --retargeter runs/allegro_right"
            ),
            "own.npz": self.session,
            **dict.fromkeys(
                ("runs/full", "runs/five", "runs/quick"),
                lambda path: self.run(f"python scripts/benchmark_grasping.py --output {path}"),
            ),
        }

    def edited_scenario(self, path: Path) -> None:
        """The shipped scenarios with one line edited."""
        text = (diagrams_dir() / "grasp.scenarios.yaml").read_text("utf-8")
        path.write_text(text.replace("# object: { name: bottle }", "object: { name: bottle }", 1))

    def session(self, path: Path) -> None:
        self.make(["runs/grasp"])
        shutil.copy(self.folder / "runs" / "grasp" / "cylinder-0.glove.npz", path)

    def run(self, line: str) -> int:
        """Runs a command of the docs in this folder, made small; its exit code."""
        words = smaller(line)
        self.make(words)
        there = [sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in words]
        script, *arguments = [word for some in there for word in some]
        return load_script(script).main(arguments) or 0


@functools.cache
def play(seed: int, seconds: float = 60.0):
    return synthesize_play(seed, seconds, 30.0)


def millimetres() -> list[list]:
    header, *rows = manus_table(moving())
    return [header, *([*row[:3], *(1e3 * x for x in row[3:])] for row in rows)]


def train(hand: str, recording, path, method="geort_coupled", seed=0, device="cpu", settings=None, **_):
    """`train_checkpoint`, which learns nothing to speak of."""
    settings = {**(settings or {}), **TINY}
    return train_checkpoint(
        hand,
        recording,
        path,
        method,
        seed,
        device,
        show_progress=False,
        settings=settings,
        robot_samples=1000,
    )


def smaller(line: str) -> list[str]:
    """The script and the arguments of a command, with those that make it small."""
    for part, words in REPLACED.items():
        if part in line:
            line = " ".join(words.get(word, word) for word in line.split())
    script, *arguments = shlex.split(line.replace("python ", "").replace("scripts/", ""), comments=True)
    special = (key.partition(" if ") for key in SMALL)
    keys = [f"{name} if {part}" for name, _, part in special if name == script and part and part in line]
    return [script, *arguments, *shlex.split(SMALL[keys[0] if keys else script])]


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Iterator[Desk]:
    desk = Desk(tmp_path_factory.mktemp("desk"))
    plan = GraspPlanner.plan

    def plan_once(planner: GraspPlanner):
        """The same plan for every object: no trial lasts long enough to follow it."""
        hand = planner._scenario.hand
        if hand not in desk.plans:
            desk.plans[hand] = plan(planner)
        return desk.plans[hand]

    with pytest.MonkeyPatch.context() as patch:
        lighten(patch)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "docs_cache"))
        patch.setattr(comparison_train, "train_checkpoint", train)
        patch.setattr(sweep, "train_checkpoint", train)
        patch.setattr(GraspPlanner, "plan", plan_once)
        patch.chdir(desk.folder)
        yield desk


# -- the commands


@pytest.mark.parametrize("line", COMMANDS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_command_runs(line, desk, capsys):
    """It ends well and says nothing on stdout. What it tells to type in the end, one can type."""
    assert desk.run(line) == 0
    said = capsys.readouterr()
    assert said.out == ""
    for told in re.findall(r": (\S*python \S+\.py .*|\S*rerun .*)$", said.err, re.MULTILINE):
        program, *words = shlex.split(told)
        if program.endswith("python"):
            assert Path(words[0]).samefile(SCRIPTS / Path(words[0]).name)
            words = words[2:]
        if "--output" in words:  # which is still to come
            words = words[: words.index("--output")]
        for word in words:
            known = word.startswith("-") or word in hand_names()
            assert known or list(Path().glob(word.removeprefix(f"{desk.folder}/")))


def test_commands_that_are_run_elsewhere_are():
    """The tests that are named for them load these scripts."""
    for line in shown("scripts"):
        test = elsewhere(line)
        if test is not None:
            (script,) = re.findall(r"scripts/(\w+)", line)
            assert script in (ROOT / "tests" / test).read_text("utf-8"), f"{test} does not run {line}"


# Of each script that gives results to programs one command, and a key of what it gives.
RESULTS = {
    "python scripts/add_hand.py my_hand.urdf": "description",
    "python scripts/benchmark_grasping.py --report --output runs/five": "methods",
    "python scripts/evaluate_replay.py own.npz --retargeter runs/allegro_right --output replayed": "errors",
    "python scripts/evaluate_retargeting.py --recording hand.npy --methods nearest_neighbour": "methods",
    "python scripts/export_run.py hand.npz exported": "episodes",
    "python scripts/import_recording.py hand.npy": "verdict",
    "python scripts/refit_retargeter.py runs/allegro_right other_hand.npz refitted": "coverage",
    "python scripts/simulate_grasp.py --objects cylinder --retargeter runs/allegro_right": "trials",
    "python scripts/teleoperate.py --glove hand.npz --engage now": "states",
    "python scripts/train_retargeter.py --recording hand.npy --output trained": "coverage",
}


@pytest.mark.parametrize("line", RESULTS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_quiet_command_gives_json_alone(line, desk, capsys):
    """One object on stdout; on stderr nothing but warnings."""
    desk.make(smaller(line))
    capsys.readouterr()
    try:
        assert desk.run(f"{line} --quiet --json") == 0
    finally:
        console.quiet = False
    said = capsys.readouterr()
    assert RESULTS[line] in json.loads(said.out)
    assert [told for told in said.err.splitlines() if not told.startswith("warning: ")] == []


def test_every_script_with_results_gives_them_to_programs(capsys):
    """Those that have --json are in the table above."""
    with_json = set()
    for path in SCRIPTS.glob("*.py"):
        with pytest.raises(SystemExit):
            load_script(path.name).main(["--help"])
        help = capsys.readouterr().out
        assert "--quiet" in help
        with_json |= {path.name} if "--json" in help else set()
    assert with_json == {line.split("/")[1].split()[0] for line in RESULTS}


# -- another scenario by one line


def grasped(folder: Path) -> tuple[list[tuple[str, int]], dict]:
    """Object and seed of every trial of a run, and the scenario that it left."""
    results = json.loads((folder / "results.json").read_text("utf-8"))
    scenario = yaml.safe_load((folder / "scenario.yaml").read_text("utf-8"))["Resolved"]
    return [(trial["object"], trial["seed"]) for trial in results["trials"]], scenario


@pytest.mark.parametrize(
    ("edited", "options", "trials"),
    [
        ({}, "", [("cylinder", 0), ("sphere", 0), ("cube", 0)]),
        ({"# object: { name: bottle }": "object: { name: bottle }"}, "", [("bottle", 0)]),
        ({"random_seed: 0": "random_seed: 3"}, "", [("cylinder", 3), ("sphere", 3), ("cube", 3)]),
        ({"# object: { name: bottle }": "object: { name: bottle }"}, "--objects cube", [("cube", 0)]),
        ({}, "--scenario_text '{timeout: 0.1, object: {name: rod}}'", [("rod", 0)]),
    ],
)
def test_one_line_gives_another_object_or_seed(edited, options, trials, desk, capsys):
    """In the file, as it ships or as a copy, or as text; --objects takes precedence."""
    text = (diagrams_dir() / "grasp.scenarios.yaml").read_text("utf-8")
    for line, other in edited.items():
        assert line in text
        text = text.replace(line, other, 1)
    Path("edited.yaml").write_text(text)
    words = smaller(f"python scripts/simulate_grasp.py --retargeter runs/allegro_right {options}")
    if "--scenario_text" in options:
        words = words[: words.index("--trials")]
    desk.make(words)
    more = ["--no_rerun", "--scenario_file", "edited.yaml", "--output", "edited"]
    assert load_script(words[0]).main([*words[1:], *more]) == 0
    found, scenario = grasped(Path("edited"))
    assert found == trials
    assert (scenario["object"]["name"], scenario["random_seed"]) == trials[0]


# -- the benchmarks, which take their time


@pytest.mark.parametrize("line", shown("benchmarks"))
def test_a_benchmarks_command_has_options_that_exist(line, monkeypatch, capsys):
    """The program is there and its --help lists every option that a page uses."""
    words = shlex.split(line, comments=True)
    (path,) = (ROOT / word for word in words if word.startswith("benchmarks/"))
    monkeypatch.syspath_prepend(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(SystemExit) as stopped:
        module.main(["--help"])
    assert stopped.value.code == 0
    known = set(re.findall(r"--\w+", capsys.readouterr().out))
    assert {word for word in words if word.startswith("--")} <= known
