"""A person who sees only what the live page shows, and grasps: frames in, hands of a headset out."""

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from web_page import joints_of

from geort_drake import load_hand, load_scenario
from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.perception import Seen
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner

FRAME_S = 1.0 / 30.0
# From a hand to its picture on a busy machine; the person judges a movement after that.
DELAY_S = 12 * FRAME_S
TOUCHING_M = 1e-3  # gap between a fingertip and the object that no picture shows


def goal_of(hand: str, thing: str):
    """How the robot's hand can hold an object: the first plan."""
    scenario = load_scenario()
    scenario.hand, scenario.object.name = hand, thing
    return GraspPlanner(scenario, load_hand(hand)).plans()[0]


class PagePerson:
    """Decides after the page's frames how to move.

    Args:
        scene: contents of `/scene`.
        hand: name of the robot's hand, as in `welcome`.
        thing: name of the object, as in `state`.
        goal: of the grasp.
    """

    def __init__(self, scene: dict, hand: str, thing: str, goal):
        names = scene["moving"]
        self._base, self._X_LB = scene["hand_base"]["moving"], pose_of(scene["hand_base"]["pose"])
        self._object = names.index(f"{thing}::{thing}")
        self._tips = [(names.index(f"hand::{f.tip_link}"), f.tip_point) for f in load_hand(hand).fingers]
        self._tip_radii = np.array([f.tip_radius for f in load_hand(hand).fingers])
        self._radius = next(g["size"][0] for g in scene["geometries"] if g["moving"] == self._object)
        self._bodies = len(names)
        config = OperatorConfig(period=FRAME_S, visual_delay=DELAY_S, contact_noise=0.0, visual_noise=0.0,
                                visual_depth_noise=0.0, visual_turn_noise=0.0, motor_noise=0.0,
                                correction_rate=2.0)  # fmt: skip
        self._hand = HumanHand.anatomical()
        self._rng = np.random.default_rng(0)
        self._person = GraspingPerson(self._hand, goal, config, self._rng)
        self._tremor = config.tremor
        self._state = None

    @property
    def phase(self) -> str:
        """What the person is doing."""
        return self._state.phase.name.lower() if self._state else "waiting"

    def hand(self, frames: list[bytes], engaged: bool) -> list[list[float]]:
        """The joints of a headset after these frames; at rest until the person is engaged."""
        for frame in frames:
            values = np.frombuffer(frame, "<f4").astype(float)
            poses = values[1 : 1 + 7 * self._bodies].reshape(-1, 7)
            X_WB = pose_of(poses[self._base]) @ self._X_LB
            if self._state is None:
                self._state = self._person.start(RigidTransform(X_WB.rotation(), np.zeros(3)))
            if engaged:
                tips = [pose_of(poses[body]) @ np.array(point) for body, point in self._tips]
                X_WO = pose_of(poses[self._object])
                seen = Seen(np.array(tips), X_WB, X_WO, self._touching(np.array(tips), X_WO))
                self._state = self._person.step(self._state, values[0], seen)
        p_HK = self._hand.keypoints(self._state.theta)
        p_HK[1:] += self._rng.normal(0.0, self._tremor, (20, 3))
        return joints_of(self._state.X_WH.multiply(p_HK.T).T)

    def _touching(self, p_WF: np.ndarray, X_WO: RigidTransform) -> np.ndarray:
        """A force of 1 N, or none, at each fingertip as the picture shows it on the upright object or not."""
        across = np.linalg.norm((p_WF - X_WO.translation())[:, :2], axis=1)
        return np.where(across - self._radius - self._tip_radii < TOUCHING_M, 1.0, 0.0)


def pose_of(values) -> RigidTransform:
    """The pose of qw qx qy qz x y z."""
    q = np.asarray(values[:4], dtype=float)
    return RigidTransform(Quaternion(q / np.linalg.norm(q)), np.asarray(values[4:], dtype=float))
