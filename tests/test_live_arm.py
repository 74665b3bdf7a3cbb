"""The arm in live use: it keeps its limits, and is held when the person disengages or the tracker jumps."""

import math

import numpy as np
import pytest
from arm_bench import PERIOD, ArmBench
from pydrake.math import RigidTransform, RollPitchYaw
from system_bench import SystemBench

from geort_drake.systems.wrist_checks import WRIST_JUMPED, WRIST_NOT_FINITE, WristChecks

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
    states = [bench.tick(there) for _ in range(100)]
    assert states[0][2] == WRIST_JUMPED and states[-1][2] == ""
    np.testing.assert_allclose(bench.hand_position(states[-1][0]), start, atol=1e-3)
    # To and fro it is never followed.
    states = [bench.tick(there if tick % 4 < 2 else RigidTransform()) for tick in range(100)]
    assert all(state for _, _, state in states[2:])
    np.testing.assert_allclose(bench.hand_position(states[-1][0]), start, atol=1e-3)


class ChecksBench(SystemBench):
    """Wrist checks by themselves."""

    def __init__(self):
        # The update of this moment is the first thing that happens on the way to the next.
        super().__init__(WristChecks(PERIOD), PERIOD, 1.0)

    def tick(self, X_WH: RigidTransform) -> str:
        """The state at an update, where nobody has acted on the pose yet."""
        self.fix(wrist_pose=X_WH, valid=1.0)
        state = self.value("state")
        assert self.value("valid")[0] == float(not state)
        self.advance()
        return state


def test_a_jump_is_seen_at_once_and_held_until_the_pose_settles():
    """Position, rotation and numbers that are none; fast motion is followed."""
    nan = RigidTransform([math.nan, 0.0, 0.0])
    for bad, state in (
        (RigidTransform([0.2, 0, 0]), WRIST_JUMPED),
        (RigidTransform(RollPitchYaw(0, 0, 1.0), [0, 0, 0]), WRIST_JUMPED),
        (nan, WRIST_NOT_FINITE),
    ):
        bench = ChecksBench()
        assert [bench.tick(RigidTransform()) for _ in range(5)] == [""] * 5
        assert bench.tick(bad) == state
        after = bad if state == WRIST_JUMPED else RigidTransform()
        assert [bench.tick(after) for _ in range(12)] == [state] * 9 + [""] * 3
    bench = ChecksBench()
    turns = (RigidTransform(RollPitchYaw(0, 0, 0.15 * i), [0.025 * i, 0, 0]) for i in range(50))
    assert {bench.tick(X) for X in turns} == {""}
