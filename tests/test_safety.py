"""What comes out of retargeting and arm is safe, whatever is sent; a good glove goes through unchanged."""

import math

import numpy as np
import pytest
from faults.sound import TIPS, play, smooth_retargeter
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw
from system_bench import Bench

from geort_drake.retargeting.clouds import trained_points
from geort_drake.systems import retargeting_status
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.retargeting_system import EASING, LIMITED, OUTSIDE, SETTLING, TRACKING
from geort_drake.systems.wrist_to_arm import WRIST_JUMPED, WRIST_NOT_FINITE

PLAY = play()


def test_a_joint_stops_at_a_far_target_without_overshoot():
    """It arrives in the time of the fastest motion: full speed for the way, and once from and to rest."""
    limits = JointLimits(np.zeros(1), np.full(1, 2.0), 5.0, 100.0)
    q, v, target = np.zeros(1), np.zeros(1), np.full(1, 1.5)
    times = []
    for step in range(1000):
        q, v = limits.step(q, v, target, target, 0.001)
        assert q[0] <= 1.5 + 1e-12
        if q[0] > 1.5 - 1e-9:
            times.append(0.001 * (step + 1))
    assert times[0] == pytest.approx(1.5 / 5.0 + 5.0 / 100.0, abs=0.003)


def answered(retarget) -> tuple[np.ndarray, np.ndarray]:
    """Joint targets and states at every frame of the play."""
    bench = Bench(retarget, ease_at_start=False, start=retarget(PLAY.p_HK[0]))
    ticks = [bench.tick(keypoints) for keypoints in PLAY.p_HK]
    return np.array([q for q, *_ in ticks]), np.array([status.state for *_, status in ticks])


def test_a_clean_stream_comes_out_as_the_bare_retargeter_gives_it():
    """Bit for bit, while the joints can follow; with a map too steep for the hand, the status says so."""
    retarget = smooth_retargeter()
    q, states = answered(retarget)
    np.testing.assert_array_equal(q, [retarget(keypoints) for keypoints in PLAY.p_HK])
    assert set(states) == {TRACKING}
    steep = smooth_retargeter(10.0)
    q, states = answered(steep)
    touched = (q != [steep(keypoints) for keypoints in PLAY.p_HK]).any(axis=1)
    assert touched.any()
    np.testing.assert_array_equal(touched, states == LIMITED)


def hands(count: int, start: int = 0) -> np.ndarray:
    return PLAY.p_HK[start : start + count].astype(float)


def test_the_hand_does_not_jump_at_the_start():
    """It waits for steady input, and follows with growing speed until it has caught up."""
    bench = Bench()
    states, speeds = [], []
    for number, keypoints in enumerate(hands(100)):
        _, v, status = bench.tick(keypoints)
        states.append(status.state)
        speeds.append(np.abs(v).max())
        if status.state == EASING:
            assert speeds[-1] <= 7.0 * (number - 2) * 0.01 / 0.5 + 1e-9
    assert states[:4] == [SETTLING] * 3 + [EASING]
    assert states[-1] == TRACKING
    assert not any(speeds[:3])


@pytest.mark.parametrize(
    ("fault", "state"),
    [
        ({"valid": 0.0}, retargeting_status.HELD_LOST),
        ({"nan": True}, retargeting_status.HELD_NOT_FINITE),
        ({"scale": 1000.0}, retargeting_status.HELD_OUT_OF_RANGE),
        ({"shift": 0.08}, retargeting_status.HELD_JUMPED),
        ({"stamp": -1.0}, retargeting_status.HELD_CLOCK),
        ({"stamp": np.nan}, retargeting_status.HELD_NOT_FINITE),
    ],
)
def test_a_fault_is_named_and_holds_the_joints_which_then_ease_back(fault, state):
    """The status says what and since when; afterwards the hand follows again, slowly at first."""
    bench = Bench(ease_at_start=False, stamped=True)
    for number, keypoints in enumerate(hands(60)):
        bench.tick(keypoints, stamp=0.01 * number)
    held = []
    for number, keypoints in enumerate(hands(40, 60)):
        frame = keypoints * fault.get("scale", 1.0) + fault.get("shift", 0.0) * (number % 2)
        frame[0, 0] = np.nan if "nan" in fault else frame[0, 0]
        stamp = 0.6 + 0.01 * number
        q, _, status = bench.tick(frame, fault.get("valid", 1.0), stamp + number * fault.get("stamp", 0.0))
        held.append((q, status))
    assert held[-1][1].state == state if "shift" not in fault else held[-1][1].state in (state, SETTLING)
    if fault == {"valid": 0.0}:
        assert held[-1][1].since == pytest.approx(0.6)  # not when it was last seen
    np.testing.assert_array_equal(held[-1][0], held[5][0])
    ticks = [bench.tick(keypoints, stamp=1e3 + number) for number, keypoints in enumerate(hands(100, 400))]
    states = [status.state for *_, status in ticks]
    assert states[0] in (SETTLING, retargeting_status.HELD_JUMPED)
    assert EASING in states
    assert states[-1] == TRACKING


def test_a_foreign_hand_is_reported_and_the_persons_own_is_not():
    """Synthetic play of another seed is inside; the same hand 30 % larger is outside, and still followed."""
    points = trained_points(PLAY.p_HK[:, list(TIPS)])
    retarget = smooth_retargeter()
    retarget.trained_points = points
    bench = Bench(retarget, ease_at_start=False)
    *_, status = [bench.tick(keypoints) for keypoints in hands(60)][-1]
    assert status.state == TRACKING and status.distance < 0.01
    bench = Bench(retarget, ease_at_start=False)
    q, *_, status = [bench.tick(keypoints) for keypoints in 1.3 * hands(60)][-1]
    assert status.state == OUTSIDE and status.distance > 0.02
    np.testing.assert_array_equal(q, retarget(1.3 * hands(60)[-1]))
    *_, status = Bench(smooth_retargeter(), ease_at_start=False).tick(hands(1)[0])
    assert np.isnan(status.distance)


def test_old_keypoints_are_not_followed():
    """Where their time is known, keypoints that are not renewed are stale after 0.2 s."""
    bench = Bench(ease_at_start=False, stamped=True)
    for number in range(60):
        *_, status = bench.tick(hands(60)[min(number, 20)], stamp=0.01 * min(number, 20))
        assert (status.state == retargeting_status.HELD_STALE) == (number > 40)


def test_a_frozen_glove_is_named_and_what_follows_is_eased():
    """Its last keypoints are still reached; the jump after it is taken slowly."""
    bench = Bench(ease_at_start=False)
    for _ in range(80):
        q, _, status = bench.tick(hands(1)[0])
    assert (status.state, status.since) == (retargeting_status.FROZEN, pytest.approx(0.51))
    np.testing.assert_array_equal(q, smooth_retargeter()(hands(1)[0]))
    *_, v, status = bench.tick(hands(1)[0] + 0.01)
    assert status.state == EASING
    assert np.abs(v).max() <= 7.0 * 0.01 / 0.28 + 1e-9


def test_the_low_pass_delays_as_it_says():
    """A slow ramp comes out `delay` later."""
    bench = Bench(lambda p_HK: np.full(16, 10.0 * p_HK[4, 0]), ease_at_start=False, cutoff=3.0)
    assert bench.system.delay == pytest.approx(1 / (2 * np.pi * 3.0), rel=0.1)
    for number in range(200):
        q, *_ = bench.tick(np.full((21, 3), 5e-4 * number))
    np.testing.assert_allclose(q, 10 * 5e-4 * (199 - bench.system.delay / 0.01), rtol=1e-6)


def test_settings_that_make_no_sense_are_refused():
    for value in (np.inf, np.nan, -1.0, 1e-300):
        with pytest.raises(ValueError, match="cutoff must be 0, or from"):
            Bench(cutoff=value)
        with pytest.raises(ValueError, match=r"period must be from 1e-05 to 10 s, not"):
            Bench(period=value)
    with pytest.raises(ValueError, match=r"latency must be from 0 to 10 s, not"):
        Bench(latency=np.nan)


@settings(max_examples=30, deadline=None)
@given(
    period=st.sampled_from([1e-5, 0.01, 10.0]),
    speed=st.sampled_from([1e-6, 7.0, 1e12]),
    acceleration=st.sampled_from([1e-6, 700.0, 1e12]),
    cutoff=st.sampled_from([0.0, 1e-3, 1e6]),
    latency=st.sampled_from([0.0, 1e-300, 10.0]),
)
def test_the_output_is_finite_at_the_ends_of_what_is_accepted(period, speed, acceleration, cutoff, latency):
    """Neither overflow nor a division by nothing gets into a command."""
    limits = JointLimits(np.full(16, -100.0), np.full(16, 100.0), speed, acceleration)
    bench = Bench(lambda p: np.full(16, 1e308 * np.sign(p[8, 0] - 0.02)), period, limits=limits,
                  cutoff=cutoff, latency=latency, ease_at_start=False)  # fmt: skip
    bench.period = bench.system.period
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(retargeting_status, "MAX_SPEED", 1e9)
        for keypoints in PLAY.p_HK[:200:4]:
            q, v, _ = bench.tick(keypoints)
            assert np.isfinite([*q, *v, bench.system.delay]).all()
            assert (np.abs(q) <= 100.0).all() and (np.abs(v) <= speed * (1 + 1e-9)).all()


def reach(tick: int) -> RigidTransform:
    """A wrist that goes 0.4 m up and back in a second and a half, and turns meanwhile."""
    way = 0.5 - 0.5 * math.cos(2 * math.pi * tick * PERIOD / 1.5)
    return RigidTransform(RollPitchYaw(0.3 * way, 0.0, 0.4 * way), [-0.1 * way, 0.1 * way, 0.4 * way])


def test_a_disengaged_arm_brakes_and_stays():
    """Within its limits, from full motion; however far the hand was behind the wrist, it goes no farther."""
    bench = ArmBench()
    path = [bench.tick(reach(min(tick, 40)), valid=float(tick < 40))[:2] for tick in range(200)]
    assert np.abs(path[39][1]).max() > 0.3
    assert not bench.broken
    # From full speed to rest at the lowest acceleration takes 2.6 rad/s over 7.5 rad/s².
    stop = 40 + round(0.35 / PERIOD)
    for q, v in path[stop:]:
        np.testing.assert_array_equal(v, 0.0)
        np.testing.assert_array_equal(q, path[stop][0])
    # Braking alone: no farther than speed²/2a at the arm's lowest acceleration, and a step.
    assert np.abs(path[-1][0] - path[39][0]).max() <= np.abs(path[39][1]).max() ** 2 / 15.0 + 0.02


@pytest.mark.parametrize("gap", [5, 100], ids=["while it brakes", "at rest"])
def test_an_arm_that_is_engaged_again_does_not_jump(gap):
    """Wherever the wrist is by then: the hand stays where it was held."""
    bench = ArmBench()
    far = RigidTransform([0.5, -0.2, 0.1])
    for tick in range(40):
        bench.tick(reach(tick))
    for _ in range(gap):
        q, *_ = bench.tick(far, valid=0.0)
    held = bench.hand_position(q)
    for _ in range(100):
        q, *_ = bench.tick(far)
        assert np.linalg.norm(bench.hand_position(q) - held) < (0.1 if gap == 5 else 1e-3)
    assert np.linalg.norm(bench.hand_position(q) - held) < 5e-3
    assert not bench.broken


@pytest.mark.parametrize("turn", [0.0, *(pytest.param(turn, marks=pytest.mark.slow) for turn in (1.0, -1.0))])
def test_the_arms_links_stay_off_the_table(turn):
    """However low and far the wrist goes; the hand itself may touch what lies on the table."""
    bench = ArmBench()
    clearance = []
    for tick in range(400):
        way = 0.5 - 0.5 * math.cos(math.pi * min(tick, 200) / 200)
        X_WH = RigidTransform(RollPitchYaw(0.0, turn * way, 0.0), [0.2 * way, -0.25 * way, -0.6 * way])
        q, *_ = bench.tick(X_WH)
        clearance.append(bench.arm_clearance(q))
    assert 0.003 < min(clearance) < 0.03  # and they come near it
    assert not bench.broken


def test_a_tracker_that_jumps_is_not_followed_there():
    """It is followed again from where it jumped to, and so the arm stays."""
    bench = ArmBench()
    for _ in range(50):
        q, _, state = bench.tick(RigidTransform([0.1, 0.2, 0.3]))
    assert state == ""
    start = bench.hand_position(q)
    there = RigidTransform(RollPitchYaw(math.pi, 0, 0), [5.0, -3.0, 2.0])
    turned = RigidTransform(RollPitchYaw(math.pi, 0, 1.0), [5.0, -3.0, 2.0])
    aside = RigidTransform(turned.rotation(), [5.2, -3.0, 2.0])
    for jump in (there, turned, aside):
        states = [bench.tick(jump) for _ in range(40)]
        assert [state for _, _, state in states[:12]] == [WRIST_JUMPED] * 10 + [""] * 2
        np.testing.assert_allclose(bench.hand_position(states[-1][0]), start, atol=1e-3)
    assert bench.tick(RigidTransform([math.nan, 0.0, 0.0]))[2] == WRIST_NOT_FINITE
    # To and fro it is never followed.
    states = [bench.tick(there if tick % 4 < 2 else RigidTransform()) for tick in range(100)]
    assert all(state for _, _, state in states[2:])
    np.testing.assert_allclose(bench.hand_position(states[-1][0]), start, atol=1e-3)
    # Fast motion is no jump.
    turns = [RigidTransform(RollPitchYaw(0, 0, 0.15 * i), [0.025 * i, 0, 0]) for i in range(50)]
    bench = ArmBench()
    assert {bench.tick(X)[2] for X in turns} == {""}
