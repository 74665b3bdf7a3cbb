"""Where training saw the fingertips, what a checkpoint keeps of it, and the bare map with its gradients."""

import numpy as np
import pytest
from faults.bench import Bench
from faults.sound import FINGERS, JOINTS, LOWER, TIPS, UPPER, play, smooth_arrays, smooth_retargeter
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from geort_drake.errors import HandError
from geort_drake.retargeting.checkpoint import TRAINED_POINTS, save_checkpoint
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.trained_space import TrainedSpace, trained_points
from geort_drake.systems.glove_checks import GloveChecks
from geort_drake.systems.retargeting_map import RetargetingMap
from geort_drake.systems.retargeting_system import OUTSIDE, TRACKING

PLAY = play()
AT_ONCE = GloveChecks(ease_at_start=False)


def hands(count: int) -> np.ndarray:
    return PLAY.p_HK[:count].astype(float)


def test_a_foreign_hand_is_reported_and_the_persons_own_is_not():
    """Synthetic play of another seed is inside; the same hand 30 % larger is outside, and still followed."""
    space = TrainedSpace(trained_points(PLAY.p_HK[:, list(TIPS)]), TIPS)
    retarget = smooth_retargeter()
    retarget.trained_space = space
    bench = Bench(retarget, checks=AT_ONCE)
    for keypoints in hands(60):
        *_, status = bench.tick(keypoints)
    assert status.state == TRACKING and status.distance < 0.01
    bench = Bench(retarget, checks=AT_ONCE)
    for keypoints in 1.3 * hands(60):
        q, *_, status = bench.tick(keypoints)
    assert status.state == OUTSIDE and status.distance > 0.02
    np.testing.assert_array_equal(q, retarget(1.3 * hands(60)[-1]))
    *_, status = Bench(smooth_retargeter(), checks=AT_ONCE).tick(hands(1)[0])
    assert np.isnan(status.distance)


def test_a_checkpoint_tells_where_it_was_trained_and_an_older_one_still_loads(tmp_path):
    """Without the places, nothing is known about the distance, and the retargeter is the same."""
    facts = {"name": "toy", "finger_names": FINGERS, "joint_names": JOINTS, "model_sha256": "abc"}
    points = trained_points(PLAY.p_HK[:, list(TIPS)])
    for name, arrays in (("new", {TRAINED_POINTS: points}), ("old", {})):
        save_checkpoint(
            tmp_path / name, smooth_arrays() | arrays, method="geort",
            hand=facts | {"lower": LOWER.tolist(), "upper": UPPER.tolist()}, human_keypoints=TIPS,
            training={}, provenance={}, history=[],
        )  # fmt: skip
    new, old = (load_retargeter(tmp_path / name) for name in ("new", "old"))
    np.testing.assert_array_equal(new.trained_space.points, points)
    assert old.trained_space is None
    hand = hands(1)[0]
    np.testing.assert_array_equal(new(hand), old(hand))


# -- the map alone


def test_the_map_has_exact_gradients_in_autodiff():
    """Those of the Jacobian, by joint name and keypoint; all other keypoints have none."""
    retarget = smooth_retargeter()
    keypoints = hands(1)[0]
    order = JOINTS[::-1]
    system = RetargetingMap(retarget, order)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, keypoints.ravel())
    np.testing.assert_array_equal(system.get_output_port().Eval(context), retarget(keypoints)[::-1])
    differentiable = system.ToAutoDiffXd()
    context = differentiable.CreateDefaultContext()
    differentiable.get_input_port().FixValue(context, InitializeAutoDiff(keypoints.ravel())[:, 0])
    q = differentiable.get_output_port().Eval(context)
    expected = np.zeros((16, 21, 3))
    expected[:, list(TIPS)] = retarget.jacobian(keypoints)[::-1]
    np.testing.assert_allclose(ExtractGradient(q[:, None]).reshape(16, 21, 3), expected, atol=1e-12)
    with pytest.raises(HandError, match="the retargeter moves"):
        RetargetingMap(retarget, ("a",))
