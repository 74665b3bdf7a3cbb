"""From a recording to an evaluated checkpoint, on the Allegro hand."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from script_modules import load_script

import geort_drake
from geort_drake import files
from geort_drake.comparison import train as comparison_train
from geort_drake.comparison.metrics import evaluate
from geort_drake.comparison.train import train_checkpoint
from geort_drake.errors import CheckpointError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.people.readers import read_recording
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

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
    monkeypatch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 20_000)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, play):
    """One quick training that several tests look at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 20_000)
        output = tmp_path_factory.mktemp("runs") / "allegro"
        return train_checkpoint(
            "allegro_right",
            play,
            output,
            "geort",
            seed=2,
            show_progress=False,
            settings=QUICK,
            robot_samples=5000,
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
    sampled = {"count": 5000, "seed": 2, "model_sha256": hand.digest, "labels": True}
    assert provenance["robot_data"] == sampled
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
    arguments = {"method": "geort", "show_progress": False, "settings": QUICK, "robot_samples": 5000}
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
        train_checkpoint("allegro_right", play, tmp_path / "x", settings={"fk": "guess"})
    with pytest.raises(UnknownNameError, match="setting of geort 'jitter'; choose one of: classifier_steps"):
        train_checkpoint("allegro_right", play, tmp_path / "x", "geort", settings={"jitter": 0.002})
    with pytest.raises(UnknownNameError, match="allegro_right"):
        train_checkpoint("no_such_hand", play, tmp_path / "x")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(CheckpointError, match="exists and is not a checkpoint"):
        train_checkpoint("allegro_right", play, tmp_path)


@pytest.fixture
def script(light_evaluation):
    """scripts/train_retargeter.py as a module."""
    return load_script("train_retargeter.py")


def test_the_script_trains_and_prints_the_metrics(script, play, tmp_path, capsys):
    """--recording to a file, --set and --steps reach the training, --json prints what was stored."""
    recording = tmp_path / "play.npz"
    play.save(recording)
    settings = [f"--set={name}={value}" for name, value in QUICK.items() if name != "steps"]
    output = tmp_path / "run"
    arguments = ["--recording", str(recording), "--output", str(output), "--steps", "10", "--json"]
    arguments += ["--robot_samples", "2000"]
    assert script.main([*arguments, *settings]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((output / "metrics.json").read_text())
    assert load_checkpoint(output).config["training"]["steps"] == 10


def test_the_script_knows_every_methods_settings(script, play, tmp_path):
    """A preset, what takes precedence over it, and the settings of geort_coupled."""
    play.save(tmp_path / "play.npz")
    arguments = ["--recording", str(tmp_path / "play.npz"), "--robot_samples", "2000", "--quiet"]

    def trained(name, *more) -> dict:
        assert script.main([*arguments, "--output", str(tmp_path / name), "--steps", "3", *more]) == 0
        return load_checkpoint(tmp_path / name).config["training"]

    quick = [
        "--method=geort",
        "--set=kinematics_steps=5",
        "--set=classifier_steps=5",
        "--set=points=64",
        "--set=targets=64",
    ]
    public = trained("public", "--preset", "public", *quick, "--set", "pinch_weight=0.5")
    assert public["resampling"] == "independent" and public["fk"] == "neural"
    assert public["length_unit"] == 1.0 and public["collision_weight"] == 0.0
    assert public["pinch_weight"] == 0.5 and public["steps"] == 3
    coupled = trained("coupled", "--set", "jitter=0.002")
    assert coupled["jitter"] == 0.002 and "averaging" in coupled
    assert trained("neural", *quick, "--fk", "neural")["fk"] == "neural"


@pytest.mark.parametrize("method", ["geort", "geort_coupled"])
def test_what_the_recording_lacks_is_in_the_report(script, play, tmp_path, capsys, method):
    """A finger that never pinches and one that hardly bends are named in checkpoint and report."""
    p_HK = play.p_HK.astype(float)
    index = slice(5, 9)
    p_HK[:, index] = p_HK[:, index].mean(0) + 0.1 * (p_HK[:, index] - p_HK[:, index].mean(0))
    distance = np.linalg.norm(p_HK[:, [8, 12, 16]] - p_HK[:, [4]], axis=-1)
    keep = distance[:, 0] > 0.02
    narrow = Recording(play.t[keep], p_HK[keep], play.valid[keep], None, {**play.metadata})
    narrow.save(tmp_path / "narrow.npz")
    arguments = ["--recording", str(tmp_path / "narrow.npz"), "--output", str(tmp_path / "run")]
    quick = [f"--set={name}={value}" for name, value in QUICK.items() if name != "steps"]
    assert script.main([*arguments, "--method", method, "--steps=2", "--robot_samples=2000", *quick]) == 0
    said = load_checkpoint(tmp_path / "run").provenance["warnings"]
    motions = [text.split(" by only ")[0] for text in said if " by only " in text]
    assert motions == ["the recording's index bends", "the recording's index moves sideways"]
    assert any("no pinch of the thumb with: index" in text for text in said)
    shown = " ".join(capsys.readouterr().err.split())
    for text in said:
        assert f"warning: {text}" in shown


@pytest.mark.parametrize("method", ["geort", "geort_coupled", "linear_offline"])
def test_a_diverging_training_leaves_a_usable_checkpoint(script, play, tmp_path, capsys, method, hand):
    """An absurd learning rate ends with exit code 3, a warning, and the last good weights."""
    play.save(tmp_path / "play.npz")
    arguments = ["--recording", str(tmp_path / "play.npz"), "--output", str(tmp_path / "run")]
    arguments += ["--method", method, "--steps", "40", "--robot_samples", "2000", "--quiet"]
    quick = [f"--set={name}={QUICK[name]}" for name in ("hidden", "points", "targets", "classifier_steps")]
    assert script.main([*arguments, *quick, "--set", "learning_rate=1e30"]) == 1
    assert "warning: the loss stopped being finite at step" in " ".join(capsys.readouterr().err.split())
    checkpoint = load_checkpoint(tmp_path / "run")
    assert checkpoint.provenance["training"]["stopped_at"] < 40
    q = load_retargeter(tmp_path / "run", hand)(play.p_HK[:50])
    assert np.isfinite(q).all()
    assert (tmp_path / "run" / "metrics.json").is_file()


@pytest.mark.usefixtures("light_evaluation")
def test_the_cache_tells_settings_methods_and_code_apart(play, monkeypatch, tmp_path):
    """Equal requests share a checkpoint; other settings, another method or other code do not."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    trained = []

    def train(hand, recording, path, method, seed, device, settings):
        trained.append(settings)
        return train_checkpoint(
            hand, recording, path, method, seed, device, False, {**QUICK, "steps": 2, **settings}, 2000
        )

    monkeypatch.setattr(comparison_train, "train_checkpoint", train)

    def cached(**settings):
        return comparison_train.cached_checkpoint("allegro_right", play, "geort", settings=settings)

    first, reused = cached(hidden=16)
    assert not reused
    assert cached(hidden=16) == (first, True)
    assert not cached(hidden=24)[1]
    assert not comparison_train.cached_checkpoint("allegro_right", play, "linear_offline", settings={})[1]
    monkeypatch.setattr(comparison_train, "digest_of", lambda root, paths: "other")
    assert not cached(hidden=16)[1]
    assert len(trained) == 4
    with pytest.raises(UnknownNameError, match="setting of geort 'speed'"):
        cached(speed=1)


@pytest.mark.usefixtures("light_evaluation")
def test_the_cache_repeats_what_training_warned_of(play, monkeypatch, tmp_path):
    """A checkpoint that stopped early is not handed out in silence the second time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def train(*arguments, settings):
        return train_checkpoint(
            *arguments, show_progress=False, robot_samples=2000, settings={**QUICK, "learning_rate": 1e30}
        )

    monkeypatch.setattr(comparison_train, "train_checkpoint", train)
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="stopped being finite"):
            comparison_train.cached_checkpoint("allegro_right", play, "geort")


def test_the_code_digest_covers_what_weights_depend_on(monkeypatch):
    """Training code and the hand's geometry count."""
    read = []
    monkeypatch.setattr(files, "sha256_of", lambda path: read.append(path.name) or "0")
    files.digest_of(Path(geort_drake.__file__).parent, comparison_train.TRAINING_CODE)
    assert {"collision_shapes.py", "samples.py", "criteria.py", "linear_offline.py"} <= set(read)


def test_a_digest_tells_names_and_contents_apart_and_skips_what_python_compiles(tmp_path):
    """A renamed, changed or added file changes it; a .pyc does not, nor the order of what is asked for."""
    a, b = tmp_path / "a.py", tmp_path / "room" / "b.py"
    b.parent.mkdir()
    a.write_text("1")
    b.write_text("2")
    digests = [files.digest_of(tmp_path, [a, b.parent])]
    (b.parent / "b.pyc").write_text("compiled")
    assert files.digest_of(tmp_path, [b.parent, a]) == digests[0]
    b.write_text("3")
    digests.append(files.digest_of(tmp_path, [a, b.parent]))
    b.rename(b.with_name("c.py"))
    digests.append(files.digest_of(tmp_path, [a, b.parent]))
    b.write_text("3")
    digests.append(files.digest_of(tmp_path, [a, b.parent]))
    assert len(set(digests)) == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "settings", "motion", "coverage", "closed", "collision", "cross_talk"),
    [
        ("geort", {"steps": 400, "refreshes": 5, "classifier_steps": 500}, 0.75, 0.4, 0.8, 0.05, 0.0),
        ("geort_coupled", {"steps": 600}, 0.95, 0.3, 0.95, 0.005, 0.08),
    ],
)
def test_a_tenth_of_the_training_already_serves_the_real_recording(
    alex_npy, hand, tmp_path, method, settings, motion, coverage, closed, collision, cross_talk
):
    """Pinches close, the hand does not collide, and the C-space is used; the full run does better."""
    path = train_checkpoint(
        "allegro_right", alex_npy, tmp_path / "alex", method, show_progress=False, robot_samples=20_000,
        settings=settings,
    )  # fmt: skip
    figures = json.loads((path / "metrics.json").read_text())
    assert figures["motion_preservation"] > motion
    assert figures["coverage"]["10mm"] > coverage
    assert figures["pinch"]["closed"] > closed
    assert figures["pinch"]["frames"] == 1071
    assert figures["self_collision"] < collision
    assert figures["cross_talk"] <= cross_talk
    retarget = load_retargeter(path, hand)
    frames = read_recording(alex_npy).p_HK
    q = retarget(frames)
    assert (q >= hand.lower).all()
    assert (q <= hand.upper).all()
