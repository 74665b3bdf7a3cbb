"""From a recording to an evaluated checkpoint, and the cache of checkpoints."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from light_training import train_lightly

from geort_drake import HandModel, Recording, evaluate, files, load_retargeter, train_checkpoint
from geort_drake.cli import run_command
from geort_drake.comparison import train as comparison_train
from geort_drake.comparison.train import cached_checkpoint
from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.retargeting.checkpoint import load_checkpoint


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, play):
    """One quick training that several tests look at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
        output = tmp_path_factory.mktemp("runs") / "allegro"
        return train_lightly("allegro_right", play, output, "geort", seed=2, steps=60)


def test_a_trained_checkpoint_knows_where_it_comes_from(checkpoint, allegro, play):
    """Hand, recording, seed, versions, timings and figures are on record."""
    content = load_checkpoint(checkpoint)
    assert content.config["method"] == "geort"
    assert content.config["human_keypoints"] == [4, 8, 12, 16]
    assert content.config["training"]["steps"] == 60
    assert content.hand["model_sha256"] == allegro.digest
    provenance = content.provenance
    assert provenance["recording"]["sha256"] == play.digest
    assert provenance["robot_data"] == {"count": 1000, "seed": 2, "model_sha256": allegro.digest}
    assert {"drake", "torch", "numpy", "geort_drake"} <= set(provenance["versions"])
    assert provenance["timings"]["fit_s"] > provenance["timings"]["training_s"] > 0
    rows = (checkpoint / "history.csv").read_text().splitlines()
    assert rows[0].startswith("step,total,direction,coverage,flatness,pinch,collision") and len(rows) > 50


def test_the_stored_metrics_are_those_of_the_stored_weights(checkpoint, allegro, play, monkeypatch):
    """Loading the checkpoint and evaluating it again gives the same figures."""
    monkeypatch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
    stored = json.loads((checkpoint / "metrics.json").read_text())
    assert (stored["hand"], stored["recording_sha256"]) == ("allegro_right", play.digest)
    again = evaluate(load_retargeter(checkpoint, allegro), allegro, play, seed=2)
    for key, value in again.items():
        if key != "latency_us":
            assert stored[key] == value


@pytest.fixture
def train(light_evaluation, play, tmp_path):
    """Runs the command with a few steps; returns its exit code and the checkpoint, in tmp_path/`name`."""

    def run(name, *more, recording=play):
        recording.save(tmp_path / "play.npz")
        common = ["--recording", str(tmp_path / "play.npz"), "--output", str(tmp_path / name)]
        code = run_command("train", [*common, "--robot-samples", "2000", "--steps", "3", *more])
        return code, load_checkpoint(tmp_path / name)

    return run


def test_the_command_passes_on_presets_and_settings(train, tmp_path, capsys):
    """--set and --steps take precedence over --preset; --json prints the stored metrics."""
    quick = [f"--set={name}=5" for name in ("kinematics_steps", "classifier_steps", "points", "targets")]
    more = ["--set", "pinch_weight=0.5", "--json", "--quiet"]
    code, public = train("public", "--method=geort", "--preset", "public", *quick, *more)
    expected = {"resampling": "independent", "fk": "neural", "length_unit": 1.0, "pinch_weight": 0.5}
    assert code == 0 and public.config["training"].items() >= (expected | {"steps": 3}).items()
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "public/metrics.json").read_text())
    code, coupled = train("coupled", "--set", "collision=0.002")
    assert code == 0 and coupled.config["training"]["collision"] == 0.002


def test_shortcomings_of_the_recording_are_in_the_report(train, play, capsys):
    """A finger that never pinches and one that hardly bends are named in checkpoint and report."""
    p_HK = play.p_HK.astype(float)
    index = slice(5, 9)
    p_HK[:, index] = p_HK[:, index].mean(0) + 0.1 * (p_HK[:, index] - p_HK[:, index].mean(0))
    distance = np.linalg.norm(p_HK[:, [8, 12, 16]] - p_HK[:, [4]], axis=-1)
    keep = distance[:, 0] > 0.02
    narrow = Recording(play.t[keep], p_HK[keep], play.valid[keep], None, {**play.metadata})
    code, checkpoint = train("run", recording=narrow)
    assert code == 0
    found = checkpoint.provenance["warnings"]
    motions = [text.split(":")[0] for text in found if text.startswith("narrow motion, ")]
    assert motions == ["narrow motion, index bends", "narrow motion, index moves sideways"]
    assert any("no pinch of the thumb with: index" in text for text in found)
    shown = " ".join(capsys.readouterr().err.split())
    assert all(f"warning: {text}" in shown for text in found)


def test_a_diverging_training_leaves_a_usable_checkpoint(train, play, tmp_path, capsys, allegro):
    """An absurd learning rate ends with exit code 1, a warning, and the last good weights."""
    code, checkpoint = train("run", "--quiet", "--steps", "40", "--set", "learning_rate=1e30")
    assert code == 1
    assert "warning: the loss stopped being finite at step" in " ".join(capsys.readouterr().err.split())
    assert checkpoint.provenance["training"]["stopped_at"] < 40
    assert np.isfinite(load_retargeter(tmp_path / "run", allegro)(play.p_HK[:50])).all()
    assert (tmp_path / "run" / "metrics.json").is_file()


@pytest.mark.usefixtures("light_evaluation")
def test_a_left_hand_learns_what_the_right_one_learns(tmp_path, play, allegro, allegro_left):
    """From mirrored recordings: the same joint angles and figures."""
    with pytest.MonkeyPatch.context() as patch:
        # The default method has the collision geometry instead.
        patch.setattr(HandModel, "collides_beyond_tips", lambda *_: pytest.fail("labels nobody needs"))
        right = train_lightly("allegro_right", play, tmp_path / "right", "geort_coupled")
    left = train_lightly("allegro_left", play.mirrored(), tmp_path / "left", "geort_coupled")
    frames = play.p_HK[::50].astype(float)
    q_right, q_left = (load_retargeter(path)(frames) for path in (right, left))
    np.testing.assert_allclose(q_left, q_right, atol=1e-3)
    mirrored = allegro.fingertips(q_right) * [1, -1, 1]
    np.testing.assert_allclose(allegro_left.fingertips(q_left), mirrored, atol=1e-3)
    figures = [json.loads((path / "metrics.json").read_text()) for path in (right, left)]
    for name in ("motion_preservation", "flatness", "self_collision_raw"):
        assert figures[1][name] == pytest.approx(figures[0][name], abs=0.01), name
    with pytest.raises(RecordingError, match="of a right hand, the robot's is a left hand"):
        train_lightly("allegro_left", play, tmp_path / "refused")


@pytest.mark.slow
def test_a_tenth_of_the_training_already_serves_the_real_recording(alex_npy, tmp_path, monkeypatch):
    """Pinches close, the hand does not collide, and the C-space is used; the full run does better."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 20_000)
    path = train_checkpoint(
        "allegro_right", alex_npy, tmp_path / "alex", "geort_coupled", show_progress=False,
        robot_samples=20_000, settings={"steps": 600},
    )  # fmt: skip
    figures = json.loads((path / "metrics.json").read_text())
    assert figures["motion_preservation"] > 0.95 and figures["coverage"]["10mm"] > 0.3
    assert figures["pinch"]["closed"] > 0.95 and figures["pinch"]["frames"] == 1071
    assert figures["self_collision"] < 0.005 and figures["cross_talk"] <= 0.08


@pytest.mark.usefixtures("light_evaluation")
def test_equal_requests_share_a_checkpoint_and_its_warnings(play, monkeypatch):
    """Also at the same time. Other settings, another method or other code do not.

    A checkpoint whose training stopped early is not handed out silently the second time.
    """
    trainings = []

    def train(hand, recording, path, method, seed, device, settings):
        trainings.append(method)
        return train_lightly(hand, recording, path, method, seed, **settings)

    def cached(method="linear_offline", **settings):
        return cached_checkpoint("allegro_right", play, method, settings=settings)

    monkeypatch.setattr(comparison_train, "train_checkpoint", train)
    with ThreadPoolExecutor() as threads:  # locks keep threads apart like processes
        paths = [request.result() for request in [threads.submit(cached, points=16) for _ in range(2)]]
    paths += [cached(points=24), cached("geort", pinch_weight=0.5)]
    monkeypatch.setattr(comparison_train, "source_digest", lambda *subpackages: "other")
    paths.append(cached(points=16))
    assert paths[0] == paths[1] and len(set(paths)) == len(trainings) == 4
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="stopped being finite"):
            cached(learning_rate=1e30)
    assert len(trainings) == 5
    with pytest.raises(UnknownNameError, match="setting of linear_offline 'speed'"):
        cached(speed=1)


def test_the_key_survives_what_tests_and_calls_leave_behind(monkeypatch):
    """Compiling the call with numba writes into the package; the digest of the sources stays."""
    before = files.source_digest("retargeting")
    cache = Path(files.__file__).parent / "retargeting" / "__pycache__"
    cache.mkdir(exist_ok=True)
    left = cache / "compiled.test-1.py311.nbi"
    left.write_bytes(b"compiled")
    try:
        assert files.source_digest("retargeting") == before
    finally:
        left.unlink()
