"""Checks of recordings: what leaves the meaning open is refused, the rest is reported in sentences."""

import dataclasses as dc
import re
import warnings
from collections import Counter
from itertools import combinations

import glove_files as gloves
import numpy as np
import pytest
from glove_files import FRAMES, moving

from geort_drake import read_recording, synthesize_play
from geort_drake.errors import GeortError, MismatchError, RecordingError
from geort_drake.people.checks import KEYPOINT_ORDER, ORDERS, fitting_order, require_wrist_frame_hand
from geort_drake.people.coverage import training_faults
from geort_drake.people.keypoints import FINGER_KEYPOINTS, mirrored, to_wrist_frame
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.population import sample_person


def keypoints(change):
    """The change of a hand that changes its p_HK (T, 21, 3)."""
    return lambda hand: dc.replace(hand, p_HK=change(hand.p_HK.copy()))


def put(place, value):
    def change(p):
        p[place] = value(p) if callable(value) else value
        return p

    return keypoints(change)


def exchanged(a, b):
    return keypoints(lambda p: p[:, [{a: b, b: a}.get(i, i) for i in range(21)]])


BREATHING = np.sin(0.05 * np.arange(FRAMES))[:, None, None]
RHD = "wrist, then each finger from tip to base (RHD)"
REFUSED = {
    "millimetres": (
        lambda h: dc.replace(h, p_HK=1e3 * h.p_HK, p_WH=1e3 * h.p_WH),
        r"60 to 110 mm, but is 8\d\.\d+ m; .* in mm: geort-drake recording convert FILE --unit mm",
    ),
    "mirrored axes": (keypoints(lambda p: p * [-1, 1, 1]), "bend backwards .* left hand or a right one"),
    "another order": (keypoints(lambda p: p[:, ORDERS[RHD]]), r"tip to base \(RHD\)"),
    "joints exchanged": (exchanged(7, 8), "no hand in any known order: keypoint 8"),
    "a fingertip lost": (put(np.s_[:, 8], np.nan), "400 of 400 frames show no hand or cannot be read"),
    "many frames lost": (
        put(np.s_[40:110], np.nan),
        "70 of 400 frames .* the first is 40; at most one in ten",
    ),
    "breathing bones": (keypoints(lambda p: p * (1 + 0.5 * BREATHING)), r"changes its length by 3\d%"),
    "stalled": (put(np.s_[80:], lambda p: p[80]), "319 of 400 frames repeat the one before"),
    "clock in milliseconds": (
        lambda h: dc.replace(h, t=1e3 * h.t),
        r"2 to 2000 frames in a second, but give 0\.06.* if times were multiplied by 0\.001",
    ),
    "a clock that jumps back": (
        lambda h: dc.replace(h, t=np.where(np.arange(FRAMES) < 200, h.t, h.t - 3.0)),
        "frames have no time, or one that does not increase",
    ),
}
REPORTED = {
    "noisy bones": (keypoints(lambda p: p * (1 + 0.08 * BREATHING)), "its length by [56]%"),
    "polled too fast": (put(np.s_[5::10], lambda p: p[4:-1:10]), "40 of 400 frames repeat the one before"),
    "stored twice": (
        lambda h: h.part(np.sort(np.append(np.arange(FRAMES), [30, 200]))),
        "2 of 402 frames are stored twice with the same time: left out",
    ),
    "frames dropped": (
        lambda h: h.part(np.arange(FRAMES)[np.arange(FRAMES) % 8 != 3]),
        "50 frames are missing",
    ),
    "a spike": (
        put(np.s_[100, 8], lambda p: p[100, 8] + [0.05, 0.0, 0.0]),
        "1 of 400 frames have (bones|a keypoint).* the first is frame 100: invalid",
    ),
    "one time wrong": (
        lambda h: dc.replace(h, t=np.where(np.arange(FRAMES) == 50, 1e6, h.t)),
        "1 of 400 frames have no time, or one that does not increase: left out",
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_recording_whose_meaning_is_open_is_refused(tmp_path, fault):
    """The message begins with the file and names the fault."""
    change, message = REFUSED[fault]
    path = gloves.write_openxr(tmp_path, change(moving()))
    with pytest.raises(RecordingError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(str(path))


@pytest.mark.parametrize("fault", REPORTED)
def test_a_repairable_recording_is_read_with_a_warning(tmp_path, fault):
    change, message = REPORTED[fault]
    recording = read_recording(gloves.write_openxr(tmp_path, change(moving())))
    (warning,) = recording.metadata["warnings"]
    assert re.search(message, warning)


@pytest.mark.parametrize(
    ("name", "contents", "message"),
    [
        ("a.npz", b"x", "not a readable NumPy file"),
        ("a.json", b'{"frames": [', "not JSON"),
        ("a.json", b'{"frames": 3}', "matches no known format"),
        ("a.json", b'{"joints": [[1], [1, 2]]}', "contains joints, which matches no known format"),
        ("a.csv", b"", "the table is empty"),
        ("a.csv", b"\xff\xfe\x00", "not a text file in UTF-8"),
        ("a.pkl", b"x", r"not '\.pkl'"),
        ("a.npy", b"version https://git-lfs.github.com/spec/v1\n", "not a readable NumPy file"),
    ],
)
def test_a_file_that_is_no_recording_is_refused(tmp_path, name, contents, message):
    (tmp_path / name).write_bytes(contents)
    with pytest.raises(RecordingError, match=message):
        read_recording(tmp_path / name)
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "none.npz")


def test_short_recordings_can_be_replayed_but_not_trained_on(tmp_path):
    """Training needs 300 frames and a pinch."""
    path = gloves.write_own(tmp_path, moving().part(np.arange(250)))
    assert "250 valid frames, training needs at least 300" in training_faults(read_recording(path))[0]
    with pytest.raises(RecordingError, match="250 valid frames"):
        read_recording(path, training=True)
    path = gloves.write_own(tmp_path, moving(pinch=False))
    with pytest.raises(RecordingError, match="thumb never comes within 15 mm of a finger"):
        read_recording(path, training=True)


@pytest.mark.parametrize("name", ORDERS)
def test_the_order_of_joints_is_named(name, rng):
    """In any frame, unit and side, also with a camera's noise."""
    p = moving().p_HK[:, ORDERS[name]] * [1, -1, 1] * rng.uniform(0.01, 1000)
    assert fitting_order(p)[0] == name
    assert fitting_order(p + rng.normal(0.0, 0.015 * np.abs(p).max(), p.shape))[0] == name


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("length_m", "breadth_m"), [(0.15, 0.07), (0.21, 0.1)])
def test_valid_recordings_have_the_expected_joint_order(length_m, breadth_m, side):
    """Of several people, either side, straight, in motion, in a fist, and as a camera sees them."""
    hand = HumanHand.anatomical(length_m, breadth_m)
    p_HK = synthesize_play(1, duration_s=10.0, rate_hz=30.0, hand=hand).p_HK.astype(float)
    fist = np.where([name.endswith("flexion") for name in hand.joint_names], hand.upper, 0.0)
    for p in (p_HK, p_HK[:5], hand.keypoints(np.zeros((5, 20))), hand.keypoints(fist[None].repeat(5, 0))):
        seen = mirrored(p) if side == "left" else p
        assert fitting_order(seen)[0] == KEYPOINT_ORDER
        assert (
            fitting_order(seen + np.random.default_rng(0).normal(0.0, 0.003, seen.shape))[0] == KEYPOINT_ORDER
        )


@pytest.mark.parametrize("p_HK", [np.zeros((0, 21, 3)), np.full((9, 21, 3), np.nan)], ids=["empty", "lost"])
def test_a_file_without_a_hand_is_refused_without_numpy_warnings(p_HK, tmp_path):
    np.save(tmp_path / "hand.npy", p_HK)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RecordingError, match=r"at least 2 frames|show no hand"):
            read_recording(tmp_path / "hand.npy")


@pytest.mark.parametrize("unit", [("mm", 1e3), ("cm", 1e2), ("inch", 1 / 0.0254), ("dm", 10.0)])
def test_programs_refuse_keypoints_in_another_unit(unit):
    """For one frame and for many; the message names the unit."""
    name, scale = unit
    for p_HK in (moving().p_HK, moving().p_HK[7]):
        require_wrist_frame_hand(p_HK)
        with pytest.raises(RecordingError, match=f"my glove: wrist to .* if lengths were in {name}"):
            require_wrist_frame_hand(scale * p_HK, "my glove")


def test_programs_refuse_keypoints_that_are_not_in_the_wrist_frame():
    """World landmarks, a shifted wrist, another side, another order, another shape, and no number."""
    hand = moving()
    for p in (gloves.mediapipe_points(hand), hand.p_HK + [0.0, 0.02, 0.0], hand.p_HK @ np.eye(3)[[1, 2, 0]]):
        with pytest.raises(RecordingError, match="must be given in the wrist frame H"):
            require_wrist_frame_hand(p)
    with pytest.raises(MismatchError, match="of the other side"):
        require_wrist_frame_hand(hand.p_HK * [-1, 1, 1])
    for p in (hand.p_HK[:, ORDERS[RHD]], hand.p_HK[:, :20], np.full((21, 3), np.nan), np.zeros((21, 3))):
        with pytest.raises(GeortError, match="human points: "):
            require_wrist_frame_hand(p)


def test_sound_people_are_accepted_in_every_posture():
    """Straight, in a fist, hyperextended, spread."""
    hand = HumanHand.anatomical()
    for theta in (np.zeros(20), 0.9 * hand.upper, 0.9 * hand.lower):
        require_wrist_frame_hand(hand.keypoints(theta))
    require_wrist_frame_hand(synthesize_play(0, 5.0, 30.0).p_HK)


def measured_hands(count, frames):
    """Hands (T, 21, 3), m, of synthetic people as devices see them, between two postures of their range."""
    rng, share = np.random.default_rng(0), np.linspace(0.0, 1.0, frames)[:, None]
    for number in range(count):
        person = sample_person(1000, number)
        first, last = person.hand.lower + rng.uniform(size=(2, 20)) * (person.hand.upper - person.hand.lower)
        theta = (1.0 - share) * first + share * last
        yield person.device.measure(person.hand.keypoints(theta), 30.0, rng)


def swapped(a, b):
    order = list(range(21))
    for i, j in zip(FINGER_KEYPOINTS[a], FINGER_KEYPOINTS[b], strict=True):
        order[i], order[j] = j, i
    return order


def adjacent(joint):
    return [{joint: joint + 1, joint + 1: joint}.get(i, i) for i in range(21)]


def test_no_measured_person_is_refused():
    """In any posture of their range, by the cheapest camera; 100 people, each by 30 frames."""
    for p_HK in measured_hands(100, 30):
        require_wrist_frame_hand(p_HK)


def test_what_is_wrong_with_a_measured_person_is_refused():
    """Other units, mirrored axes, another side, published orders, exchanged fingers and joints."""
    orders = [*list(ORDERS.values())[1:], *(adjacent(joint) for joint in (1, 2, 3, 5, 6, 7, 18))]
    orders += [swapped(*pair) for pair in combinations(FINGER_KEYPOINTS, 2)]
    accepted: Counter = Counter()
    for p_HK in measured_hands(15, 30):
        wrong = {scale: scale * p_HK for scale in (1e3, 1e2, 10.0, 1 / 0.0254)}
        wrong |= {"mirrored axes": p_HK * [-1, 1, 1], "left": to_wrist_frame(mirrored(p_HK))}
        wrong |= {str(order): p_HK[:, order] for order in orders}
        for fault, p in wrong.items():
            try:
                require_wrist_frame_hand(p)
            except GeortError:
                continue
            accepted[fault] += 1
    assert not accepted
