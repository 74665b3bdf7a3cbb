"""A glove and a tracker with faults, and whose hand wears them."""

import numpy as np
import pytest
from grasp_setup import centred_map, human_with, scenario_with
from pydrake.math import RigidTransform
from system_bench import SystemBench

from geort_drake import run_trial, synthesize_play
from geort_drake.simulation.person import persons_hand
from geort_drake.simulation.worn_glove import WornGlove, WornGloveConfig

X_WH = RigidTransform([0.1, 0.2, 0.3])


def measured(config: WornGloveConfig) -> tuple[np.ndarray, RigidTransform, float]:
    """Keypoints (21, 3), wrist pose and validity of a hand whose keypoints are known."""
    bench = SystemBench(WornGlove(config, 10.0, np.random.default_rng(0)))
    bench.fix(keypoints=hand(), wrist_pose=X_WH, valid=1.0)
    keypoints, pose, valid = (bench.value(name) for name in ("keypoints", "wrist_pose", "valid"))
    return np.reshape(keypoints, (21, 3)), pose, valid[0]


def hand() -> np.ndarray:
    p_HK = np.random.default_rng(1).uniform(-0.1, 0.1, (21, 3))
    p_HK[0] = 0.0
    return p_HK


def test_a_misaligned_tracker_turns_the_directions_of_motion():
    """By its angle; the keypoints stay."""
    keypoints, pose, valid = measured(WornGloveConfig(misalignment=0.2))
    np.testing.assert_allclose(keypoints, hand(), atol=1e-12)
    turn = pose.rotation() @ X_WH.rotation().inverse()
    assert turn.ToAngleAxis().angle() == pytest.approx(0.2)
    np.testing.assert_allclose(pose.translation(), turn @ X_WH.translation())
    assert valid == 1


def test_dropouts_have_their_rate_and_their_duration():
    """Two a second of 40 ms: the hand is lost for 8 % of the time."""
    system = WornGlove(WornGloveConfig(dropout_rate=2.0), 500.0, np.random.default_rng(0))
    lost = np.array([system._in_gap(t) for t in np.arange(0, 500, 0.001)])
    assert lost.mean() == pytest.approx(0.08, abs=0.01)
    starts = np.flatnonzero(np.diff(lost.astype(int)) == 1)
    assert np.median(np.flatnonzero(np.diff(lost.astype(int)) == -1)[: len(starts)] - starts) == 40


def test_the_object_is_lifted_with_every_fault_at_once():
    """A person corrects what they see."""
    text = (
        "{glove: {misalignment: 0.1, shift: 0.005, turn: 0.05, dropout_rate: 1.0}, monitor: {hold_time: 0.5}}"
    )
    human = human_with(clearance=np.inf)
    result, glove = run_trial(scenario_with("cylinder", text), centred_map(), human)
    assert result.success and not glove.valid.all()


def test_another_person_has_another_hand():
    """The same one for the same number."""
    play = synthesize_play(seed=0, duration_s=10)
    own, first, other = (persons_hand(scenario_with(text=f"{{person: {k}}}"), play) for k in (0, 1, 2))
    again = persons_hand(scenario_with(text="{person: 1}"), play)
    np.testing.assert_array_equal(first.lengths, again.lengths)
    assert len({hand.lengths.sum() for hand in (own, first, other)}) == 3
