"""The evaluation of several methods, and its script."""

import functools
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from geort_drake.errors import UnknownNameError
from geort_drake.evaluation import comparison, metrics
from geort_drake.evaluation.metrics import evaluate_frames
from geort_drake.evaluation.pipeline import train_checkpoint
from geort_drake.gloves.play import synthesize_play
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.baselines.online import VectorOnline

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
QUICK = {
    "steps": 5, "points": 16, "targets": 32, "pinches": 8, "frames": 8, "hidden": 8,
    "classifier_steps": 5, "refreshes": 0,
}  # fmt: skip


def script(name: str):
    """The script as a module."""
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def play():
    """A minute of synthetic play at 30 Hz."""
    return synthesize_play(0, duration_s=60.0, rate_hz=30.0)


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Few samples and short training, so that what is tested is the plumbing."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(metrics, "ROBOT_SAMPLES", 2_000)
    for name in ("motion_preservation", "cross_talk", "flatness_and_gain"):
        monkeypatch.setattr(metrics, name, functools.partial(getattr(metrics, name), anchors=30))
    monkeypatch.setattr(metrics, "context_averaged", functools.partial(metrics.context_averaged, contexts=2))
    monkeypatch.setattr(metrics, "latency", functools.partial(metrics.latency, calls=50))

    def train(hand, recording, method, seed):
        path = tmp_path / method
        train_checkpoint(
            hand, recording, path, method, seed, show_progress=False, settings=QUICK, robot_samples=2000
        )
        return path, False

    return train


def test_the_script_writes_a_row_for_every_method(play, quick, monkeypatch, tmp_path, capsys):
    """Trained, online and trivial methods and a checkpoint's directory; JSON and plots are whole."""
    monkeypatch.setattr("geort_drake.evaluation.checkpoint_cache.cached_checkpoint", quick)
    play.save(tmp_path / "hand.npz")
    path, _ = quick("allegro_right", play, "geort", 0)
    methods = ["linear_offline", "hold", "nearest_neighbour", "vector_online", str(path)]
    arguments = [
        "--recording", str(tmp_path / "hand.npz"), "--methods", *methods,
        "--frames", "40", "--json", str(tmp_path / "table.json"), "--plots", str(tmp_path / "plots"),
    ]  # fmt: skip
    assert script("evaluate_retargeting").main(arguments) == 0
    report = json.loads((tmp_path / "table.json").read_text("utf-8"))
    assert list(report["methods"]) == methods
    assert report["frames"] == 40 and report["recording_sha256"] == play.digest
    assert report["hand"] == "allegro_right" and report["seed"] == 0 and "drake" in report["versions"]
    assert [row["remembers"] for row in report["methods"].values()] == [False, False, False, True, False]
    hold, vector = report["methods"]["hold"], report["methods"]["vector_online"]
    assert hold["motion_preservation"] == 0.0 and hold["smoothness"]["max"] == 0.0
    assert vector["motion_preservation"] > 0.5
    assert set(vector) == set(report["methods"][str(path)])
    assert sorted(p.name for p in (tmp_path / "plots").iterdir()) == ["fingertips.png", "frontier.png"]
    assert str(tmp_path / "table.json") in capsys.readouterr().out


def test_an_unknown_method_is_refused_before_anything_is_read(tmp_path):
    """The message lists every method, and nothing is written."""
    with pytest.raises(UnknownNameError, match=r"'mimic'.*dexpilot_online, geort.*linear_offline"):
        script("evaluate_retargeting").main(
            ["--recording", "none.npy", "--methods", "hold", "mimic", "--json", str(tmp_path / "t.json")]
        )
    assert not list(tmp_path.iterdir())


def test_recorded_frames_are_answered_in_their_order(play, quick):
    """Track and coverage of an online method are of the sequence, whatever was asked about it before."""
    hand = HandModel(load_hand("allegro_right"))
    judged = comparison.judge("vector_online", hand, play, frame_limit=60)
    frames = play.fingertips([4, 8, 12, 16]).astype(float)[:60]
    p_BF = hand.fingertips(VectorOnline(hand.kinematics())(frames))
    np.testing.assert_allclose(judged.p_BF, p_BF, atol=1e-12)
    assert judged.remembers and judged.metrics["smoothness"]["mean"] > 0


def test_unrecorded_hands_are_answered_without_memory(play, quick):
    """Where `settled` is given, it answers for perturbed hands and the method for the recorded ones."""
    hand = HandModel(load_hand("allegro_right"))
    frames = play.fingertips([4, 8, 12, 16]).astype(float)[:20]
    middle = 0.5 * (hand.lower + hand.upper)
    asked = {"method": 0, "settled": 0}

    def answers(name):
        def retarget(p_HF):
            asked[name] += 1
            assert name == "settled" or p_HF.ndim == 2 or len(p_HF) == 20
            return np.broadcast_to(middle, (*p_HF.shape[:-2], 16)).copy()

        return retarget

    evaluate_frames(answers("method"), hand, frames, 30.0, settled=answers("settled"))
    assert asked["method"] > 1 and asked["settled"] > 10
