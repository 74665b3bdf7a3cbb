"""How the simulated person moves wrist and fingers, the known map it is tried on, and the goal of a grasp."""

import numpy as np
import pytest
from affine_map import AffineMap
from grasp_setup import allegro, centred_map, person_and_rest, workspace_centre
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.finger_motion import FingerMotion
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.wrist_motion import WristMovement, minimum_jerk

ROBOT_FINGERS = ("thumb", "index", "middle", "ring")
# Fingers bend their last joint by two thirds of the one before; the thumb bends both alike.
COUPLING = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 2 / 3])


# -- wrist


def test_minimum_jerk_has_the_closed_form_of_flash_and_hogan():
    """It starts and ends at rest, peaks at 15/8 of its mean speed half way, and is symmetric."""
    s = np.linspace(0, 1, 2001)
    progress = np.array([minimum_jerk(value) for value in s])
    speed = np.gradient(progress, s)
    assert progress[0] == 0 and progress[-1] == 1
    assert speed.max() == pytest.approx(15 / 8, abs=1e-5)
    assert s[speed.argmax()] == pytest.approx(0.5)
    np.testing.assert_allclose(speed[[0, -1]], 0, atol=1e-5)
    np.testing.assert_allclose(progress + progress[::-1], 1, atol=1e-12)
    assert minimum_jerk(-3.0) == 0 and minimum_jerk(7.0) == 1


def test_a_wrist_movement_goes_straight_and_turns_about_one_axis(rng):
    """Both ends are met, the path is a straight line and the turn so far is the same share of the whole."""
    for _ in range(5):
        X_start, X_end = (
            RigidTransform(RollPitchYaw(*rng.uniform(-1, 1, 3)), rng.normal(0, 0.3, 3)) for _ in range(2)
        )
        movement = WristMovement(X_start, X_end, t_start=2.0, duration=0.8)
        assert movement.t_end == pytest.approx(2.8)
        for t, X in ((0.0, X_start), (2.0, X_start), (2.8, X_end), (9.0, X_end)):
            np.testing.assert_allclose(movement.pose(t).GetAsMatrix4(), X.GetAsMatrix4(), atol=1e-9)
        middle = movement.pose(2.4)
        np.testing.assert_allclose(
            middle.translation(), 0.5 * (X_start.translation() + X_end.translation()), atol=1e-12
        )
        turns = [
            Rotation.from_matrix((X_start.rotation().inverse() @ X.rotation()).matrix()).as_rotvec()
            for X in (middle, X_end)
        ]
        np.testing.assert_allclose(turns[0], 0.5 * turns[1], atol=1e-9)


# -- fingers


def natural_postures(hand: HumanHand, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 20) angles inside the hand's limits whose outer joints bend together."""
    lower, upper = hand.lower.reshape(5, 4), hand.upper.reshape(5, 4)
    share = rng.uniform(0.1, 0.9, (count, 5, 3))
    base = lower[:, :2] + share[..., :2] * (upper - lower)[:, :2]
    least = np.maximum(np.maximum(lower[:, 2], lower[:, 3] / COUPLING), np.deg2rad(8.0))
    most = np.minimum(upper[:, 2], upper[:, 3] / COUPLING)
    bend = least + share[..., 2] * (most - least)
    return np.concatenate([base, bend[..., None], (COUPLING * bend)[..., None]], axis=-1).reshape(count, 20)


@pytest.mark.parametrize("hand", [HumanHand.anatomical(), person_and_rest()[0]], ids=["anatomical", "fitted"])
def test_fingers_reach_the_tips_of_natural_postures(hand, rng):
    """Led there as a person moves, fingertips arrive within 0.1 mm, whatever the posture."""
    motion = FingerMotion(hand)
    missed = []
    for posture in natural_postures(hand, rng, 20):
        start, target = hand.fingertips(motion.rest), hand.fingertips(posture)
        theta = motion.rest
        for step in range(1, 61):
            theta = motion.follow(theta, start + minimum_jerk(step / 50) * (target - start))
        missed.append(np.linalg.norm(hand.fingertips(theta) - target, axis=1))
    assert np.quantile(missed, 0.9) < 1e-4
    assert np.max(missed) < 5e-3


def test_fingers_keep_their_limits_and_their_coupling_whatever_is_asked(rng):
    """Targets far outside the hand and far steps leave every joint inside its limits, bent together."""
    hand, _ = person_and_rest()
    motion = FingerMotion(hand)
    theta = motion.rest
    for scale in np.geomspace(1e-3, 1.0, 100):
        theta = motion.follow(theta, hand.fingertips(theta) + rng.normal(0, scale, (5, 3)))
        assert np.isfinite(theta).all()
        assert (theta >= hand.lower - 1e-9).all() and (theta <= hand.upper + 1e-9).all()
        bends = theta.reshape(5, 4)
        np.testing.assert_allclose(bends[:, 3], COUPLING * bends[:, 2], atol=1e-12)


# -- the known map


def test_the_affine_map_moves_the_tips_by_gain_and_rotation(rng):
    """Within reach, robot tips move by gain · R times what the human tips move."""
    hand = allegro()
    rest = np.array([[0.05, 0.05, 0.06], [0.03, 0.03, 0.15], [0.03, 0.0, 0.16], [0.03, -0.03, 0.15]])
    R_BH = RotationMatrix(RollPitchYaw(0.2, -0.3, 0.4)).matrix()
    offset = workspace_centre() - hand.fingertips(hand.default_position)
    for gain in (0.5, 1.5):
        for _ in range(10):
            retarget = AffineMap(hand, rest, gain, R_BH, offset)
            for _ in range(30):
                q = retarget(rest)
            centre = hand.fingertips(q)
            np.testing.assert_allclose(centre, workspace_centre(), atol=5e-4)
            moved = rest + rng.uniform(-0.006, 0.006, (4, 3))
            for _ in range(30):
                q = retarget(moved)
            wanted = gain * (moved - rest) @ R_BH.T
            np.testing.assert_allclose(hand.fingertips(q) - centre, wanted, atol=1e-3)
            np.testing.assert_allclose(
                retarget.target(moved) - retarget.target(rest), wanted, atol=1e-12, rtol=0
            )


def test_the_affine_map_keeps_the_robots_limits_and_its_fingers_apart(rng):
    """Far targets end at joint limits; a finger moves only with its own human finger; reset starts over."""
    hand = allegro()
    retarget = centred_map()
    for _ in range(20):
        q = retarget(rng.normal(0, 0.3, (21, 3)))
        assert (q >= hand.lower).all() and (q <= hand.upper).all() and np.isfinite(q).all()
    retarget.reset()
    _, rest = person_and_rest()
    keypoints = rng.normal(0, 0.1, (21, 3))
    keypoints[[4, 8, 12, 16]] = rest
    first = retarget(keypoints)
    retarget.reset()
    np.testing.assert_array_equal(retarget(rest), first)
    retarget.reset()
    moved = rest.copy()
    moved[1] += 0.01
    others = [name not in hand.description.fingers[1].joints for name in hand.joint_names]
    after = retarget(moved)
    np.testing.assert_array_equal(after[others], first[others])
    assert np.abs(after - first).max() > 1e-3


# -- the goal


def some_goal(yaw_symmetry: float) -> GraspGoal:
    return GraspGoal(
        finger_names=ROBOT_FINGERS,
        touches=np.array([True, True, True, False]),
        X_OB=RigidTransform(),
        X_OB_before=RigidTransform(),
        p_BF_open=np.zeros((4, 3)),
        p_OF_touch=np.zeros((4, 3)),
        n_OF=np.zeros((4, 3)),
        yaw_symmetry=yaw_symmetry,
    )


@pytest.mark.parametrize(
    ("symmetry", "yaw", "wanted"),
    [
        (0.0, 2.5, 0.0),
        (np.pi / 2, 0.2, 0.2),
        (np.pi / 2, 0.2 + np.pi / 2, 0.2),
        (np.pi / 2, -0.2 - np.pi, -0.2),
        (np.pi / 2, np.pi / 2 - 0.1, -0.1),
        (np.pi, 1.4, 1.4),
        (np.pi, 1.4 + np.pi, 1.4),
        (np.pi, 1.8, 1.8 - np.pi),
    ],
)
def test_the_object_frame_takes_the_nearest_of_equivalent_yaws(symmetry, yaw, wanted):
    """The wrist never turns further than half the object's symmetry."""
    X_WO = some_goal(symmetry).object_frame(RigidTransform(RotationMatrix.MakeZRotation(yaw), [1, 2, 3]))
    np.testing.assert_allclose(
        X_WO.rotation().matrix(), RotationMatrix.MakeZRotation(wanted).matrix(), atol=1e-12
    )
    np.testing.assert_array_equal(X_WO.translation(), [1, 2, 3])


def test_the_object_frame_stays_upright_when_the_object_leans():
    """A leaning object is grasped as if it stood, at its yaw."""
    R_lean = RotationMatrix.MakeZRotation(0.3) @ RotationMatrix.MakeYRotation(0.2)
    X = some_goal(np.pi).object_frame(RigidTransform(R_lean, [0, 0, 1]))
    np.testing.assert_allclose(X.rotation().matrix()[2], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(X.rotation().matrix(), RotationMatrix.MakeZRotation(0.3).matrix(), atol=1e-12)
