"""A small robot hand and a person whose fingertips are known to map onto it, shared by the tests."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch

from geort_drake.hands.kinematics import FingerChain, HandKinematics
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.retargeting.base import Retargeter
from geort_drake.retargeting.kinematics import fingertips

LINK = 0.04  # m


def _chain(name, joints, indices, X_PJ, axes) -> FingerChain:
    """A finger without followers."""
    p_tip = np.array([0.0, 0.0, LINK])
    return FingerChain(name, joints, indices, X_PJ, axes, p_tip, joints, np.eye(len(joints)))


def toy_kinematics(finger_names=("thumb", "index", "middle")) -> HandKinematics:
    """Fingers side by side along y, each abducting about x and flexing twice about y; they reach along z."""
    fingers = []
    for number, name in enumerate(finger_names):
        X = np.tile(np.eye(4), (3, 1, 1))
        X[0, 1, 3] = 0.03 * number
        X[2, 2, 3] = LINK
        axes = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 1.0, 0]])
        joints = tuple(f"{name}_{k}" for k in range(3))
        indices = tuple(range(3 * number, 3 * number + 3))
        fingers.append(_chain(name, joints, indices, X, axes))
    names = tuple(joint for finger in fingers for joint in finger.joint_names)
    lower = np.tile([-0.6, -0.2, 0.1], len(fingers))
    upper = np.tile([0.6, 1.2, 1.4], len(fingers))
    return HandKinematics(tuple(fingers), names, lower, upper, tip_radius=0.008, p_BW=np.zeros(3))


def uneven_kinematics() -> HandKinematics:
    """Two, three and one joints per finger, and q not in the order of the fingers."""
    toy = toy_kinematics()
    counts = dict(zip(toy.finger_names, (2, 3, 1), strict=True))
    used = [joint for f in toy.fingers for joint in f.joint_names[: counts[f.name]]][::-1]
    fingers = []
    for f in toy.fingers:
        k = counts[f.name]
        joints = f.joint_names[:k]
        indices = tuple(used.index(joint) for joint in joints)
        fingers.append(_chain(f.name, joints, indices, f.X_PJ[:k], f.axes[:k]))
    rows = [toy.joint_names.index(name) for name in used]
    return replace(
        toy, fingers=tuple(fingers), joint_names=tuple(used), lower=toy.lower[rows], upper=toy.upper[rows]
    )


def toy_collides(q: np.ndarray) -> np.ndarray:
    """The hand counts as colliding where its first joint is beyond 0.3 rad."""
    return q[:, 0] > 0.3


def toy_human(hand: HandKinematics, frames: int = 1500, seed: int = 1) -> np.ndarray:
    """(T, F, 3) fingertips of a person who is the robot, 0.8 times as large and 5 cm away."""
    q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (frames, len(hand.joint_names)))
    return 0.8 * fingertips(hand, torch.tensor(q)).numpy() + [0.0, 0.0, 0.05]


class ToyHand:
    """The hand as a model, which draws joint angles and labels them."""

    def __init__(self, kinematics: HandKinematics, collides: Callable = toy_collides):
        self._kinematics, self.collides_beyond_tips = kinematics, collides
        keypoints = [TIP_KEYPOINT[name] for name in kinematics.finger_names]
        self.description = SimpleNamespace(name="toy", side="right", human_keypoints=keypoints)

    def kinematics(self) -> HandKinematics:
        return self._kinematics

    def sample(self, count: int, seed: int = 0) -> np.ndarray:
        hand = self._kinematics
        return np.random.default_rng(seed).uniform(hand.lower, hand.upper, (count, len(hand.joint_names)))


HAND = toy_kinematics()
HUMAN = toy_human(HAND)
PLANTED = (HUMAN - [0.0, 0.0, 0.05]) / 0.8  # the fingertips that this person has as a robot, m


def answers(retarget: Retargeter) -> np.ndarray:
    """(T, F, 3) robot fingertips of a trained map for that person, m."""
    return fingertips(HAND, torch.tensor(retarget(HUMAN))).numpy()
