"""A small robot hand and a person whose fingertips are known to map onto it, shared by the tests."""

import numpy as np
import torch

from geort_drake.retargeting.method import TrainingData
from geort_drake.retargeting.training.kinematics import FingerChain, HandKinematics

LINK = 0.04  # m


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
        fingers.append(FingerChain(name, joints, indices, X, axes, np.array([0, 0, LINK])))
    names = tuple(joint for finger in fingers for joint in finger.joint_names)
    lower = np.tile([-0.6, -0.2, 0.1], len(fingers))
    upper = np.tile([0.6, 1.2, 1.4], len(fingers))
    return HandKinematics(tuple(fingers), names, lower, upper, tip_radius=0.008)


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
        fingers.append(FingerChain(f.name, joints, indices, f.X_PJ[:k], f.axes[:k], f.p_tip))
    rows = [toy.joint_names.index(name) for name in used]
    return HandKinematics(tuple(fingers), tuple(used), toy.lower[rows], toy.upper[rows], toy.tip_radius)


def toy_collides(q: np.ndarray) -> np.ndarray:
    """The hand counts as colliding where its first joint is beyond 0.3 rad."""
    return q[:, 0] > 0.3


def toy_human(hand: HandKinematics, frames: int = 1500, seed: int = 1) -> np.ndarray:
    """(T, F, 3) fingertips of a person who is the robot, 0.8 times as large and 5 cm away."""
    q = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (frames, len(hand.joint_names)))
    return 0.8 * hand.fingertips(torch.tensor(q)).numpy() + [0.0, 0.0, 0.05]


def toy_data(hand: HandKinematics, human: np.ndarray | None = None, **changes) -> TrainingData:
    """Training data of that person and hand, labelled by `toy_collides`."""
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (4000, len(hand.joint_names)))
    given = {"labels": lambda: toy_collides(q), "collides": toy_collides} | changes
    return TrainingData(toy_human(hand) if human is None else human, hand, **{"q": q} | given)


HAND = toy_kinematics()
HUMAN = toy_human(HAND)
PLANTED = (HUMAN - [0.0, 0.0, 0.05]) / 0.8  # the fingertips that this person has as a robot, m


def answers(network: torch.nn.Module) -> np.ndarray:
    """(T, F, 3) robot fingertips of a trained network for that person, m."""
    with torch.no_grad():
        return HAND.fingertips(network(torch.tensor(HUMAN).float())).numpy()
