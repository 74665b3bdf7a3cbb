"""Requests that a command cannot meet: one clear message, exit code 2, no traceback, and nothing written."""

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from geort_drake.cli import main, run_command
from geort_drake.cli.grasp import describe
from geort_drake.comparison import train as comparison_train
from geort_drake.comparison.train import train_checkpoint
from geort_drake.files import sha256_of
from geort_drake.people.play import synthesize_play
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner

QUICK = {
    "steps": 5, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8,
    "classifier_steps": 5, "refreshes": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def play():
    """A minute of synthetic play at 30 Hz."""
    return synthesize_play(0, duration_s=60.0, rate_hz=30.0)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory, play):
    """Folder of recordings with one fault each, and one without."""
    folder = tmp_path_factory.mktemp("recordings")
    p_HK = play.p_HK.astype(float)
    tips = p_HK[:, [8, 12, 16, 20]]
    distance = np.linalg.norm(tips - p_HK[:, 4:5], axis=-1).min(axis=1)
    lost = p_HK.copy()
    lost[100 : 100 + len(lost) // 5] = np.nan
    np.save(folder / "good.npy", p_HK)
    np.save(folder / "wrong_shape.npy", p_HK[:, :20])
    np.save(folder / "millimetres.npy", 1000 * p_HK)
    np.save(folder / "mirrored.npy", p_HK * [1, -1, 1])
    np.save(folder / "nan.npy", lost)
    np.save(folder / "short.npy", p_HK[:100])
    np.save(folder / "no_pinch.npy", p_HK[distance > 0.02])
    np.save(folder / "pickled.npy", np.array([{"t": 0}], dtype=object), allow_pickle=True)
    (folder / "garbage.npz").write_text("this is no archive")
    (folder / "table.csv").write_text("0,0,0\n")
    play.save(folder / "no_wrist.npz")
    return folder


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory, play):
    """Folder of checkpoints with one fault each, and one without."""
    folder = tmp_path_factory.mktemp("checkpoints")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
        good = train_checkpoint(
            "allegro_right",
            play,
            folder / "good",
            "geort",
            show_progress=False,
            settings=QUICK,
            robot_samples=2000,
        )
    faults = ("altered", "incomplete", "other_joints", "other_model", "not_json", "other_method")
    copies = {name: Path(shutil.copytree(good, folder / name)) for name in faults}
    weights = bytearray((good / "weights.safetensors").read_bytes())
    weights[-1] ^= 1
    (copies["altered"] / "weights.safetensors").write_bytes(weights)
    (copies["incomplete"] / "weights.safetensors").unlink()
    (copies["not_json"] / "config.json").write_text("{")
    config = json.loads((good / "config.json").read_text())
    (copies["other_method"] / "config.json").write_text(json.dumps(config | {"method": "magic"}))
    hand = json.loads((good / "hand.json").read_text())
    joints = [name.replace("joint_", "axis_") for name in hand["joint_names"]]
    for name, change in {
        "other_joints": {"joint_names": joints},
        "other_model": {"model_sha256": "00"},
    }.items():
        # Forged with care: digests and names agree, only the hand is another one.
        (copies[name] / "hand.json").write_text(json.dumps(hand | change))
        forged = json.loads((copies[name] / "config.json").read_text())
        forged["sha256"]["hand.json"] = sha256_of(copies[name] / "hand.json")
        forged["joint_names"] = (hand | change)["joint_names"]
        (copies[name] / "config.json").write_text(json.dumps(forged))
    return folder


@pytest.fixture(scope="module")
def scenarios(tmp_path_factory):
    """Folder of scenario files with one fault each."""
    folder = tmp_path_factory.mktemp("scenarios")
    for name, text in {
        "malformed": "Grasp: {hand: [",
        "empty": "",
        "list": "- Grasp\n- Lift\n",
        "unknown_field": "Grasp: {colour: red}",
        "wrong_type": "Grasp: {timeout: soon}",
    }.items():
        (folder / f"{name}.yaml").write_text(text)
    return folder


@pytest.fixture
def refused(tmp_path, recordings, checkpoints, scenarios, monkeypatch, capsys):
    """Runs a command that must refuse its arguments, and returns what it printed.

    In the arguments @r/, @c/ and @s/ stand for the folders of recordings, checkpoints and scenarios.
    """

    def too_early(*_arguments, **_keywords):
        raise AssertionError("planning or training began before the input was checked")

    monkeypatch.setattr(comparison_train, "TrainingData", too_early)
    monkeypatch.setattr(GraspPlanner, "plan", too_early)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    work = tmp_path / "work"
    work.mkdir()
    (work / "file").write_text("in the way")
    monkeypatch.chdir(work)
    folders = {"@r": recordings, "@c": checkpoints, "@s": scenarios}

    def run(line: str, *parts: str) -> None:
        for short, folder in folders.items():
            line = line.replace(f"{short}/", f"{folder}/")
        try:
            code = main(shlex.split(line))
        except SystemExit as stopped:
            code = stopped.code
        said = capsys.readouterr()
        assert (code, said.out) == (2, ""), said.err
        assert "Traceback" not in said.err
        assert said.err.count("error: ") == 1, said.err
        assert [path.name for path in work.rglob("*")] == ["file"], "something was written"
        assert (work / "file").read_text() == "in the way"
        for part in parts:
            assert part in " ".join(said.err.split())

    return run


READERS = {
    "grasp": "grasp --output out --recording {}",
    "train": "train --output out --recording {}",
    "convert": "convert {} out.npz",
    "synthesize": "synthesize out.npz --hand-of {}",
}
UNREADABLE = {
    "missing.npy": ["missing.npy: no such file"],
    "wrong_shape.npy": ["wrong_shape.npy", "shape (T, 21, 3)", "(1800, 20, 3)"],
    "millimetres.npy": ["millimetres.npy", "60 to 110 mm", "millimetres", "--unit mm"],
    "mirrored.npy": ["mirrored.npy", "bend backwards", "left hand", "side 'left'"],
    "nan.npy": ["nan.npy", "360 of 1800 frames", "first is frame 100", "one in ten"],
    "pickled.npy": ["pickled.npy", "never read"],
    "garbage.npz": ["garbage.npz", "not a readable NumPy file"],
    "table.csv": ["table.csv", "matches no known format", "manus_csv"],
}


@pytest.mark.parametrize("fault", UNREADABLE)
def test_an_unusable_recording_is_refused(refused, fault):
    """Every command that reads a recording names the file, what was expected and what was found."""
    for line in READERS.values():
        refused(line.format(f"@r/{fault}"), *UNREADABLE[fault])


@pytest.mark.parametrize("command", ["grasp", "train"])
def test_a_recording_unfit_for_training_is_refused_before_training(refused, command):
    """Too few frames and no pinch are found at once."""
    line = READERS[command]
    refused(line.format("@r/short.npy"), "short.npy: 100 valid frames, training needs at least 300")
    refused(line.format("@r/no_pinch.npy"), "no_pinch.npy: the thumb never comes within 15 mm")


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--retargeter @c/altered", ["weights.safetensors", "altered", "sha256"]),
        ("--retargeter @c/incomplete", ["weights.safetensors missing", "a checkpoint holds"]),
        ("--retargeter @c/other_joints", ["another hand", "axis_12", "expected is joint_12"]),
        ("--retargeter @c/other_model", ["another hand", "model digest is 00"]),
        ("--retargeter @c/not_json", ["config.json: not valid JSON"]),
        ("--retargeter @c/other_method", ["unknown retargeting method 'magic'", "geort"]),
        ("--retargeter nowhere", ["nowhere", "no such checkpoint"]),
        ("--objects cylinder teapot", ["unknown object 'teapot'", "cylinder", "sphere"]),
        ("--method magic --retargeter @c/good", ["unknown retargeting method 'magic'", "geort"]),
        ("--hand claw", ["unknown hand 'claw'", "allegro_right", "leap_right"]),
        ("--hand allegro_left --recording @r/no_wrist.npz", ["no_wrist.npz", "right hand", "left one"]),
        ("--scenario-name Lift", ["unknown scenario", "'Lift'", "Grasp"]),
        ("--scenario-file nowhere.yaml", ["nowhere.yaml does not exist"]),
        ("--scenario-file @s/malformed.yaml", ["malformed.yaml", "must map names"]),
        ("--scenario-file @s/unknown_field.yaml", ["unknown_field.yaml", "colour"]),
        ("--scenario-file @s/wrong_type.yaml", ["wrong_type.yaml", "soon"]),
        ("--scenario-text '{timeout: .nan}'", ["timeout must be positive", "nan"]),
        ("--scenario-text '{directives: []}' --retargeter @c/good", ["directives", "'arm'"]),
        ("--scenario-text '{arm_posture: {elbow: 1}}' --retargeter @c/good", ["elbow", "panda_joint4"]),
        ("--replay @r/no_wrist.npz", ["no_wrist.npz", "wrist poses"]),
        ("--output file/runs --retargeter @c/good", ["file", "directory"]),
        ("--trials 0", ["--trials", "at least 1", "0"]),
        ("--side both", ["--side", "left", "right"]),
    ],
)
def test_grasp_refuses_impossible_requests(refused, arguments, parts):
    """Checkpoints, scenarios, names and outputs are checked before training or simulating."""
    refused(f"grasp {arguments}", *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--output out --hand claw.yaml", ["claw.yaml is missing"]),
        ("--output out --method magic", ["unknown retargeting method 'magic'", "geort"]),
        ("--output out --set speed", ["NAME=VALUE", "'speed'"]),
        ("--output out --method geort --set jitter=0.1", ["unknown setting of geort 'jitter'", "points"]),
        ("--output out --set hidden=many", ["hidden", "int", "'many'"]),
        ("--output out --set hidden=0", ["hidden must be positive"]),
        ("--output out --preset public", ["preset of geort, not of geort_coupled"]),
        ("--output out --steps 0", ["steps", "0"]),
        ("--output out --robot-samples 0", ["robot-samples", "0"]),
        ("--output .", ["exists and is not a checkpoint"]),
        ("", ["--output"]),
    ],
)
def test_train_refuses_impossible_requests(refused, arguments, parts):
    """Names, numbers and the output are checked before training."""
    refused(f"train {arguments}", *parts)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--methods hold magic", ["'magic'", "geort", "vector_online"]),
        ("--methods @c/altered", ["weights.safetensors", "altered", "sha256"]),
        ("--methods hold geort hold", ["--methods", "hold more than once"]),
        ("--score-on @r/nan.npy", ["nan.npy", "360 of 1800 frames"]),
        ("--score-on @r/good.npy", ["good.npy", "give another one"]),
        ("--held-out 1", ["held-out blocks must be 2 to 180", "not 1"]),
        ("--seeds 3 3", ["--seeds", "3 more than once"]),
        ("--frames 9", ["--frames", "at least 10", "9"]),
        ("--json file/t.json", ["file", "directory"]),
        ("--plots file", ["file", "directory"]),
    ],
)
def test_evaluate_refuses_impossible_requests(refused, arguments, parts):
    """Methods, recordings, protocols and outputs are checked before anything is trained or scored."""
    refused(f"evaluate --recording @r/good.npy {arguments}", *parts)


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("synthesize out.npy", ["out.npy", ".npz"]),
        ("synthesize out.npz --duration inf", ["--duration", "finite"]),
        ("synthesize out.npz --duration 1e6", ["--duration times --rate may be at most 5,000,000 frames"]),
        ("convert @r/good.npy file/out.npz", ["file", "directory"]),
        ("convert @r/good.npy out.npz --side left", ["good.npy", "bend backwards"]),
        ("check-recording @r/no_wrist.npz --side left", ["no_wrist.npz", "right hand", "left one"]),
        ("explore --output e.rrd --duration 1000", ["--duration must be from 0.1 to 600, not 1000"]),
        ("benchmark --rrd hold cylinder", ["--rrd: give METHOD OBJECT SEED [CONDITION]"]),
        ("benchmark --objects teapot", ["unknown object 'teapot'"]),
        ("export @r/no_wrist.npz out --fps 3", ["--fps: Parquet keeps every sample"]),
        ("export @r/no_wrist.npz out.mp4 --format rrd", ["out.mp4: the name must end with .rrd"]),
        ("live --glove nowhere.npz", ["nowhere.npz: no such file"]),
        ("live --glove lcm --robot lcm --meshcat", ["--meshcat shows the simulation"]),
        ("add-hand nowhere.urdf", ["nowhere.urdf"]),
        ("add-hand nowhere.urdf --output hand.txt", ["the name must end with .yaml"]),
        ("screenshot nowhere.rrd out.png", ["nowhere.rrd"]),
    ],
)
def test_other_commands_refuse_impossible_requests(refused, line, parts):
    refused(line, *parts)


@pytest.mark.parametrize("command", READERS)
def test_a_folder_without_write_permission_is_refused(refused, monkeypatch, command):
    """Nothing is computed for an output that cannot be stored."""
    # Permissions themselves do not stop the superuser, who runs tests in many containers.
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    refused(READERS[command].format("@r/good.npy"), "is not a directory that can be written to")


def test_grasps_are_labelled_with_what_their_checkpoint_is(checkpoints):
    """Not with the method that would have been trained."""
    properties = describe(checkpoints / "good")
    assert (properties["method"], properties["hand"]) == ("geort", "allegro_right")
    assert properties["retargeting_call_us"] > 0


def test_live_says_before_it_trains_that_this_takes_minutes(tmp_path, recordings, monkeypatch, capsys):
    """With the way around it; a checkpoint in the cache is used without a word."""

    def train(*_arguments, **_keywords):
        raise InterruptedError(capsys.readouterr().err)

    monkeypatch.setattr("geort_drake.comparison.train.train_checkpoint", train)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(InterruptedError) as stopped:
        run_command("live", ["--glove", str(recordings / "no_wrist.npz")])
    said = " ".join(str(stopped.value).split())
    assert "has no geort_coupled retargeter for allegro_right" in said
    assert "takes about two minutes; nothing moves until then" in said
    assert "give --retargeter and a checkpoint's directory" in said
