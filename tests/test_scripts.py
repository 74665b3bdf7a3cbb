"""Bad input to the scripts: one clear message, exit code 2, no traceback, and nothing written."""

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from script_modules import SCRIPTS, load_script

from geort_drake.cli.console import run_main
from geort_drake.comparison import train as comparison_train
from geort_drake.comparison.train import train_checkpoint
from geort_drake.files import sha256_of
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.checkpoint import load_checkpoint
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
    """Runs a script that must refuse its arguments, and returns what it said.

    In the arguments @r/, @c/ and @s/ stand for the folders of recordings, checkpoints and scenarios.
    """

    def too_early(*_arguments, **_keywords):
        raise AssertionError("planning or training began before the input was checked")

    monkeypatch.setitem(comparison_train.METHODS, "geort", too_early)
    monkeypatch.setattr(GraspPlanner, "plan", too_early)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    work = tmp_path / "work"
    work.mkdir()
    (work / "file").write_text("in the way")
    monkeypatch.chdir(work)
    folders = {"@r": recordings, "@c": checkpoints, "@s": scenarios}

    def run(script: str, arguments: str) -> str:
        for short, folder in folders.items():
            arguments = arguments.replace(f"{short}/", f"{folder}/")
        monkeypatch.setattr(sys, "argv", [script, *shlex.split(arguments)])
        with pytest.raises(SystemExit) as stopped:
            run_main(load_script(script).main)
        said = capsys.readouterr()
        assert stopped.value.code == 2, said.err
        assert said.out == ""
        assert "Traceback" not in said.err
        assert said.err.count("error: ") == 1, said.err
        assert [path.name for path in work.rglob("*")] == ["file"], "something was written"
        assert (work / "file").read_text() == "in the way"
        return " ".join(said.err.split())

    return run


READERS = {
    "simulate_grasp.py": "--recording {} --output out",
    "train_retargeter.py": "--recording {} --output out",
    "import_recording.py": "{} out.npz",
    "synthesize_recording.py": "out.npz --hand_of {}",
}
UNREADABLE = {
    "missing.npy": ["missing.npy: no such file"],
    "wrong_shape.npy": ["wrong_shape.npy", "shape (T, 21, 3)", "(1800, 20, 3)"],
    "millimetres.npy": ["millimetres.npy", "60 to 110 mm", "millimetres", "--unit mm"],
    "mirrored.npy": ["mirrored.npy", "bend backwards", "left hand", "side 'left'"],
    "nan.npy": ["nan.npy", "360 of 1800 frames", "first is frame 100", "one in ten"],
    "pickled.npy": ["pickled.npy", "never read"],
    "garbage.npz": ["garbage.npz", "not a readable NumPy file"],
    "table.csv": ["table.csv", "fits no format known", "manus_csv"],
}


@pytest.mark.parametrize("fault", UNREADABLE)
@pytest.mark.parametrize("script", READERS)
def test_an_unusable_recording_is_refused(refused, script, fault):
    """Every script that reads a recording names the file, what was wanted and what was found."""
    said = refused(script, READERS[script].format(f"@r/{fault}"))
    for part in UNREADABLE[fault]:
        assert part in said


@pytest.mark.parametrize("script", ["simulate_grasp.py", "train_retargeter.py"])
def test_a_recording_unfit_for_training_is_refused_before_training(refused, script):
    """Too few frames and no pinch are found at once."""
    said = refused(script, READERS[script].format("@r/short.npy"))
    assert "short.npy: 100 valid frames, training needs at least 300" in said
    said = refused(script, READERS[script].format("@r/no_pinch.npy"))
    assert "no_pinch.npy: no pinch" in said
    assert "within 15 mm" in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--retargeter @c/altered", ["weights.safetensors", "altered", "sha256"]),
        ("--retargeter @c/incomplete", ["weights.safetensors missing", "a checkpoint holds"]),
        ("--retargeter @c/other_joints", ["another hand", "axis_12", "wanted is joint_12"]),
        ("--retargeter @c/other_model", ["another hand", "model digest is 00"]),
        ("--retargeter @c/not_json", ["config.json: not valid JSON"]),
        ("--retargeter @c/other_method", ["unknown retargeting method 'magic'", "geort"]),
        ("--retargeter nowhere", ["nowhere", "no such checkpoint"]),
        ("--retargeter file", ["file", "no such checkpoint"]),
        ("--objects teapot", ["unknown object 'teapot'", "cylinder", "sphere"]),
        ("--objects cylinder teapot", ["unknown object 'teapot'"]),
        ("--method magic", ["unknown retargeting method 'magic'", "geort"]),
        ("--method magic --retargeter @c/good", ["unknown retargeting method 'magic'", "geort"]),
        ("--scenario_text '{hand: claw}'", ["unknown hand 'claw'", "allegro_right"]),
        ("--hand claw", ["unknown hand 'claw'", "allegro_right", "leap_right"]),
        ("--hand allegro_left --recording @r/no_wrist.npz", ["no_wrist.npz", "right hand", "left one"]),
        ("--scenario_name Lift", ["unknown scenario", "'Lift'", "Grasp"]),
        ("--scenario_file nowhere.yaml", ["nowhere.yaml does not exist"]),
        ("--scenario_file @s/malformed.yaml", ["malformed.yaml", "no mapping of names"]),
        ("--scenario_file @s/empty.yaml", ["empty.yaml", "no mapping of names"]),
        ("--scenario_file @s/list.yaml", ["list.yaml", "no mapping of names"]),
        ("--scenario_file @s/unknown_field.yaml", ["unknown_field.yaml", "colour"]),
        ("--scenario_file @s/wrong_type.yaml", ["wrong_type.yaml", "soon"]),
        ("--scenario_text '{timeout: -3}'", ["timeout must be positive", "-3"]),
        ("--scenario_text '{timeout: .nan}'", ["timeout must be positive", "nan"]),
        ("--scenario_text '{object: {colour: red}}'", ["colour"]),
        (
            "--scenario_text '{operator: {visual_delay: 0.003}}'",
            ["visual_delay", "multiple of operator.period"],
        ),
        ("--scenario_text '{directives: []}' --retargeter @c/good", ["directives", "'arm'"]),
        ("--scenario_text '{arm_posture: {elbow: 1}}' --retargeter @c/good", ["elbow", "panda_joint4"]),
        ("--replay @r/no_wrist.npz", ["no_wrist.npz", "wrist poses"]),
        ("--replay @r/missing.npz", ["missing.npz: no such file"]),
        ("--output file", ["file", "directory"]),
        ("--output file/runs", ["file", "directory"]),
        ("--output file --retargeter @c/good", ["file", "directory"]),
        ("--trials 0", ["--trials", "at least 1", "0"]),
        ("--trials many", ["--trials", "a whole number, not 'many'"]),
        ("--seed -1", ["--seed", "-1"]),
        ("--side both", ["--side", "left", "right"]),
    ],
)
def test_simulate_grasp_refuses_impossible_requests(refused, arguments, parts):
    """Checkpoints, scenarios, names and outputs are checked before training or simulating."""
    said = refused("simulate_grasp.py", arguments)
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--output out --hand claw", ["unknown hand 'claw'", "allegro_right"]),
        ("--output out --hand claw.yaml", ["claw.yaml is missing"]),
        ("--output out --method magic", ["unknown retargeting method 'magic'", "geort"]),
        ("--output out --fk guess", ["--fk", "exact", "neural"]),
        ("--output out --set speed", ["NAME=VALUE", "'speed'"]),
        ("--output out --set speed=3", ["unknown setting of geort_coupled 'speed'", "points"]),
        ("--output out --method geort --set jitter=0.1", ["unknown setting of geort 'jitter'", "points"]),
        ("--output out --method geort --set speed=3", ["of geort 'speed'", "points"]),
        ("--output out --set points=many", ["points", "int", "'many'"]),
        ("--output out --set points=0", ["points must be positive"]),
        ("--output out --set resampling=often", ["unknown resampling 'often'", "frames, independent"]),
        ("--output out --preset private", ["--preset", "public"]),
        ("--output out --preset public", ["preset of geort, not of geort_coupled"]),
        ("--output out --steps 0", ["steps", "0"]),
        ("--output out --robot_samples 0", ["robot_samples", "0"]),
        ("--output out --seed -1", ["--seed", "-1"]),
        ("--output file", ["file is not a directory"]),
        ("--output .", ["exists and is not a checkpoint"]),
        ("--output file/out", ["file", "directory"]),
        ("", ["--output"]),
    ],
)
def test_train_retargeter_refuses_impossible_requests(refused, arguments, parts):
    """Names, numbers and the output are checked before training."""
    said = refused("train_retargeter.py", arguments)
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--recording @r/good.npy --hand claw", ["unknown hand 'claw'", "allegro_right"]),
        ("--recording @r/good.npy --methods hold magic", ["'magic'", "geort", "vector_online"]),
        ("--recording @r/good.npy --methods @c/altered", ["weights.safetensors", "altered", "sha256"]),
        ("--recording @r/good.npy --methods @c/other_joints", ["another hand", "axis_12"]),
        ("--recording @r/good.npy --methods hold geort hold", ["--methods", "hold more than once"]),
        ("--recording @r/missing.npy", ["missing.npy: no such file"]),
        ("--recording @r/short.npy", ["short.npy: 100 valid frames, training needs at least 300"]),
        ("--recording @r/good.npy --score_on @r/nan.npy", ["nan.npy", "360 of 1800 frames"]),
        ("--recording @r/good.npy --score_on @r/good.npy", ["good.npy", "give another one"]),
        ("--recording @r/good.npy --held_out 1", ["held-out blocks must be 2 to 180", "not 1"]),
        ("--recording @r/good.npy --held_out 181", ["held-out blocks must be 2 to 180", "not 181"]),
        ("--recording @r/good.npy --seeds 0 -1", ["--seeds", "-1"]),
        ("--recording @r/good.npy --seeds 3 3", ["--seeds", "3 more than once"]),
        ("--recording @r/good.npy --frames 9", ["--frames", "at least 10", "9"]),
        ("--recording @r/good.npy --json file/t.json", ["file", "directory"]),
        ("--recording @r/good.npy --plots file", ["file", "directory"]),
        ("", ["--recording"]),
    ],
)
def test_evaluate_retargeting_refuses_impossible_requests(refused, arguments, parts):
    """Methods, recordings, protocols and outputs are checked before anything is trained or scored."""
    said = refused("evaluate_retargeting.py", arguments)
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("out.npy", ["out.npy", ".npz"]),
        ("file/out.npz", ["file", "directory"]),
        ("out.npz --duration 0", ["--duration", "positive", "0"]),
        ("out.npz --rate nan", ["--rate", "positive", "nan"]),
        ("out.npz --seed -1", ["--seed", "-1"]),
        ("out.npz --duration 5 --plot plot.doc", ["plot.doc", ".png"]),
        ("out.npz --duration 5 --plot out.png --compare @r/missing.npy", ["missing.npy: no such file"]),
        ("out.npz --duration 5 --plot file/out.png", ["file", "directory"]),
    ],
)
def test_synthesize_recording_refuses_impossible_requests(refused, arguments, parts):
    """A bad plot or comparison is found before the recording is written."""
    said = refused("synthesize_recording.py", arguments)
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("@r/good.npy out.npy", ["out.npy", ".npz"]),
        ("@r/good.npy file/out.npz", ["file", "directory"]),
        ("@r/good.npy out.npz --side left", ["good.npy", "bend backwards"]),
        ("@r/no_wrist.npz out.npz --side left", ["no_wrist.npz", "right hand", "left one"]),
    ],
)
def test_import_recording_refuses_impossible_requests(refused, arguments, parts):
    """The output's name and the side must fit."""
    said = refused("import_recording.py", arguments)
    for part in parts:
        assert part in said


@pytest.mark.parametrize("script", READERS)
def test_a_folder_without_write_permission_is_refused(refused, monkeypatch, script):
    """Nothing is computed for an output that cannot be stored."""
    # Permissions themselves do not stop the superuser, who runs tests in many containers.
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    assert "is not a directory that can be written to" in refused(
        script, READERS[script].format("@r/good.npy")
    )


@pytest.mark.parametrize(
    ("script", "arguments"),
    [
        ("simulate_grasp.py", ["--objects", "teapot", "--output", "out"]),
        ("train_retargeter.py", ["--recording", "missing.npy", "--output", "out"]),
    ],
)
def test_a_refusal_reaches_the_shell(script, arguments, tmp_path):
    """Run as a program, a script ends with code 2 and the message alone on stderr."""
    command = [sys.executable, str(SCRIPTS / script), *arguments]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_grasps_are_labelled_with_what_their_checkpoint_is(checkpoints):
    """Not with the method that would have been trained."""
    said = load_script("simulate_grasp.py").describe(load_checkpoint(checkpoints / "good"))
    assert said["method"] == "geort"
    assert said["hand"] == "allegro_right"
    assert said["retargeting_call_us"] > 0


def test_every_script_answers_help(capsys):
    """--help prints the usage and exits with 0, for every script there is."""
    for path in sorted(SCRIPTS.glob("*.py")):
        with pytest.raises(SystemExit) as stopped:
            load_script(path.name).main(["--help"])
        assert stopped.value.code == 0
        assert capsys.readouterr().out.startswith("usage:")
