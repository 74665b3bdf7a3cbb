"""The evaluation of several methods, and its script."""

import dataclasses
import json
import shlex

import numpy as np
import pytest
from light_training import train_lightly

from geort_drake import load_retargeter, synthesize_play
from geort_drake.cli import run_command
from geort_drake.errors import TrainingError
from geort_drake.metrics import evaluation
from geort_drake.metrics.compare import GUARD_S, Comparison, better, held_out, summary, worst
from geort_drake.retargeting.online import AnyTeleop


@pytest.fixture
def quick(light_evaluation, tmp_path):
    """Few samples and short training, so that what is tested is the plumbing."""

    def train(hand, recording, method="geort", seed=0, device="cpu"):
        path = tmp_path / f"{method}-{seed}-{recording.digest[:8]}.safetensors"
        if not path.is_file():
            train_lightly(hand, recording, path, method, seed)
        return load_retargeter(path, hand), path

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


def values(report, **key) -> dict:
    """Metric → values of the rows with that key."""
    found: dict = {}
    for row in report["rows"]:
        if key.items() <= row.items():
            found.setdefault(row["metric"], []).append(row["value"])
    return found


def test_every_method_is_scored_under_every_protocol(evaluate, play, tmp_path, capsys):
    """A trained, a trivial and one's own method, two seeds: rows and tables are whole."""
    (tmp_path / "own.py").write_text(
        "def make(hand):\n    return lambda p_HK: 0.5 * (hand.lower + hand.upper)\n"
    )
    methods = ["telekinesis", "hold", "own.py"]
    code, report = evaluate(f"--methods {' '.join(methods)} --held-out 2 --score-on other.npz --seeds 0 1")
    assert code == 0 and report["errors"] == []
    assert report["hand"] == "allegro_right" and "drake" in report["versions"]
    assert (report["recording"], report["recording_sha256"]) == ("hand.npz", play.digest)
    wanted = [
        (method, protocol, part, seed)
        for method in methods
        for protocol, parts in (
            ("same_person", ["hand.npz"]),
            ("held_out", ["block 1 of 2", "block 2 of 2"]),
            ("other_person", ["other.npz"]),
        )
        for seed in (0, 1)
        for part in parts
    ]
    keys = [(row["method"], row["protocol"], row["part"], row["seed"]) for row in report["rows"]]
    assert list(dict.fromkeys(keys)) == wanted
    hold = values(report, method="hold", protocol="same_person")
    assert hold["motion_preservation"] == [0.0, 0.0] and hold["jitter"] == [0.0, 0.0]
    own = values(report, method="own.py", protocol="same_person")
    assert all(own[name] == hold[name] for name in hold if not name.startswith("latency"))
    assert values(report, method="hold", protocol="held_out")["coverage"] == [None] * 4
    assert report["metrics"]["motion_preservation"] == "higher" and report["metrics"]["jitter"] == "lower"
    means = [line for line in report["summary"] if line["metric"] == "smoothness.max"]
    assert [line["worst_part"] is None for line in means if line["method"] == "hold"] == [True, False, True]
    said = capsys.readouterr()
    assert said.out == "" and "Figures: table.json" in said.err
    for title in ("same person, training recording", "held-out blocks", "another person", "worst part"):
        assert title in said.err


def test_a_map_is_scored_only_where_its_training_fits(evaluate, play, quick, allegro, capsys):
    """It cannot be held out; what it learned from decides which of the other protocols it is for."""
    _, path = quick(allegro, play)
    code, report = evaluate(f"--methods {path} --held-out 2 --score-on other.npz")
    assert code == 1
    for protocol in ("same_person", "other_person"):
        assert values(report, protocol=protocol)["motion_preservation"][0] is not None
    assert {row["protocol"] for row in report["errors"]} == {"held_out"}
    assert "cannot be trained without the block" in report["errors"][0]["error"]
    assert "block 1 of 2, seed 0" in " ".join(capsys.readouterr().err.split())
    _, other_person = quick(allegro, synthesize_play(2, duration_s=20.0, rate_hz=30.0), seed=1)
    code, report = evaluate(f"--methods {other_person}")
    assert code == 1
    (failed,) = report["errors"]
    assert "was trained on another recording than hand.npz" in failed["error"]


def test_a_failed_case_does_not_stop_the_others(evaluate, quick, monkeypatch, capsys):
    """A fold that cannot be learned from has its reason in place of figures; means are of the rest."""

    def train(hand, recording, method, seed, device="cpu"):
        if recording.valid[-1] and not recording.valid[0]:
            raise TrainingError("the recording's ring tip visits only 7 places")
        return quick(hand, recording, method, seed)

    monkeypatch.setattr("geort_drake.retargeting.train.cached_map", train)
    code, report = evaluate("--methods telekinesis hold --held-out 2")
    assert code == 1
    (failed,) = report["errors"]
    reason = "the recording's ring tip visits only 7 places"
    assert failed == {
        "method": "telekinesis", "protocol": "held_out", "part": "block 1 of 2", "seed": 0, "error": reason
    }  # fmt: skip
    assert len(values(report, method="telekinesis", protocol="held_out")["motion_preservation"]) == 1
    assert len(values(report, method="hold", protocol="held_out")["motion_preservation"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "telekinesis, block 1 of 2, seed 0: the recording's ring tip" in said
    assert "(1 of 2)" in said


@pytest.mark.slow
def test_an_interrupted_run_keeps_the_finished_methods(evaluate, quick, monkeypatch, tmp_path):
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
    report = json.loads((tmp_path / "table.json").read_text("utf-8"))
    assert {row["method"] for row in report["rows"]} == {"telekinesis"}
    code, report = evaluate("--methods telekinesis geort")
    assert code == 0 and {row["method"] for row in report["rows"]} == {"telekinesis", "geort"}
    assert trained == [("telekinesis", False), ("telekinesis", True), ("geort", False)]


@pytest.fixture
def halves(play, allegro) -> Comparison:
    """A comparison on the halves of the play, of methods that need no training."""
    return Comparison(allegro, {"held_out": held_out(play, 2)}, (0,), frame_limit=10)


def row(metric, value, part="a", seed=0, weight=1.0) -> dict:
    key = {"method": "m", "protocol": "held_out", "part": part, "seed": seed}
    return {**key, "metric": metric, "value": value, "weight": weight}


def figures_of(rows, metric) -> dict:
    (line,) = (line for line in summary(rows).to_dict("records") if line["metric"] == metric)
    return line


def test_pinches_of_all_blocks_count_alike():
    """A block with few pinches does not count as much, and one without has no share of closed ones."""
    rows = [
        *(row("pinch.closed", 0.0, "a", weight=1.0), row("pinch.frames", 1, "a")),
        *(row("pinch.closed", 1.0, "b", weight=3.0), row("pinch.frames", 3, "b")),
        *(row("pinch.closed", None, "c", weight=0.0), row("pinch.frames", 0, "c")),
    ]
    assert figures_of(rows, "pinch.closed")["mean"] == pytest.approx(0.75)
    assert figures_of(rows, "pinch.closed")["worst_part"] == 0.0
    assert figures_of(rows, "pinch.frames")["mean"] == 4


def test_the_summary_averages_over_parts_then_over_seeds():
    rows = [row("jitter", value, part, seed) for seed, parts in enumerate(((1, 3), (5, 7)))
            for part, value in zip("ab", parts, strict=True)]  # fmt: skip
    line = figures_of(rows, "jitter")
    assert (line["mean"], line["worst_part"], line["worst_seed"]) == (4.0, 7.0, 6.0)
    assert np.isnan(figures_of(rows[:1], "jitter")["worst_part"])


def test_the_worst_value_depends_on_which_direction_is_better():
    """Where neither is better, there is no worst."""
    assert worst("coverage.10mm", [0.5, 0.2]) == 0.2 and worst("cross_talk", [0.5, 0.2]) == 0.5
    assert np.isnan(worst("pinch.mean_mm", [1.0])) and better("size.fingers.thumb") is None


@pytest.mark.slow
def test_an_online_method_gets_recorded_frames_in_order_from_rest(halves, quick, monkeypatch):
    """Track and coverage of an online method are of each sequence, whatever was asked about before."""
    outputs = []

    def track(frames, p_BF):
        outputs.append((frames, p_BF))
        return original(frames, p_BF)

    original = evaluation.motion_preservation_track
    monkeypatch.setattr(evaluation, "motion_preservation_track", track)
    rows = halves.run("anyteleop")
    assert min(row["value"] for row in rows if row["metric"] == "motion_preservation") > 0.5
    hand = halves.hand
    assert len(outputs) == 2
    for frames, p_BF in outputs:
        np.testing.assert_allclose(p_BF, hand.fingertips(AnyTeleop(hand.kinematics())(frames)), atol=1e-12)


# -- protocols: no frame on both sides, none forgotten


@pytest.mark.parametrize("blocks", [2, 4, 55])
def test_held_out_blocks_divide_the_valid_frames(play, blocks):
    """Each is scored once; learned from is all that is valid and at least the guard away in time."""
    # Twenty seconds in which tracking was lost twice.
    frames = np.arange(600)
    seen = ((frames < 100) | (frames >= 140)) & ((frames < 400) | (frames >= 403))
    gaps = dataclasses.replace(play, t=play.t[frames], p_HK=play.p_HK[frames], valid=seen)
    cases = held_out(gaps, blocks).values()
    scored = np.array([scored_on.valid for _, scored_on in cases])
    np.testing.assert_array_equal(scored.sum(axis=0), gaps.valid.astype(int))
    assert len(cases) == blocks and np.ptp(scored.sum(axis=1)) <= 1
    for (trained_on, _), block in zip(cases, scored, strict=True):
        first, last = np.flatnonzero(block)[[0, -1]]
        np.testing.assert_array_equal(block[first : last + 1], gaps.valid[first : last + 1])
        outside = (gaps.t < gaps.t[first] - GUARD_S) | (gaps.t > gaps.t[last] + GUARD_S)
        np.testing.assert_array_equal(trained_on.valid, gaps.valid & outside)
