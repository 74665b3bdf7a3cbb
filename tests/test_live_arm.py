"""The arm in live use: it keeps its limits, and is held when the person disengages or the tracker jumps."""

import math

import numpy as np
import pytest
from loop_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw

from geort_drake.systems.wrist_checks import WRIST_JUMPED, WRIST_NOT_FINITE

# From full speed to rest at the lowest acceleration takes 2.6 rad/s over 7.5 rad/s².
STOPPED_S = 0.35


def reach(tick: int) -> RigidTransform:
    """A wrist that goes 0.4 m up and back in a second and a half, and turns meanwhile."""
    way = 0.5 - 0.5 * math.cos(2 * math.pi * tick * PERIOD / 1.5)
    return RigidTransform(RollPitchYaw(0.3 * way, 0.0, 0.4 * way), [-0.1 * way, 0.1 * way, 0.4 * way])


def test_a_disengaged_arm_brakes_and_stays():
    """Within its limits, from full motion; however far the hand was behind the wrist, it goes no farther."""
    bench = ArmBench()
    broken, path = [], []
    for tick in range(200):
        q, v, _ = bench.tick(reach(min(tick, 40)), valid=float(tick < 40))
        broken += bench.watch.broken(q, v)
        path.append((q, v))
    assert np.abs(path[39][1]).max() > 0.3
    assert broken == []
    stop = 40 + round(STOPPED_S / PERIOD)
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
    broken = []
    for tick in range(40):
        broken += bench.watch.broken(*bench.tick(reach(tick))[:2])
    for _ in range(gap):
        q, v, _ = bench.tick(far, valid=0.0)
        broken += bench.watch.broken(q, v)
    held = bench.hand_position(q)
    for _ in range(100):
        q, v, _ = bench.tick(far)
        broken += bench.watch.broken(q, v)
        assert np.linalg.norm(bench.hand_position(q) - held) < (0.1 if gap == 5 else 1e-3)
    assert np.linalg.norm(bench.hand_position(q) - held) < 5e-3
    assert broken == []


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
