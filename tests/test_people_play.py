"""Synthetic play and a population of people: reproducible, and in the range that real recordings span."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from joint_angles import fitted_keypoints
from shared import synthesized

from geort_drake import read_recording, synthesize_play
from geort_drake.people.checks import examine
from geort_drake.people.coverage import fingertip_speeds, pinch_distances, tip_distances
from geort_drake.people.keypoints import FINGER_NAMES, bone_lengths, wrist_pose
from geort_drake.people.recording import PINCH_M
from geort_drake.people.synthetic import device, population
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.population import sample_person, sample_population

REAL = yaml.safe_load(Path(__file__).with_name("real_play.yaml").read_text("utf-8"))
# How far outside the two real recordings' figures the synthetic ones may be. The sideways motion of single
# fingers, which neighbours limit, is the least.
FACTOR = 1.5


def statistics(recording):
    """The figures of the table above, in its units."""
    p_HF = 1e3 * recording.fingertips()
    speed = 1e3 * fingertip_speeds(recording)
    near = np.stack(list(pinch_distances(recording).values()), axis=1) < PINCH_M
    covariance = np.stack([np.cov(p_HF[:, i].T) for i in range(5)])
    return {
        "principal_std": np.sqrt(np.linalg.eigvalsh(covariance)[:, ::-1].clip(0.0)),
        "speed_median": np.median(speed, axis=0),
        "speed_p95": np.percentile(speed, 95, axis=0),
        "pinch_share": 100 * near.mean(axis=0),
        "any_pinch_share": 100 * near.any(axis=1).mean(),
    }


@pytest.mark.parametrize(("name", "fixture"), [("GeoRT", "alex_npy"), ("MANUS", "manus_npz")])
def test_the_table_of_real_figures_is_right(name, fixture, request):
    """The embedded figures are those of the files, where these are at hand."""
    measured = statistics(read_recording(request.getfixturevalue(fixture)))
    for quantity, value in REAL[name].items():
        np.testing.assert_allclose(measured[quantity], value, atol=0.06, err_msg=quantity)


@pytest.fixture(scope="module")
def play():
    return synthesized(0, 60.0, 120.0)


@pytest.mark.parametrize(
    ("seed", "duration_s", "rate_hz"),
    [
        (0, 60.0, 120.0),
        pytest.param(0, 300.0, 120.0, marks=pytest.mark.slow),
        pytest.param(7, 300.0, 30.0, marks=pytest.mark.slow),
    ],
)
def test_play_lies_between_real_recordings(seed, duration_s, rate_hz):
    """Cloud thickness, speeds and pinch share within a factor of 1.5."""
    made = statistics(synthesized(seed, duration_s, rate_hz))
    for quantity in REAL["GeoRT"]:
        real = np.array([REAL[name][quantity] for name in REAL])
        assert (made[quantity] > real.min(axis=0) / FACTOR).all(), quantity
        assert (made[quantity] < real.max(axis=0) * FACTOR).all(), quantity


def test_play_does_not_depend_on_the_frame_rate():
    """Digits that meet slow the others down no more at 30 than at 120 Hz."""
    slow, fast = (synthesize_play(2, 15.0, rate_hz) for rate_hz in (30.0, 120.0))
    ratio = statistics(slow)["speed_p95"] / statistics(fast)["speed_p95"]
    assert (ratio > 0.9).all() and (ratio < 1.1).all()


def test_every_finger_is_pinched_and_the_tips_really_meet(play):
    """Each finger is within 15 mm of the thumb in 4–12 % of frames, 20–35 % in all, and touches to 5 mm."""
    made = statistics(play)
    assert ((made["pinch_share"] > 4) & (made["pinch_share"] < 12)).all()
    assert 20 < made["any_pinch_share"] < 35
    p_HF = play.fingertips()
    distance = np.linalg.norm(p_HF[:, 1:] - p_HF[:, :1], axis=-1)
    assert (distance.min(axis=0) < 0.005).all()
    # Held at varied places: where a finger is pinched spreads over centimetres.
    for finger in range(1, 5):
        places = p_HF[distance[:, finger - 1] < 0.012, finger]
        assert (places.std(axis=0).max() > 0.006) and (np.ptp(places, axis=0).max() > 0.03)


def test_play_is_fit_for_training_and_as_noisy_as_a_glove(play):
    """No warning; clouds are volumes; no jumps; second differences while slow below a glove's 0.27 mm."""
    assert len(play) == 7_200
    assert examine(play).metadata["warnings"] == []
    p_HF = play.fingertips()
    for i, finger in enumerate(FINGER_NAMES):
        assert len(np.unique(np.floor(1e3 * p_HF[:, i]).astype(int), axis=0)) > 1500, finger
    speed = np.linalg.norm(np.diff(p_HF, axis=0), axis=-1) * play.rate_hz
    assert speed.max() < 4.0
    second = 1e3 * np.linalg.norm(np.diff(p_HF, n=2, axis=0), axis=-1)
    assert 0.05 < np.median(second[speed[1:] < 0.02]) < 0.27


def test_the_seed_decides_everything():
    """Cached maps are found by this digest; a generator works as well, and other seeds differ."""
    digest = "ae7973e27f6f4940dd97f76d7a9d580cd4f37e7ca53f97c599a89706e3483760"
    assert synthesize_play(0, duration_s=10.0).digest == digest
    assert synthesize_play(np.random.default_rng(0), duration_s=10.0).digest == digest
    assert synthesize_play(1, duration_s=10.0).digest != digest
    assert synthesize_play(0, duration_s=1.0, side="left").side == "left"


def test_duration_rate_and_noise_are_arguments():
    """Frames follow duration and rate; without noise a faster rate samples the same motion.

    Where digits slide along each other, the step matters: a quarter of the frames differ.
    """
    slow = synthesize_play(1, duration_s=10.0, rate_hz=30.0, jitter=0.0)
    fast = synthesize_play(1, duration_s=10.0, rate_hz=120.0, jitter=0.0)
    assert (len(slow), len(fast)) == (300, 1200)
    equal = np.abs(fast.p_HK[::4] - slow.p_HK).max(axis=(1, 2)) < 1e-6
    assert equal.mean() > 0.6
    with pytest.raises(ValueError, match="must be positive"):
        synthesize_play(1, duration_s=0.0)


def test_a_hand_that_cannot_pinch_plays_without_pinches():
    """With the thumb held abducted no pinch is reached, none is faked, and play goes on."""
    hand = HumanHand.anatomical()
    upper = hand.upper.copy()
    upper[:4] = np.deg2rad([0, -20, 5, 5])
    made = statistics(synthesize_play(1, duration_s=20.0, hand=dataclasses.replace(hand, upper=upper)))
    assert made["any_pinch_share"] < 1
    assert (made["speed_p95"][1:] > 100).all()


def valid_frames(recording):
    return recording.p_HK[recording.valid].astype(float)


def lengths_of(p_HK):
    """Lengths of the fingers (5,) without their metacarpals, m."""
    return np.median(bone_lengths(p_HK), axis=0).reshape(5, 4)[:, 1:].sum(axis=1)


def hand_measures(recording):
    """Lengths and knuckles of a recorded hand, each a number with a name, m."""
    p_HK = valid_frames(recording)
    knuckle = np.median(p_HK[:, 1::4], axis=0)
    return by_finger(
        {"length": lengths_of(p_HK), **{f"knuckle {axis}": knuckle[:, i] for i, axis in enumerate("xyz")}}
    )


def motion_measures(recording):
    """Extents, speeds and pinches of a recording, each a number with a name; m, m/s."""
    p_HK = valid_frames(recording)
    chain = p_HK[:, 1:].reshape(-1, 5, 4, 3)
    length = lengths_of(p_HK)
    extents = np.percentile((chain[:, :, 3] - chain[:, :, 0]) / length[:, None], (3, 97), axis=0)
    speed = fingertip_speeds(recording)
    return by_finger(
        {
            **{f"lowest {axis}": extents[0, :, i] for i, axis in enumerate("xyz")},
            **{f"highest {axis}": extents[1, :, i] for i, axis in enumerate("xyz")},
            "median speed": np.median(speed, axis=0),
            "95th percentile of speed": np.percentile(speed, 95, axis=0),
            "closest pinch": np.append(np.nan, np.percentile(tip_distances(p_HK), 0.5, axis=0)),
        }
    )


def by_finger(named):
    """Figures with names, of five fingers each, as numbers with the fingers' names."""
    every = {
        f"{finger} {what}": value
        for what, values in named.items()
        for finger, value in zip(FINGER_NAMES, values, strict=True)
    }
    # The frame H fixes two coordinates of the middle knuckle; the thumb does not pinch itself.
    fixed = ("middle knuckle x", "middle knuckle y", "thumb closest pinch")
    return {name: value for name, value in every.items() if name not in fixed}


@pytest.fixture(scope="module")
def population_range():
    """Least and largest measures: of the motion of 100 people in eight seconds each, of 500 people's hands.

    The range of motion is widened by a twentieth on both sides, as so few and short recordings narrow it.
    Real measures lie inside the unwidened range of 500 people in 20 s each.
    """
    people = [sample_person(0, number).record(8.0 if number < 100 else 0.2, 30.0) for number in range(500)]
    result = {}
    for rows, widening in (
        ([motion_measures(person) for person in people[:100]], 0.05),
        ([hand_measures(person) for person in people], 0.0),
    ):
        for name in rows[0]:
            values = [row[name] for row in rows]
            margin = widening * np.ptp(values)
            result[name] = (min(values) - margin, max(values) + margin)
    return result


@pytest.mark.slow
@pytest.mark.parametrize("fixture", ["alex_npy", "manus_npz"])
def test_real_recordings_lie_inside_the_population(fixture, population_range, request):
    """All measures are between the least and the largest of the population."""
    recording = read_recording(request.getfixturevalue(fixture))
    real = hand_measures(recording) | motion_measures(recording)
    outside = [name for name, (low, high) in population_range.items() if not low < real[name] < high]
    assert outside == []


def test_hands_differ_from_childrens_to_large_mens():
    """Middle fingers span at least from 70 to 125 mm."""
    lengths = [sample_person(0, number).hand.lengths[2].sum() for number in range(200)]
    assert (min(lengths) < 0.070) and (max(lengths) > 0.125)


def test_the_seed_and_the_number_decide_a_person(monkeypatch):
    """Neither the count nor the number of processes matters; other seeds and numbers differ."""
    people = sample_population(3, 5, duration_s=2.0)
    assert (people.shape, people.dtype) == ((3, 60, 21, 3), np.float32)
    np.testing.assert_array_equal(sample_person(5, 1).record(2.0, 30.0).p_HK, people[1])
    assert not np.allclose(people[0], people[1])
    assert not np.allclose(sample_population(1, 6, duration_s=2.0), people[:1])
    with pytest.raises(ValueError, match="must be positive"):
        sample_population(0, 5)
    monkeypatch.setattr(population, "_MIN_PARALLEL", 2)
    monkeypatch.setattr(population, "usable_cores", lambda: 2)
    np.testing.assert_array_equal(sample_population(2, 5, duration_s=2.0), people[:2])


@pytest.mark.parametrize("number", range(2))
def test_joint_limits_hold_before_the_device_errs(number):
    """Angles within the limits reproduce what a device without errors measures."""
    person = sample_person(2, number)
    exact = device.Device(30.0, 1.0, np.zeros(5), np.zeros((5, 3)), np.zeros(3), jitter=1.0)
    p_HK = dataclasses.replace(person, device=exact).record(10.0).p_HK.astype(float)
    # The hand's own frame is not quite that which its knuckles span.
    R, _ = wrist_pose(person.hand.keypoints(person.rest))
    found = fitted_keypoints(person.hand, (p_HK @ R.T)[::10])
    np.testing.assert_allclose(found @ R, p_HK[::10], atol=1e-6)
