"""From a recording to an evaluated checkpoint, on the Allegro hand."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from geort_drake.errors import CheckpointError, TrainingError, UnknownNameError
from geort_drake.evaluation.metrics import evaluate
from geort_drake.evaluation.pipeline import train_checkpoint
from geort_drake.gloves.play import synthesize_play
from geort_drake.gloves.readers import read_recording
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "train_retargeter.py"
QUICK = {
    "steps": 120, "points": 64, "targets": 128, "pinches": 32, "frames": 32, "hidden": 32,
    "classifier_steps": 100, "refreshes": 2, "refresh_steps": 20, "refresh_samples": 200,
}  # fmt: skip


@pytest.fixture(scope="module")
def hand():
    return HandModel(load_hand("allegro_right"))


@pytest.fixture(scope="module")
def play():
    return synthesize_play(seed=1, duration_s=40.0, rate_hz=60.0)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Robot samples of the tests stay out of the user's cache, and few are enough."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    monkeypatch.setattr("geort_drake.evaluation.metrics.ROBOT_SAMPLES", 20_000)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, play):
    """One quick training that several tests look at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.evaluation.metrics.ROBOT_SAMPLES", 20_000)
        output = tmp_path_factory.mktemp("runs") / "allegro"
        return train_checkpoint(
            "allegro_right", play, output, seed=2, show_progress=False, settings=QUICK, robot_samples=5000
        )


def test_torch_and_drake_put_the_fingertips_in_the_same_place(hand, rng):
    """The chains read off the plant and the plant itself agree to rounding."""
    q = rng.uniform(hand.lower, hand.upper, (100, len(hand.joint_names)))
    tips = hand.kinematics().fingertips(torch.tensor(q)).numpy()
    np.testing.assert_allclose(tips, hand.fingertips(q), atol=1e-12)


def test_a_trained_checkpoint_knows_where_it_comes_from(checkpoint, hand, play):
    """Hand, recording, seed, versions, timings and figures are on record."""
    content = load_checkpoint(checkpoint)
    assert content.config["method"] == "geort"
    assert content.config["human_keypoints"] == [4, 8, 12, 16]
    assert content.config["training"]["steps"] == QUICK["steps"]
    assert content.hand["model_sha256"] == hand.digest
    provenance = content.provenance
    assert provenance["recording"]["sha256"] == play.digest
    assert provenance["robot_data"] == {"count": 5000, "seed": 2, "model_sha256": hand.digest}
    assert {"drake", "torch", "numpy", "geort_drake"} <= set(provenance["versions"])
    assert provenance["timings"]["training_s"] > 0
    assert provenance["training"]["pinch_frames"] > 0
    rows = (checkpoint / "history.csv").read_text().splitlines()
    assert rows[0].startswith("step,total,direction,coverage,flatness,pinch,collision")
    assert len(rows) > 50


def test_the_stored_metrics_are_those_of_the_stored_weights(checkpoint, hand, play):
    """Loading the checkpoint and evaluating it again gives the same figures."""
    stored = json.loads((checkpoint / "metrics.json").read_text())
    assert stored["hand"] == "allegro_right"
    assert stored["recording_sha256"] == play.digest
    again = evaluate(load_retargeter(checkpoint, hand), hand, play, seed=2)
    for key, value in again.items():
        if key != "latency_us":
            assert stored[key] == value


def test_the_same_seed_gives_the_same_checkpoint(checkpoint, play, tmp_path):
    """Robot samples, training and evaluation repeat; another seed differs."""
    arguments = {"show_progress": False, "settings": QUICK, "robot_samples": 5000}
    again = train_checkpoint("allegro_right", play, tmp_path / "again", seed=2, **arguments)
    other = train_checkpoint("allegro_right", play, tmp_path / "other", seed=3, **arguments)
    digest, same, different = (load_checkpoint(p).config["sha256"] for p in (checkpoint, again, other))
    assert same["weights.safetensors"] == digest["weights.safetensors"]
    assert different["weights.safetensors"] != digest["weights.safetensors"]


def test_a_checkpoint_of_this_hand_is_refused_for_an_altered_one(checkpoint):
    """The digest covers the description, such as where the fingertip point is."""
    description = load_hand("allegro_right")
    description.fingers[0].tip_point = [0.0, 0.0, 0.05]
    with pytest.raises(CheckpointError, match="another hand, 'allegro_right': its model digest"):
        load_retargeter(checkpoint, HandModel(description))


def test_names_that_do_not_exist_are_refused_before_any_work(play, tmp_path):
    """Methods, kinematics and settings; nothing is left behind."""
    with pytest.raises(UnknownNameError, match="unknown retargeting method 'magic'; choose one of: geort"):
        train_checkpoint("allegro_right", play, tmp_path / "x", method="magic")
    with pytest.raises(UnknownNameError, match="exact, neural"):
        train_checkpoint("allegro_right", play, tmp_path / "x", fk="guess")
    with pytest.raises(UnknownNameError, match="allegro_right"):
        train_checkpoint("no_such_hand", play, tmp_path / "x")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(CheckpointError, match="exists and is not a checkpoint"):
        train_checkpoint("allegro_right", play, tmp_path)


def test_the_script_trains_and_prints_the_metrics(play, tmp_path, capsys):
    """--recording to a file, --set and --steps reach the training, --json prints what was stored."""
    spec = importlib.util.spec_from_file_location("train_retargeter", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    recording = tmp_path / "play.npz"
    play.save(recording)
    settings = [f"--set={name}={value}" for name, value in QUICK.items() if name != "steps"]
    output = tmp_path / "run"
    arguments = ["--recording", str(recording), "--output", str(output), "--steps", "10", "--json"]
    arguments += ["--robot_samples", "2000"]
    assert script.main([*arguments, *settings]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((output / "metrics.json").read_text())
    assert load_checkpoint(output).config["training"]["steps"] == 10
    with pytest.raises(TrainingError, match="--set wants NAME=VALUE, not 'speed=3'; names: points, targets"):
        script.main([*arguments, "--set", "speed=3"])
    with pytest.raises(TrainingError, match="--set points: wants int, not 'many'"):
        script.main([*arguments, "--set", "points=many"])


@pytest.mark.slow
def test_a_tenth_of_the_training_already_serves_the_real_recording(alex_npy, hand, tmp_path, monkeypatch):
    """Pinches close, the hand does not collide, and the C-space is used; the full run does better."""
    path = train_checkpoint(
        "allegro_right", alex_npy, tmp_path / "alex", show_progress=False, robot_samples=20_000,
        settings={"steps": 400, "refreshes": 5, "classifier_steps": 500},
    )  # fmt: skip
    metrics = json.loads((path / "metrics.json").read_text())
    assert metrics["motion_preservation"] > 0.75
    assert metrics["coverage"]["10mm"] > 0.4
    assert metrics["pinch"]["closed"] > 0.8
    assert metrics["pinch"]["frames"] == 1071
    assert metrics["self_collision"] < 0.05
    assert metrics["cross_talk"] == 0.0
    retarget = load_retargeter(path, hand)
    frames = read_recording(alex_npy).p_HK
    q = retarget(frames)
    assert (q >= hand.lower).all()
    assert (q <= hand.upper).all()
