"""A human hand's digits do not pass through one another: distances, stopping, sliding, and recordings."""

import numpy as np
import pytest

from geort_drake import read_recording, synthesize_play
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.play import pinch_postures
from geort_drake.people.synthetic.population import sample_person
from geort_drake.people.synthetic.solid import DIGIT_PAIRS, MAX_INTERPENETRATION, SolidHand

HAND = HumanHand.anatomical()
SOLID = SolidHand(HAND)


def flat_hand(abduction_deg):
    """Straight fingers, spread by the given angle of the index finger; the thumb far out."""
    theta = np.zeros((5, 4))
    theta[0] = np.deg2rad([50, -20, 0, 0])
    theta[1, 0] = np.deg2rad(abduction_deg)
    return theta.ravel()


def pinch():
    """A posture whose pads of thumb and index finger touch, and their contact's normal towards the thumb."""
    theta = SOLID.separate(pinch_postures(HAND, 1, np.random.default_rng(0))[0, 0])
    for _ in range(20):  # close what gap is left
        p_HF = HAND.fingertips(theta)
        p_HF[:2] = p_HF[:2].mean(axis=0)
        theta, touching = SOLID.move(theta, theta + 0.2 * (HAND.solve_fingertips(p_HF, theta) - theta))
    assert touching[:2].all()
    proximity = SOLID._proximity(theta)
    (normal,) = proximity.separation([int(np.argmax(proximity.depth))])
    return theta, normal / np.linalg.norm(normal)


def test_depth_is_that_of_two_capsules():
    """Parallel straight fingers are apart by their knuckles' distance less both radii."""
    hand = HumanHand(
        p_HB=np.array([[0.0, 0.3, 0.0], *([0.0, -0.02 * i, 0.1] for i in range(4))]),
        R_HB=np.stack([np.eye(3)] * 5),
        twist=np.zeros(5),
        lengths=HAND.lengths,
        lower=HAND.lower,
        upper=HAND.upper,
    )
    solid = SolidHand(hand)
    depths = dict(zip(DIGIT_PAIRS, solid.depths(np.zeros(20)), strict=True))
    radii = solid.radii[:, 0]
    for i, j in ((1, 2), (2, 3), (3, 4), (1, 3)):
        assert depths[i, j] == pytest.approx(radii[i] + radii[j] - 0.02 * (j - i), abs=1e-12)
    assert max(depths[0, i] for i in range(1, 5)) < -0.2


def test_keypoints_and_joint_angles_give_the_same_depths():
    """In random postures, to rounding, also for a batch with two leading axes."""
    theta = np.random.default_rng(0).uniform(HAND.lower, HAND.upper, (4, 50, 20))
    depths = SOLID.depths(theta)
    assert depths.shape == (4, 50, 10)
    np.testing.assert_allclose(SOLID.keypoint_depths(HAND.keypoints(theta)), depths, atol=1e-12)


def ask(theta, shift, calls=100):
    """Asks thumb and index finger of a posture to shift their tips (2, 3), m; returns posture and touch."""
    wanted = HAND.fingertips(theta)
    wanted[:2] += shift
    for _ in range(calls):
        goal = HAND.solve_fingertips(wanted, theta)
        theta, touching = SOLID.move(theta, theta + np.clip(goal - theta, -0.02, 0.02))
        assert SOLID.depths(theta).max() <= MAX_INTERPENETRATION
    return theta, touching


def test_thumb_and_finger_stop_at_each_other_however_far_they_want_to_go():
    """Tips asked to pass each other by 24 mm hardly move; both digits feel it; opening frees them."""
    theta, normal = pinch()
    before = HAND.fingertips(theta)
    pressed, touching = ask(theta, 0.012 * np.array([-normal, normal]))
    np.testing.assert_array_equal(touching, [True, True, False, False, False])
    assert np.abs(HAND.fingertips(pressed) - before)[:2].max() < 0.004
    opened, touching = ask(pressed, 0.015 * np.array([normal, -normal]))
    assert not touching.any()
    assert (HAND.fingertips(opened) - HAND.fingertips(pressed))[0] @ normal > 0.01


def test_pads_slide_when_they_are_moved_sideways_by_more_than_they_press():
    """Asked for 3 mm of pressure and 15 mm to the side, the thumb slides; for 20 mm and 3, it sticks."""
    theta, normal = pinch()
    sideways = np.cross(normal, [1.0, 0.0, 0.0])
    sideways /= np.linalg.norm(sideways)
    moved = {}
    for press, side in ((0.0015, 0.015), (0.010, 0.003)):
        reached, _ = ask(theta, np.array([side * sideways - press * normal, press * normal]))
        change = HAND.fingertips(reached) - HAND.fingertips(theta)
        moved[press] = (change[0] - change[1]) @ sideways
    assert moved[0.0015] > 0.007
    assert moved[0.010] < 0.003


def test_a_large_step_does_not_jump_through_a_finger():
    """The index finger asked to be beyond the middle one in one call stays on its own side of it."""
    theta = flat_hand(10.0)
    beyond = theta.copy()
    beyond[4] = np.deg2rad(-45.0)
    reached, touching = SOLID.move(theta, beyond)
    p_HF = HAND.fingertips(reached)
    assert p_HF[1, 1] > p_HF[2, 1]
    assert touching[1] and touching[2]
    assert SOLID.depths(reached).max() <= MAX_INTERPENETRATION


def test_random_motion_never_interpenetrates():
    """Of 500 steps towards random postures, none ends deeper than 2 mm."""
    rng = np.random.default_rng(1)
    theta, goal = SOLID.separate(np.zeros(20)), np.zeros(20)
    for step in range(500):
        if step % 40 == 0:
            goal = rng.uniform(HAND.lower, HAND.upper)
        theta, _ = SOLID.move(theta, theta + np.clip(goal - theta, -0.1, 0.1))
        assert SOLID.depths(theta).max() <= MAX_INTERPENETRATION


# Shift of the thumb, mm, by which the glove misplaces its base; see `geort_drake.people.synthetic.solid`.
DEVICE_OFFSET_MM = {"alex_npy": (2.7, 5.0, -4.5), "manus_npz": (-3.4, 7.0, -1.1)}


@pytest.mark.parametrize("fixture", DEVICE_OFFSET_MM)
def test_real_hands_are_solid(fixture, request):
    """After the device's offset, at most 1 % of a recording's frames interpenetrate by more than 2 mm."""
    recording = read_recording(request.getfixturevalue(fixture))
    p_HK = recording.p_HK[recording.valid].astype(float)
    solid = SolidHand(HumanHand.fit(recording))
    p_HK[:, 1:5] += 1e-3 * np.array(DEVICE_OFFSET_MM[fixture])
    assert (solid.keypoint_depths(p_HK).max(axis=1) > MAX_INTERPENETRATION).mean() < 0.01


@pytest.mark.parametrize("rate_hz", [30.0, 120.0])
def test_synthetic_play_is_solid(rate_hz):
    """No frame interpenetrates by more than 2 mm, and the hand is no faster than people are."""
    recording = synthesize_play(3, 30.0, rate_hz)
    assert SOLID.keypoint_depths(recording.p_HK.astype(float)).max() < MAX_INTERPENETRATION + 1e-6
    speed = np.linalg.norm(np.diff(recording.fingertips(), axis=0), axis=-1) * rate_hz
    assert speed.max() < 4.0


@pytest.mark.parametrize("number", [0, 1, 3, 7])
def test_the_population_is_solid(number):
    """As its device shows it without noise, no person's hand interpenetrates in 99 % of the frames."""
    person = sample_person(0, number)
    timeline = person._play(20.0, np.random.default_rng([0, number, 1]))
    theta = timeline.motion(np.arange(600) / 30.0, np.zeros((600, 20)))
    depths = SolidHand(person.hand).depths(theta).max(axis=1)
    assert (depths > MAX_INTERPENETRATION).mean() < 0.01
