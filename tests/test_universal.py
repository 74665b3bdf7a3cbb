"""The universal map: weights, calls, file, the person it follows, and the fit to one person."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from retargeting_toy import toy_kinematics

from geort_drake import HandModel, load_retargeter, refit_checkpoint, synthesize_play
from geort_drake.cli import run_command
from geort_drake.comparison.metrics import evaluate_frames
from geort_drake.errors import CheckpointError, GeortError, RecordingError
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.population import sample_person
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.map_file import load_map, shipped_maps
from geort_drake.retargeting.methods.coupled.universal_network import UniversalNetwork
from geort_drake.retargeting.person_code import AveragePerson, observe
from geort_drake.retargeting.person_observer import RECENT, WINDOW, PersonObserver
from geort_drake.retargeting.universal import UniversalRetargeter

MAP = shipped_maps()["allegro_right"]
RETARGET = load_retargeter(MAP)
FINGERS = RETARGET.finger_names
PLAY = synthesize_play(seed=1, duration_s=12.0, rate_hz=100.0).p_HK.astype(float)


@pytest.mark.parametrize("fingers", [("index", "thumb"), ("thumb", "index", "middle", "ring", "little")])
def test_a_persons_map_is_the_network_with_their_code(fingers):
    """Folding the person into random weights changes nothing, for the average person and for an odd one."""
    generator, hand, seen = torch.Generator().manual_seed(0), toy_kinematics(fingers), observe(PLAY, fingers)
    average = AveragePerson(seen.mean, seen.scatter / seen.places[:, None, None], 20.0, 40.0)
    code = torch.tensor(average.code(seen)).double()
    codes = code * (1.0 + 0.05 * torch.randn(50, len(code), generator=generator))
    pairs = [(fingers.index("thumb"), other) for other, name in enumerate(fingers) if name != "thumb"]
    x = torch.randn(50, len(fingers), 3, generator=generator)
    network = UniversalNetwork(hand, codes, x, pairs, generator)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    network = network.float().double()
    names = fingers, hand.joint_names, [TIP_KEYPOINT[name] for name in fingers]
    arrays = network.arrays() | average.arrays()
    retarget = UniversalRetargeter(arrays, *names, hand.lower, hand.upper, "numpy")
    for frames in (PLAY, 1.3 * PLAY[:5]):
        code, own = retarget.code(frames), retarget.for_person(frames)
        p_HF = frames[::251, list(retarget.human_keypoints)]
        with torch.no_grad():
            wanted = network(torch.tensor(p_HF)[None], torch.tensor(code)[None].double())[0]
        np.testing.assert_allclose(own(p_HF), wanted, atol=1e-7)  # torch's limits are float32


def test_it_works_at_once_and_as_one_persons_map():
    """A call takes the shape from its frames; a person's map also takes fingertips and has a Jacobian."""
    own = RETARGET.for_person(PLAY)
    np.testing.assert_allclose(RETARGET(PLAY), own(PLAY))
    np.testing.assert_allclose(RETARGET(PLAY[0]), RETARGET(PLAY[:1])[0])
    np.testing.assert_allclose(RETARGET.for_person(PLAY[0])(PLAY), RETARGET.for_person(PLAY[:1])(PLAY))
    tips = PLAY[0, list(RETARGET.human_keypoints)]
    np.testing.assert_allclose(own(tips), own(PLAY[0]))
    assert own.jacobian(tips).shape == (16, 4, 3)
    assert own.trained_space.distances(PLAY[7]).max() < 0.01
    compiled = load_retargeter(MAP, backend="numba").for_person(PLAY)
    np.testing.assert_allclose(compiled(tips), own(tips), atol=1e-9)


def test_it_refuses_what_shows_no_person():
    """Fingertips alone, no frames, NaN, and points without a hand."""
    with pytest.raises(ValueError, match="for_person"):
        RETARGET(PLAY[0, :4])
    for call, frames in ((RETARGET, PLAY[:0]), (RETARGET.for_person, PLAY[0, :4])):
        with pytest.raises(ValueError, match="whole hands"):
            call(frames)
    for frame, message in ((np.full((21, 3), np.nan), "finite"), (np.zeros((21, 3)), "hardly any length")):
        with pytest.raises(GeortError, match=message):
            RETARGET(frame)


def test_a_person_unlike_all_others_is_clamped_and_named():
    """The part farthest out is said, and how far."""
    code = RETARGET.code(PLAY)
    assert RETARGET.unusual(code) == ""
    odd = code.copy()
    odd[len(FINGERS) * 3 + 1] *= 10.0  # the index finger's length
    assert RETARGET.unusual(odd).startswith("length of the index: ")
    assert np.isfinite(RETARGET.folded(odd)(PLAY)).all()


def test_a_file_gives_the_map_back_and_one_that_is_no_map_is_refused(tmp_path):
    """In single precision, with the names of its hands; a shipped name lists the choices when unknown.

    Refused is a file that is damaged, of another format, or without an array.
    """
    path, file = tmp_path / "map.safetensors", load_map(MAP)
    arrays = {name: array.astype(float) for name, array in file.arrays.items()}
    dataclasses.replace(file, arrays=arrays, hands={"toy": "0"}).save(path)
    np.testing.assert_array_equal(load_retargeter(path)(PLAY), RETARGET(PLAY))
    assert load_map(path).hands == {"toy": "0"} and load_map(path).arrays["bias1"].dtype == np.float32
    with pytest.raises(CheckpointError, match=r"neither a checkpoint.*shipped"):
        load_retargeter("allegro_middle")
    whole = path.read_bytes()
    for contents, message in (
        (whole[:-9], "not a safetensors file"),
        (whole.replace(b'"format":"1"', b'"format":"7"'), "format is 7"),
        (whole.replace(b"code_bias0", b"code_biasX"), "'code_bias0' is missing"),
        (whole.replace(b'\\"thumb\\"', b'\\"thing\\"'), "unknown 'thing'"),
    ):
        path.write_bytes(contents)
        with pytest.raises(CheckpointError, match=message):
            load_retargeter(path)


@pytest.mark.parametrize("name", ["allegro_right", "allegro_left", "leap_right"])
def test_the_shipped_map_serves_an_unseen_person_from_the_first_second(name):
    """A person whom the training has not seen: fingertips move as theirs do, and most pinches close."""
    hand = HandModel(name)
    retarget = load_retargeter(name, hand)
    recording = sample_person(0, 803).record(20.0, rate_hz=30.0)
    own = retarget.for_person(recording.p_HK[:30].astype(float))
    p_HF = recording.fingertips(hand.description.human_keypoints)
    metrics, _ = evaluate_frames(own, hand, p_HF, recording.rate_hz)
    assert metrics["motion_preservation"] > 0.94
    assert metrics["pinch"]["closed"] > 0.9


def observer_of(frames, observer=None):
    observer = observer or PersonObserver.empty(FINGERS)
    for p_HK in frames:
        observer = observer.seeing(p_HK)
    return observer


@pytest.mark.parametrize("count", [1, 300])
def test_frame_by_frame_is_as_all_at_once(count):
    """As long as the window holds all frames; an observer is not changed by those made of it."""
    start = observer_of(PLAY[:1])
    observer = observer_of(PLAY[1:count], start)
    for part, given in vars(observer.observation()).items():
        np.testing.assert_allclose(given, getattr(observe(PLAY[:count], FINGERS), part), atol=1e-12)
    np.testing.assert_array_equal(start.places, 1)
    # Memory is bounded, as shapes are those of the last frames; a still hand shows no new place.
    observer = observer_of([PLAY[0]] * (WINDOW + 5))
    assert len(observer.shapes) == WINDOW
    np.testing.assert_array_equal(observer.places, 1)


def test_another_person_is_noticed_and_the_same_one_is_not():
    """A hand 7 % larger is; a camera's noise is not."""
    camera = next(person for person in (sample_person(5, n) for n in range(40)) if person.device.is_camera)
    for frames in (PLAY[::2], camera.record(8.0, 30.0).p_HK.astype(float)):
        observer = observer_of(frames[: 3 * RECENT])
        for p_HK in frames[3 * RECENT :]:
            observer = observer.seeing(p_HK)
            assert not observer.has_changed()
    observer = observer_of(PLAY[: 2 * RECENT])
    assert observer_of(1.07 * PLAY[:RECENT], observer).has_changed()


def test_the_command_writes_an_ordinary_checkpoint(tmp_path, monkeypatch):
    """It loads, starts from the universal map, knows the person's fingertips, and names its origin."""
    monkeypatch.setattr("geort_drake.comparison.metrics.ROBOT_SAMPLES", 2_000)
    hand = synthesize_play(5, 40.0, 30.0)
    hand.save(tmp_path / "hand.npz")
    shutil.copy(MAP, tmp_path / "map.safetensors")
    monkeypatch.chdir(tmp_path)
    run_command("refit", ["hand.npz", "own", "--map", "map.safetensors", "--steps", "1"])
    retarget, checkpoint = load_retargeter("own"), load_checkpoint("own")
    folded = load_retargeter("map.safetensors").for_person(hand.p_HK)
    assert np.abs(retarget(hand.p_HK[:30]) - folded(hand.p_HK[:30])).max() < 0.2  # after one step
    assert retarget.trained_space.distances(hand.p_HK[100]).max() < 0.012
    assert checkpoint.provenance["map"]["name"] == "map.safetensors"
    assert checkpoint.provenance["recording"]["sha256"] == hand.digest
    assert json.loads((tmp_path / "own" / "metrics.json").read_text())["recording_sha256"] == hand.digest
    with pytest.raises(CheckpointError, match="a universal map is needed"):
        refit_checkpoint(hand, "other", map_file="own")


def test_hands_without_a_map_and_other_hands_are_refused(tmp_path, monkeypatch):
    """A robot hand that no map is shipped for, one that the map is not for, and the person's other hand."""
    monkeypatch.setattr("geort_drake.comparison.refit.shipped_maps", lambda: {})
    play = synthesize_play(5, 12.0, 30.0)
    with pytest.raises(CheckpointError, match=r"shipped for allegro_right.*geort-drake pretrain"):
        refit_checkpoint(play, tmp_path / "x")
    with pytest.raises(CheckpointError, match="the map is for another hand"):
        refit_checkpoint(play, tmp_path / "x", "leap_right", MAP)
    left = synthesize_play(5, 12.0, 30.0, side="left")
    with pytest.raises(RecordingError, match="of a left hand, the robot's is a right hand"):
        refit_checkpoint(left, tmp_path / "x", map_file=MAP)
