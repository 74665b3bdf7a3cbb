"""From a recording to an evaluated map in a file, and the cache of maps."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from light_training import LIGHT, train_lightly

from geort_drake import Hand, Recording, evaluate, load_retargeter, train_map
from geort_drake.cli import run_command
from geort_drake.errors import RecordingError, UnknownNameError
from geort_drake.metrics.metrics import motion_preservation_track
from geort_drake.people.recording import PINCH_M
from geort_drake.retargeting import train as retargeting_train
from geort_drake.retargeting.train import cached_map


@pytest.mark.usefixtures("light_evaluation")
def test_a_map_stores_its_provenance(tmp_path, allegro, play):
    """Hand, recording, seed, versions, time and losses are on record, also in the file."""
    path = train_lightly(allegro, play, tmp_path / "map.safetensors", "geort", seed=2)
    retarget = load_retargeter(path, allegro)
    info = retarget.info
    assert info["method"] == "geort" and info["config"].items() >= {"steps": 5, "seed": 2}.items()
    assert retarget.robot_hands == ("allegro_right",) and list(retarget.human_keypoints) == [4, 8, 12, 16]
    provenance = info["provenance"]
    assert provenance["recording"]["sha256"] == play.digest
    assert provenance["hands"] == {"allegro_right": allegro.digest}
    assert {"drake", "torch", "numpy", "geort_drake"} <= set(provenance["versions"])
    assert provenance["seconds"] > 0 and len(info["history"]) == 5
    assert retarget.distances(play.p_HK[100]).max() < 0.012


@pytest.fixture
def train(light_evaluation, play, tmp_path):
    """Runs the command with a few steps; returns the map, in tmp_path/map.safetensors."""

    def run(*more, recording=play):
        recording.save(tmp_path / "play.npz")
        output = tmp_path / "map.safetensors"
        settings = [f"--set={name}={value}" for name, value in LIGHT["geort"].items()]
        words = ["--recording", str(tmp_path / "play.npz"), "--output", str(output), *settings, *more]
        assert run_command("train", words) == 0
        return load_retargeter(output)

    return run


def test_the_command_passes_on_settings_and_stores_the_metrics(train, allegro, play, capsys):
    """--set; --json prints the stored metrics, which are those of the stored weights."""
    retarget = train("--set=fk=exact", "--set=steps=3", "--set=pinch_weight=2000", "--json", "-", "--quiet")
    assert retarget.info["config"].items() >= {"fk": "exact", "steps": 3, "pinch_weight": 2000.0}.items()
    metrics = json.loads(capsys.readouterr().out)
    assert metrics == retarget.info["metrics"] and metrics["recording_sha256"] == play.digest
    again = evaluate(retarget, allegro, play)
    for key in ("motion_preservation", "coverage", "pinch"):
        # The file has single precision.
        assert np.allclose(np.array(flat(again[key])), np.array(flat(metrics[key])), atol=1e-3), key


def flat(figure) -> list[float]:
    """All numbers of a figure."""
    if isinstance(figure, dict):
        return [number for value in figure.values() for number in flat(value)]
    return [float(figure)]


def test_shortcomings_of_the_recording_are_reported(train, play, capsys):
    """A finger that never pinches and one that hardly bends are named in the map and on the screen."""
    p_HK = play.p_HK.astype(float)
    index = slice(5, 9)
    p_HK[:, index] = p_HK[:, index].mean(0) + 0.1 * (p_HK[:, index] - p_HK[:, index].mean(0))
    distance = np.linalg.norm(p_HK[:, [8, 12, 16]] - p_HK[:, [4]], axis=-1)
    keep = distance[:, 0] > 0.02
    narrow = Recording(play.t[keep], p_HK[keep], play.valid[keep], None, {**play.metadata})
    warnings = train(recording=narrow).info["provenance"]["warnings"]
    motions = [text.split(":")[0] for text in warnings if text.startswith("narrow motion, ")]
    assert motions == ["narrow motion, index bends", "narrow motion, index moves sideways"]
    assert any("no pinch of the thumb with the index" in text for text in warnings)
    screen = " ".join(capsys.readouterr().err.split())
    assert all(f"warning: {text}" in screen for text in warnings)


@pytest.mark.usefixtures("light_evaluation")
def test_a_left_hand_learns_what_the_right_one_learns(tmp_path, play, allegro):
    """From mirrored recordings: a left hand that is the mirror image gets the same joint angles."""

    class Mirrored:
        """The right hand seen in a mirror."""

        description = Hand("allegro_left").description
        finger_names, joint_names, digest = allegro.finger_names, allegro.joint_names, "mirrored"
        sample, collides_beyond_tips = allegro.sample, allegro.collides_beyond_tips

        def kinematics(self):
            return allegro.kinematics().mirrored()

    settings, frames = LIGHT["geort"], play.p_HK[::50].astype(float)
    right = train_map(allegro, play, settings=settings, show_progress=False)
    left = train_map(Mirrored(), play.mirrored(), settings=settings, show_progress=False)
    np.testing.assert_allclose(left(frames), right(frames), atol=1e-3)
    with pytest.raises(RecordingError, match="of a right hand, the robot's is a left hand"):
        train_map(Mirrored(), play, settings=settings)


@pytest.mark.slow
@pytest.mark.training
def test_a_short_training_already_serves_the_real_recording(alex_npy, allegro, training_seed, reaches):
    """Fingertips move as the person's, and pinches come near contact."""
    recording = retargeting_train.training_recording(alex_npy, "right")
    settings = {"steps": 150, "points": 128, "pretraining_steps": 300, "robot_samples": 5_000}
    retarget = train_map(allegro, recording, seed=training_seed, settings=settings, show_progress=False)
    frames = recording.fingertips([4, 8, 12, 16])
    tips = allegro.fingertips(retarget(frames))
    reaches("motion", 1.0 - motion_preservation_track(frames, tips), 0.4)
    human, robot = (np.linalg.norm(p[:, 1:] - p[:, :1], axis=-1) for p in (frames, tips))
    pinching = human.min(axis=1) < PINCH_M
    distances = robot[pinching, human[pinching].argmin(axis=1)]
    assert len(distances) == 1071
    reaches("pinch distance, m", float(distances.mean()), 0.06)


@pytest.mark.usefixtures("light_evaluation")
def test_equal_requests_share_a_map_and_its_warnings(play, allegro, monkeypatch):
    """Also at the same time. Other settings, another method or other code do not."""
    trainings = []

    def counted(hand, recording, method, seed, device, settings):
        trainings.append(method)
        return train_map(hand, recording, method, seed, device, settings, show_progress=False)

    def cached(method="telekinesis", **settings):
        _, path = cached_map(allegro, play, method, settings=LIGHT[method] | settings)
        return path

    monkeypatch.setattr(retargeting_train, "train_map", counted)
    with ThreadPoolExecutor() as threads:  # locks keep threads apart like processes
        paths = [request.result() for request in [threads.submit(cached, points=16) for _ in range(2)]]
    paths += [cached(points=24), cached("geort", pinch_weight=2e3)]
    monkeypatch.setattr(retargeting_train, "source_digest", lambda *subpackages: "other")
    paths.append(cached(points=16))
    assert paths[0] == paths[1] and len(set(paths)) == len(trainings) == 4
    monkeypatch.setattr(retargeting_train, "check_fingertips", lambda *_: ["the ring finger never pinches"])
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="the ring finger never pinches"):
            cached(points=32)
    assert len(trainings) == 5
    with pytest.raises(UnknownNameError, match="setting of telekinesis 'speed'"):
        cached(speed=1)
