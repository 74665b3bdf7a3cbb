"""The motions that a recording should hold enough of."""

import numpy as np
import pytest

from geort_drake.people.human_hand import HumanHand
from geort_drake.people.play import synthesize_play
from geort_drake.people.range_of_motion import narrow_motions, ranges_deg
from geort_drake.people.readers import read_recording

TIPS = (4, 8, 12, 16, 20)


def swept(joint: str, degrees: float) -> np.ndarray:
    """Keypoints (101, 21, 3) of a hand of which one joint turns evenly by so much, from 10° on."""
    hand = HumanHand.anatomical()
    theta = np.full((101, 20), np.deg2rad(10.0))
    theta[:, hand.joint_index(joint)] += np.deg2rad(np.linspace(0.0, degrees, 101))
    return hand.keypoints(theta)


@pytest.mark.parametrize("joint", ["index_mcp_flexion", "index_pip_flexion", "index_dip_flexion"])
def test_bending_is_the_turn_of_the_joints(joint):
    """One flexion of 50° bends the finger by 50°, less the percentiles' 2 %, and no other finger.

    The metacarpal is a little out of the plane in which the first joint bends.
    """
    p_HK = swept(joint, 50.0)
    assert ranges_deg(p_HK, "index")["bends"] == pytest.approx(49.0, abs=3.0)
    assert ranges_deg(p_HK, "middle")["bends"] == pytest.approx(0.0, abs=1e-6)


def test_sideways_motion_is_the_turn_of_the_first_joint():
    """Of a finger that is nearly straight."""
    assert ranges_deg(swept("index_mcp_abduction", 20.0), "index")["moves sideways"] == pytest.approx(
        19.6, abs=1.0
    )


@pytest.mark.parametrize("finger", ["index", "middle", "ring", "little"])
def test_bending_is_no_motion_sideways(finger):
    """Although the planes in which the fingers bend converge, and no bone stays at one height over x–z."""
    assert ranges_deg(swept(f"{finger}_mcp_flexion", 60.0), finger)["moves sideways"] < 2.0


@pytest.mark.parametrize("seed", range(3))
def test_synthetic_play_is_wide_enough(seed):
    """A minute of it lacks nothing."""
    play = synthesize_play(seed, duration_s=60.0, rate_hz=30.0)
    assert narrow_motions(play.p_HK[play.valid], TIPS) == []


def test_real_recordings_are_wide_enough(alex_npy, manus_npz):
    """Neither of two people's play lacks anything."""
    for path in (alex_npy, manus_npz):
        recording = read_recording(path)
        assert narrow_motions(recording.p_HK[recording.valid], TIPS) == []


def test_what_is_missing_is_said_with_its_measure():
    """A still hand lacks every motion of the fingers that are learned from; others do not matter."""
    said = narrow_motions(swept("index_mcp_abduction", 0.0), (4, 8))
    assert [text.split(" by only ")[0].removeprefix("the recording's ") for text in said] == [
        "thumb bends", "thumb sweeps across the palm", "thumb lifts off the palm",
        "index bends", "index moves sideways",
    ]  # fmt: skip
    assert "by only 0°, at least 90° are wanted (its tip stays within 0 × 0 × 0 mm" in said[3]
    assert "close it to a fist" in said[3]
