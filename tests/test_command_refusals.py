"""Requests that a command cannot meet: one clear message, exit code 2, no traceback, and nothing written.

Tests of the subpackages cover what else is wrong with recordings, checkpoints and scenarios.
"""

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from light_training import train_lightly

from geort_drake.cli import main, run_command
from geort_drake.comparison import train as comparison_train
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner


@pytest.fixture(scope="module")
def inputs(light_desk, play):
    """Folder of recordings, checkpoints and scenarios with one fault each, and of good ones."""
    folder = light_desk
    p_HK = play.p_HK.astype(float)
    lost = p_HK.copy()
    lost[100 : 100 + len(lost) // 5] = np.nan
    np.save(folder / "good.npy", p_HK)
    np.save(folder / "shape.npy", p_HK[:, :20])
    np.save(folder / "millimetres.npy", 1000 * p_HK)
    np.save(folder / "nan.npy", lost)
    np.save(folder / "short.npy", p_HK[:100])
    (folder / "table.csv").write_text("0,0,0\n")
    play.save(folder / "no_wrist.npz")
    good = train_lightly("allegro_right", play, folder / "map")
    weights = Path(shutil.copytree(good, folder / "altered")) / "weights.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"x")
    return folder


@pytest.fixture
def refused(tmp_path, inputs, monkeypatch, capsys):
    """Runs a command that must refuse its arguments, where @/ is the folder of inputs."""

    def too_early(*_arguments, **_keywords):
        raise AssertionError("planning or training began before the input was checked")

    monkeypatch.setattr(comparison_train, "TrainingData", too_early)
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
        for part in parts:
            assert part in " ".join(output.err.split())

    return run


READERS = {
    "grasp": "grasp --output out --recording {}",
    "train": "train --output out --recording {}",
    "convert": "convert {} out.npz",
    "synthesize": "synthesize out.npz --hand-of {}",
}
UNREADABLE = {
    "missing.npy": ["missing.npy: no such file"],
    "shape.npy": ["shape.npy", "shape (T, 21, 3)", "(1800, 20, 3)"],
    "millimetres.npy": ["millimetres.npy", "60 to 110 mm", "millimetres", "--unit mm"],
    "nan.npy": ["nan.npy", "360 of 1800 frames", "first is frame 100", "one in ten"],
    "table.csv": ["table.csv", "manus_csv"],
}


@pytest.mark.parametrize("fault", UNREADABLE)
def test_an_unusable_recording_is_refused(refused, fault):
    """Every command that reads a recording names the file, what was expected and what was found."""
    for line in READERS.values():
        refused(line.format(f"@/{fault}"), *UNREADABLE[fault])


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("grasp --recording @/short.npy", ["short.npy: 100 valid frames, training needs at least 300"]),
        ("grasp --retargeter @/altered", ["weights.safetensors", "altered", "sha256"]),
        ("grasp --objects cylinder teapot", ["unknown object 'teapot'", "cylinder", "sphere"]),
        ("grasp --retargeter magic", ["unknown retargeting method or checkpoint 'magic'", "geort"]),
        ("grasp --hand claw", ["unknown hand 'claw'", "allegro_right", "leap_right"]),
        ("grasp --hand allegro_left --recording @/no_wrist.npz", ["no_wrist.npz", "right hand", "left one"]),
        ("grasp --scenario-name Lift", ["unknown scenario", "'Lift'", "Grasp"]),
        ("grasp --scenario-file nowhere.yaml", ["nowhere.yaml does not exist"]),
        ("grasp --replay @/no_wrist.npz", ["no_wrist.npz", "needs wrist poses", "--scenario-name Fixed"]),
        ("grasp --scenario-name Fixed", ["scenario 'Fixed': the operator cannot grasp with a fixed base"]),
        ("grasp --output file/runs", ["file", "directory"]),
        ("grasp --trials 0", ["--trials", "at least 1", "0"]),
        ("grasp --side both", ["--side", "left", "right"]),
        ("train --output out --hand claw.yaml", ["claw.yaml is missing"]),
        ("train --output out --set speed", ["NAME=VALUE", "'speed'"]),
        ("train --output out --method geort --set jitter=0.1", ["setting of geort 'jitter'", "points"]),
        ("train --output out --set steps=many", ["steps", "int", "'many'"]),
        ("train --output out --set collision=0", ["collision must be positive"]),
        ("train --output out --method geort --set learning_rate=-1", ["learning_rate must be positive"]),
        ("train --output out --preset public", ["preset of geort, not of geort_coupled"]),
        ("train --output .", ["exists and is not a checkpoint"]),
        ("evaluate --recording @/good.npy --methods hold magic", ["'magic'", "geort", "vector_online"]),
        ("evaluate --recording @/good.npy --score-on @/good.npy", ["good.npy", "give another one"]),
        ("evaluate --recording @/good.npy --held-out 181", ["held-out blocks must be 2 to 180", "not 181"]),
        ("evaluate --recording @/good.npy --held-out 1", ["held-out blocks must be 2 to 180", "not 1"]),
        ("synthesize out.npz --duration inf", ["--duration", "finite"]),
        ("synthesize out.npz --duration 1e6", ["--duration times --rate may be at most 5,000,000 frames"]),
        ("convert @/good.npy file/out.npz", ["file", "directory"]),
        ("check-recording @/no_wrist.npz --side left", ["no_wrist.npz", "right hand", "left one"]),
        ("explore --output e.rrd --duration 1000", ["--duration must be from 0.1 to 600, not 1000"]),
        ("explore --output e.rrd --methods magic", ["'magic'", "geort"]),
        ("benchmark --rrd hold cylinder", ["--rrd: give METHOD OBJECT SEED [CONDITION]"]),
        ("benchmark --methods ../../../etc", ["unknown retargeting method or checkpoint '../../../etc'"]),
        ("export @/no_wrist.npz out --fps 3", ["--fps: Parquet keeps every sample"]),
        ("export @/no_wrist.npz out.mp4 --format rrd", ["out.mp4: the name must end with .rrd"]),
        ("live --glove nowhere.npz", ["nowhere.npz: no such file"]),
        ("live --glove lcm --robot lcm --meshcat", ["--meshcat shows the simulation"]),
        ("live --glove lcm --robot real", ["address 'real': give one of"]),
        ("live --glove lcm --robot lcm+udpm://10.0.0.1:7667?ttl=0", ["GROUP from 224"]),
        ("live --glove lcm --robot lcm --hand leap_right", ["has no LCM messages"]),
        ("add-hand nowhere.urdf", ["nowhere.urdf"]),
        ("add-hand nowhere.urdf --output hand.txt", ["the name must end with .yaml"]),
        ("screenshot nowhere.rrd out.png", ["nowhere.rrd"]),
    ],
)
def test_an_impossible_request_is_refused(refused, line, parts):
    """Names, numbers, inputs and outputs are checked before anything is trained, planned or simulated."""
    refused(line, *parts)


@pytest.mark.parametrize("command", READERS)
def test_a_folder_without_write_permission_is_refused(refused, monkeypatch, command):
    """Nothing is computed for an output that cannot be stored."""
    # Permissions themselves do not stop the superuser, who runs tests in many containers.
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    refused(READERS[command].format("@/good.npy"), "is not a directory that can be written to")


def test_live_says_before_it_trains_that_this_takes_minutes(tmp_path, inputs, monkeypatch, capsys):
    """A user who waits for a robot to move must know."""

    def train(*_arguments, **_keywords):
        raise InterruptedError(capsys.readouterr().err)

    monkeypatch.setattr(comparison_train, "train_checkpoint", train)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("geort_drake.cli.live_session.shipped_maps", dict)  # a hand without one
    with pytest.raises(InterruptedError, match=r"no geort_coupled retargeter.*takes about two minutes"):
        run_command("live", ["--glove", str(inputs / "no_wrist.npz")])
