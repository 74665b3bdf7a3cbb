"""Guarantees hold for thousands of faulty frames, poses and commands, and memory does not grow."""

from faults.frames import FAULTS, WRIST_FAULTS, fuzz_arm, fuzz_system
from faults.guard import COMMANDS, fuzz_guard
from faults.soak import soak


def test_no_faulty_frame_breaks_a_guarantee():
    """Commands are finite and within the limits of position, speed and acceleration, for every fault."""
    result = fuzz_system(10_000, 0)
    assert result["violations"] == 0, result
    assert set(result["faults"]) == set(FAULTS)
    assert result["held"] > 400
    assert result["frames"] == 10_000 == result["sound"] + sum(result["faults"].values())


def test_no_command_gets_past_the_guard():
    """For any command, the hand stays clear of itself and within its limits of position and speed."""
    result = fuzz_guard(2_000, 0)
    assert result["violations"] == 0, result
    assert set(result["commands"]) == set(COMMANDS)
    assert all(result["corrected"][kind] > 50 for kind in COMMANDS)


def test_no_faulty_wrist_breaks_the_arms_limits():
    """Position, speed and acceleration; and an arm that is held stands still."""
    result = fuzz_arm(4_000, 0)
    assert result["violations"] == 0, result
    assert set(result["faults"]) == set(WRIST_FAULTS)
    assert result["held"] > 400
    assert result["speed_when_held"] == 0.0


def test_updates_do_not_grow_the_memory():
    """By less than they would if each kept 4 kB."""
    count = 3_000
    for name, result in soak(count).items():
        assert result["updates"] == count
        assert result["violations"] == 0, name
        assert result["growth_mb"] <= 10.0, name
