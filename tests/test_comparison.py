"""The evaluation of several methods, and its script."""

import dataclasses
import json
import shlex

import numpy as np
import pytest
from light_training import train_lightly

from geort_drake import synthesize_play
from geort_drake.cli import run_command
from geort_drake.comparison.comparison import Comparison, Evaluation, Outcome
from geort_drake.comparison.metric_table import mean
from geort_drake.comparison.metrics import pinch
from geort_drake.comparison.protocols import GUARD_S, held_out
from geort_drake.errors import TrainingError
from geort_drake.retargeting.online import AnyTeleop


@pytest.fixture
def quick(light_evaluation, tmp_path):
    """Few samples and short training, so that what is tested is the plumbing."""

    def train(hand, recording, method="geort", seed=0, device="cpu"):
        path = tmp_path / f"{method}-{seed}-{recording.digest[:8]}.safetensors"
        return path if path.is_file() else train_lightly(hand, recording, path, method, seed)

    return train


@pytest.fixture
def evaluate(play, quick, monkeypatch, tmp_path):
    """Runs the script on the play; returns its exit code and what it wrote as JSON."""
    monkeypatch.setattr("geort_drake.retargeting.train.cached_map", quick)
    play.save(tmp_path / "hand.npz")
    synthesize_play(1, duration_s=20.0, rate_hz=30.0).save(tmp_path / "other.npz")
    monkeypatch.chdir(tmp_path)

    def run(arguments: str):
        command = f"--recording hand.npz --frames 40 --json table.json {arguments}"
        code = run_command("evaluate", shlex.split(command))
        return code, json.loads((tmp_path / "table.json").read_text("utf-8"))

    return run


def test_every_method_is_scored_under_every_protocol(evaluate, play, quick, tmp_path, capsys):
    """Trained and trivial methods, two seeds: JSON and tables are whole."""
    methods = ["telekinesis", "hold"]
    code, report = evaluate(f"--methods {' '.join(methods)} --held-out 2 --score-on other.npz --seeds 0 1")
    assert code == 0
    assert report["hand"] == "allegro_right" and "drake" in report["versions"]
    assert (report["recording"], report["recording_sha256"]) == ("hand.npz", play.digest)
    assert report["seeds"] == [0, 1] and list(report["methods"]) == methods
    parts = {name: [part["name"] for part in p["parts"]] for name, p in report["protocols"].items()}
    assert parts == {
        "same_person": ["hand.npz"],
        "held_out": ["block 1 of 2", "block 2 of 2"],
        "other_person": ["other.npz"],
    }
    for of_method in report["methods"].values():
        assert list(of_method) == list(parts)
        for protocol, figures in of_method.items():
            done = [(outcome["part"], outcome["seed"]) for outcome in figures["outcomes"]]
            assert done == [(part, seed) for seed in (0, 1) for part in parts[protocol]]
            assert all(outcome["frames"] == 40 for outcome in figures["outcomes"])
            assert (figures["worst_part"] is None) == (protocol != "held_out")
            covered = figures["mean"]["coverage"]["10mm"]
            assert (covered is None) == (protocol == "held_out")
    hold = report["methods"]["hold"]["same_person"]
    assert hold["mean"]["motion_preservation"] == 0.0 and hold["mean"]["smoothness"]["max"] == 0.0
    assert not hold["outcomes"][0]["remembers"]
    said = capsys.readouterr()
    assert said.out == "" and "Figures: table.json" in said.err
    for title in ("same person, training recording", "held-out blocks", "another person", "worst part"):
        assert title in said.err


def test_a_map_is_scored_only_where_its_training_fits(evaluate, play, quick, capsys):
    """It cannot be held out; what it learned from decides which of the other protocols it is for."""
    path = quick("allegro_right", play)
    code, report = evaluate(f"--methods {path} --held-out 2 --score-on other.npz")
    assert code == 1
    (of_method,) = report["methods"].values()
    assert of_method["same_person"]["mean"]["motion_preservation"] is not None
    assert of_method["other_person"]["mean"]["motion_preservation"] is not None
    assert of_method["held_out"]["mean"] is None
    assert "cannot be trained without the block" in of_method["held_out"]["outcomes"][0]["error"]
    assert "block 1 of 2, seed 0" in " ".join(capsys.readouterr().err.split())
    other_person = quick("allegro_right", synthesize_play(2, duration_s=20.0, rate_hz=30.0), seed=1)
    code, report = evaluate(f"--methods {other_person}")
    assert code == 1
    (outcome,) = report["methods"][str(other_person)]["same_person"]["outcomes"]
    assert "was trained on another recording than hand.npz" in outcome["error"]


def test_a_case_that_fails_leaves_the_others(evaluate, quick, monkeypatch, capsys):
    """A fold that cannot be learned from has its reason in place of figures; means are of the rest."""

    def train(hand, recording, method, seed, device="cpu"):
        if recording.valid[-1] and not recording.valid[0]:
            raise TrainingError("the recording's ring tip visits only 7 places")
        return quick(hand, recording, method, seed)

    monkeypatch.setattr("geort_drake.retargeting.train.cached_map", train)
    code, report = evaluate("--methods telekinesis hold --held-out 2")
    assert code == 1
    failed, done = report["methods"]["telekinesis"]["held_out"]["outcomes"]
    reason = "the recording's ring tip visits only 7 places"
    assert failed == {"part": "block 1 of 2", "seed": 0, "error": reason}
    mean = report["methods"]["telekinesis"]["held_out"]["mean"]
    assert mean["motion_preservation"] == done["metrics"]["motion_preservation"]
    assert len(report["methods"]["hold"]["held_out"]["outcomes"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "telekinesis, block 1 of 2, seed 0: the recording's ring tip" in said
    assert "(1 of 2)" in said


def test_a_stopped_run_leaves_the_methods_that_were_done(evaluate, quick, monkeypatch, tmp_path):
    """The file is whole after each method, and trained maps are found again."""
    trained = []

    def train(hand, recording, method, seed, device="cpu"):
        if method == "geort" and not trained[1:]:
            raise KeyboardInterrupt
        trained.append((method, (tmp_path / f"{method}-{seed}-{recording.digest[:8]}.safetensors").is_file()))
        return quick(hand, recording, method, seed)

    monkeypatch.setattr("geort_drake.retargeting.train.cached_map", train)
    with pytest.raises(KeyboardInterrupt):
        evaluate("--methods telekinesis geort")
    assert list(json.loads((tmp_path / "table.json").read_text("utf-8"))["methods"]) == ["telekinesis"]
    code, report = evaluate("--methods telekinesis geort")
    assert code == 0 and list(report["methods"]) == ["telekinesis", "geort"]
    assert trained == [("telekinesis", False), ("telekinesis", True), ("geort", False)]


@pytest.fixture
def halves(play, allegro) -> Comparison:
    """A comparison on the halves of the play, of methods that need no training."""
    return Comparison(allegro, [held_out(play, 2)], (0,), frame_limit=20)


def test_pinches_of_all_blocks_count_alike(halves):
    """A block without pinches has no share of closed ones, and one with few does not count as much."""
    rng = np.random.default_rng(0)
    outcomes = []
    for case, pinches in zip(halves.protocols[0].cases, (1, 3), strict=True):
        p_HF = np.zeros((4, 4, 3)) + [[0, 0, 0], [0, 0.1, 0], [0, 0.2, 0], [0, 0.3, 0]]
        p_HF[:pinches, 1, 1] = 0.01
        p_BF = p_HF + (0.05 if pinches == 1 else 0.0) * np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]])
        figures = {**mean([]), "motion_preservation": float(rng.uniform())}
        figures["pinch"] = pinch(p_HF, p_BF, halves.hand.finger_names, 0.012)
        outcomes.append(Outcome(case, 0, Evaluation(figures, False, p_HF, p_BF)))
    summary = halves.summary(outcomes)
    assert summary["mean"]["pinch"]["closed"] == pytest.approx(3 / 4)
    assert summary["mean"]["pinch"]["frames"] == 4
    assert summary["worst_part"]["pinch"]["closed"] == 0.0
    motions = [outcome.evaluation.metrics["motion_preservation"] for outcome in outcomes]
    assert summary["mean"]["motion_preservation"] == pytest.approx(np.mean(motions))
    assert summary["worst_part"]["motion_preservation"] == min(motions)


def test_recorded_frames_are_answered_in_their_order_from_rest(halves, quick):
    """Track and coverage of an online method are of each sequence, whatever was asked about before."""
    keypoints, hand = [4, 8, 12, 16], halves.hand
    for outcomes in halves.run("anyteleop").values():
        for outcome in outcomes:
            frames = outcome.case.scored_on.fingertips(keypoints)[:20]
            p_BF = hand.fingertips(AnyTeleop(hand.kinematics())(frames))
            np.testing.assert_allclose(outcome.evaluation.p_BF, p_BF, atol=1e-12)
            assert outcome.evaluation.remembers and outcome.evaluation.metrics["motion_preservation"] > 0.5


# -- protocols: no frame on both sides, none forgotten


@pytest.mark.parametrize("blocks", [2, 4, 55])
def test_held_out_blocks_share_out_the_valid_frames(play, blocks):
    """Each is scored once; learned from is all that is valid and at least the guard away in time."""
    # Twenty seconds in which tracking was lost twice.
    frames = np.arange(600)
    seen = ((frames < 100) | (frames >= 140)) & ((frames < 400) | (frames >= 403))
    gaps = dataclasses.replace(play, t=play.t[frames], p_HK=play.p_HK[frames], valid=seen)
    cases = held_out(gaps, blocks).cases
    scored = np.array([case.scored_on.valid for case in cases])
    np.testing.assert_array_equal(scored.sum(axis=0), gaps.valid.astype(int))
    assert len(cases) == blocks and np.ptp(scored.sum(axis=1)) <= 1
    for case, block in zip(cases, scored, strict=True):
        first, last = np.flatnonzero(block)[[0, -1]]
        np.testing.assert_array_equal(block[first : last + 1], gaps.valid[first : last + 1])
        outside = (gaps.t < gaps.t[first] - GUARD_S) | (gaps.t > gaps.t[last] + GUARD_S)
        np.testing.assert_array_equal(case.trained_on.valid, gaps.valid & outside)
