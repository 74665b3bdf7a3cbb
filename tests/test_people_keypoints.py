"""The wrist frame and the bones, against constructed hands and rotations."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geort_drake.people import keypoints as kp
from geort_drake.people.human_hand import HumanHand


def hand_in_H(rng, frames=5):
    hand = HumanHand.anatomical()
    return hand.keypoints(rng.uniform(hand.lower, hand.upper, (frames, 20)))


def test_numbering_is_that_of_mediapipe():
    """Tips are 4, 8, ..., 20, MCPs 5, 9, 13, 17, and the 20 bones form a tree rooted in the wrist."""
    assert kp.TIP_KEYPOINT == {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "little": 20}
    assert kp.BASE_KEYPOINT == {"thumb": 1, "index": 5, "middle": 9, "ring": 13, "little": 17}
    assert sorted(child for _, child in kp.BONES) == list(range(1, 21))
    assert [child for parent, child in kp.BONES if parent == kp.WRIST] == [1, 5, 9, 13, 17]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_wrist_frame_follows_any_motion_of_the_hand(seed):
    """Moving the hand by X_WH, frame by frame, is found again and undone; bones keep their lengths."""
    rng = np.random.default_rng(seed)
    p_HK = hand_in_H(rng)
    R_WH = Rotation.random(len(p_HK), rng=rng).as_matrix()
    p_WH = rng.normal(size=(len(p_HK), 3))
    p_WK = p_HK @ np.swapaxes(R_WH, 1, 2) + p_WH[:, None]
    found_R, found_p = kp.wrist_pose(p_WK)
    np.testing.assert_allclose(found_R, R_WH, atol=1e-10)
    np.testing.assert_allclose(found_p, p_WH, atol=1e-12)
    np.testing.assert_allclose(kp.to_wrist_frame(p_WK), p_HK, atol=1e-12)
    np.testing.assert_allclose(kp.bone_lengths(p_WK), kp.bone_lengths(p_HK), atol=1e-12)


def test_a_degenerate_hand_has_no_wrist_frame(rng):
    """Where all keypoints coincide, the frame is NaN and other frames are unharmed."""
    p_WK = hand_in_H(rng, 3)
    p_WK[1] = 0.5
    R_WH, _ = kp.wrist_pose(p_WK)
    assert np.isnan(R_WH[1]).all()
    assert np.isfinite(R_WH[[0, 2]]).all()
