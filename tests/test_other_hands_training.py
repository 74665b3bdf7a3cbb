"""Training for hands other than the Allegro right: a left one in the mirror, and LEAP."""

import json

import numpy as np
import pytest

from geort_drake.comparison.train import train_checkpoint
from geort_drake.errors import RecordingError
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.people.recording import Recording
from geort_drake.retargeting.checkpoint import load_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter

pytestmark = pytest.mark.usefixtures("light_evaluation")


def play(side: str = "right") -> Recording:
    return synthesize_play(seed=1, duration_s=20.0, rate_hz=60.0, side=side)


def train(hand: str, recording: Recording, output):
    return train_checkpoint(
        hand, recording, output, show_progress=False, settings={"steps": 5}, robot_samples=1000
    )


def test_a_left_hand_learns_what_the_right_one_learns(tmp_path):
    """From mirrored recordings: the same joint angles and figures."""
    with pytest.MonkeyPatch.context() as patch:
        # The default method has the collision geometry instead.
        patch.setattr(HandModel, "collides_beyond_tips", lambda *_: pytest.fail("labels nobody needs"))
        right = train("allegro_right", play(), tmp_path / "right")
    assert load_checkpoint(right).provenance["robot_data"]["labels"] is False
    left = train("allegro_left", play("left"), tmp_path / "left")
    retargets = [load_retargeter(path) for path in (right, left)]
    frames = play().p_HK[::50].astype(float)
    q_right, q_left = (retarget(frames) for retarget in retargets)
    np.testing.assert_allclose(q_left, q_right, atol=1e-3)
    tips = [
        HandModel(load_hand(name)).fingertips(q)
        for name, q in (("allegro_right", q_right), ("allegro_left", q_left))
    ]
    np.testing.assert_allclose(tips[1], tips[0] * [1, -1, 1], atol=1e-3)
    figures = [json.loads((path / "metrics.json").read_text()) for path in (right, left)]
    for name in ("motion_preservation", "flatness", "self_collision_raw"):
        assert figures[1][name] == pytest.approx(figures[0][name], abs=0.01), name


def test_a_left_hand_refuses_a_right_ones_recording(tmp_path):
    """The message names both sides."""
    with pytest.raises(RecordingError, match="of a right hand, the robot's is a left hand"):
        train("allegro_left", play(), tmp_path / "left")


def test_leap_is_trained_and_evaluated(tmp_path):
    """Its joints stay within their limits, and every figure is finite."""
    path = train("leap_right", play(), tmp_path / "leap")
    hand = HandModel(load_hand("leap_right"))
    retarget = load_retargeter(path, hand)
    assert list(retarget.joint_names) == hand.joint_names
    q = retarget(play().p_HK[::50].astype(float))
    assert ((hand.lower <= q) & (q <= hand.upper)).all()
    figures = json.loads((path / "metrics.json").read_text())
    assert figures["hand"] == "leap_right"
    for name in ("motion_preservation", "flatness", "gain_p95_p5", "self_collision"):
        assert np.isfinite(figures[name]), name
