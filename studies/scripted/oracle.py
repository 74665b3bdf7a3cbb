"""A robot that knows the object: it moves along a planned grasp, squeezes, lifts, and brings it to a place.

The hand follows the plan, inverse kinematics brings the fingertips to the planned contacts, and nothing is
corrected.
"""

import functools

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.hand import Hand
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import HAND, add_object, add_robot, draw_placement
from geort_drake.simulation.wrist_motion import WristMovement, minimum_jerk
from geort_drake.systems.port_values import pose_to_vector

RATE = 50.0  # Hz, rate of the script
# Ends of the first two parts of the script, and durations of the others, s: the hand reaches its waiting
# pose, reaches the object, closes (longer if its joints are slow), squeezes, lifts and holds.
WAITING, THERE = 2.0, 3.5
CLOSING, SQUEEZING, LIFTING, HOLDING = 1.0, 0.5, 1.0, 3.5
CARRYING = 1.5  # s, duration of carrying the object above its place, and of lowering it
HEIGHT = 0.15  # m, of the lift
ITERATIONS, LARGEST_STEP, DAMPING = 10, 0.1, 5e-3  # of inverse kinematics; steps in rad, damping in m/rad
PULL = 0.1  # fraction of the distance to the middle of the joint ranges per iteration
# A replay accepts only a person's hand. Its fingertips are therefore displaced by this share of the targets.
SHARE = 0.05


class Oracle:
    """Inverse kinematics in place of a retargeter: keypoints encode the robot's target fingertips in B.

    Redundant fingers prefer the middle of their joint ranges. Without this, they drift while they squeeze,
    and open along another path than they closed.
    """

    def __init__(self, hand: Hand):
        self.description, self.joint_names = hand.description, hand.joint_names
        self._kinematics = NumpyKinematics(hand.kinematics())
        self._limits = hand.lower, hand.upper
        person = HumanHand.measured_adult()
        self._p_HK = person.keypoints(0.5 * (person.lower + person.upper))
        # Not the default posture, whose straight fingers are singular.
        self._start = 0.5 * (hand.lower + hand.upper)
        joints = [hand.plant.GetJointByName(name, hand.instance) for name in hand.joint_names]
        self.speed = np.array([joint.velocity_upper_limit() for joint in joints])
        self.reset()

    def reset(self) -> None:
        self._q = self._start

    def closing_time(self, p_BF_open: np.ndarray, p_BF_touch: np.ndarray) -> float:
        """Returns the duration of a minimum-jerk movement of the joints between fingertip positions, s."""
        q_open = self._solve(self._start, p_BF_open, 100)
        q_touch = self._solve(q_open, p_BF_touch, 100)
        # The movement peaks at 15/8 of its mean speed.
        return max(CLOSING, float((1.875 * np.abs(q_touch - q_open) / self.speed).max()))

    def keypoints(self, p_BF: np.ndarray) -> np.ndarray:
        """Returns the keypoints (21, 3), m in H, of target fingertips (F, 3), m in B."""
        p_HK = self._p_HK.copy()
        p_HK[self.description.human_keypoints] += SHARE * p_BF
        return p_HK

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        targets = (p_HK - self._p_HK)[self.description.human_keypoints] / SHARE
        self._q = self._solve(self._q, targets, ITERATIONS)
        return self._q

    def _solve(self, q: np.ndarray, targets: np.ndarray, iterations: int) -> np.ndarray:
        n = len(q)
        for _ in range(iterations):
            tips, J = self._kinematics.fingertips_and_jacobians(q[None])
            J = J.reshape(-1, n)
            inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(len(J)))
            step = inverse @ (targets - tips[0]).ravel()
            step += PULL * (np.eye(n) - inverse @ J) @ (self._start - q)
            q = np.clip(q + np.clip(step, -LARGEST_STEP, LARGEST_STEP), *self._limits)
        return q


@functools.cache
def oracle(hand: str) -> Oracle:
    """Returns the oracle of a robot hand."""
    return Oracle(Hand(hand))


def script(
    scenario: Scenario,
    oracle: Oracle,
    goal: GraspGoal,
    squeeze: float,
    place: tuple[RigidTransform, float] | None = None,
) -> Recording:
    """Returns the oracle's motion for the object as the scenario's seed places it.

    Args:
        squeeze: depth of the squeeze, m.
        place: pose X_WP to which to bring the frame O of the goal after the lift, and the height above it
            from which to lower it, m.
    """
    X_WO = goal.object_frame(object_pose(scenario))
    X_start = _start_pose(scenario, oracle)
    X_before, X_WB = X_WO @ goal.X_OB_before, X_WO @ goal.X_OB
    X_BO = goal.X_OB.inverse()
    touching, inwards = X_BO.multiply(goal.p_OF_touch.T).T, goal.n_OF @ X_BO.rotation().matrix().T
    touching[~goal.touches] = goal.p_BF_open[~goal.touches]
    closed = THERE + oracle.closing_time(goal.p_BF_open, touching)
    squeezed = closed + SQUEEZING
    movements = [
        WristMovement(X_start, X_before, 0.0, WAITING - 0.5),
        WristMovement(X_before, X_WB, WAITING, THERE - WAITING - 0.5),
        WristMovement(X_WB, RigidTransform([0, 0, HEIGHT]) @ X_WB, squeezed, LIFTING),
    ]
    end, opening = squeezed + LIFTING + HOLDING, np.inf
    if place is not None:
        X_WP, hover = place
        X_above = RigidTransform([0, 0, hover]) @ X_WP
        opening = squeezed + LIFTING + 2 * CARRYING
        movements += [
            WristMovement(movements[-1].X_end, X_above @ goal.X_OB, squeezed + LIFTING, CARRYING - 0.5),
            WristMovement(X_above @ goal.X_OB, X_WP @ goal.X_OB, opening - CARRYING, CARRYING - 0.5),
            WristMovement(X_WP @ goal.X_OB, X_WP @ goal.X_OB_before, opening + CLOSING + 0.3, LIFTING),
        ]
        end = opening + CLOSING + LIFTING + 1.0
    t = np.arange(0.0, end, 1 / RATE)
    keypoints, poses = np.zeros((len(t), 21, 3)), []
    for number, time in enumerate(t):
        opened = minimum_jerk((time - opening) / CLOSING)
        share = minimum_jerk((time - THERE) / (closed - THERE)) * (1 - opened)
        depth = squeeze * minimum_jerk((time - closed) / SQUEEZING) * (1 - opened)
        p_BF = goal.p_BF_open + share * (touching - goal.p_BF_open) + depth * inwards
        keypoints[number] = oracle.keypoints(p_BF)
        started = [movement for movement in movements if time >= movement.t_start]
        poses.append(pose_to_vector(started[-1].pose(time)))
    return Recording(t, keypoints, np.full(len(t), True), np.array(poses), {"side": oracle.description.side})


def object_pose(scenario: Scenario) -> RigidTransform:
    """Returns X_WO of the object as the seed places it."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    body = add_object(plant, scenario.object.name)
    lowest = ObjectShape(plant, scene_graph.model_inspector(), body).lowest_point(RigidTransform())
    return draw_placement(scenario, lowest, np.random.default_rng(scenario.random_seed))[0]


def _start_pose(scenario: Scenario, oracle: Oracle) -> RigidTransform:
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.0)
    add_robot(plant, scenario, oracle.description)
    plant.Finalize()
    base = plant.GetFrameByName(oracle.description.base_frame, plant.GetModelInstanceByName(HAND))
    return base.CalcPoseInWorld(plant.CreateDefaultContext())
