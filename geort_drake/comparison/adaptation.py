"""How the universal map follows a person through a recording."""

from dataclasses import dataclass

import numpy as np

from geort_drake.comparison.metrics import fingertips_of, robot_space
from geort_drake.hands.model import HandModel
from geort_drake.people.recording import Recording
from geort_drake.retargeting.clouds import first_in_voxels
from geort_drake.retargeting.person_code import PLACE
from geort_drake.retargeting.training.map_figures import coverage
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.systems.person_following import PersonFollowing


@dataclass(frozen=True)
class Adaptation:
    """The map of a person at K instants, for F fingers.

    Attributes:
        q: (T, n) joint positions of a map that follows the person from the first of T hands on, rad.
        rows: (K,) numbers of the hands with which the map changed.
        human: K times (M, 3) the places that the fingertips visited until then, in H of a right hand, m.
        robot: K times (M, 3) where the map of that instant puts the robot's fingertips there, in B, m.
        finger: K times (M,) the fingers' numbers.
        coverage: (K,) fraction of the robot's C-space within 10 mm of `robot`.
    """

    q: np.ndarray
    rows: np.ndarray
    human: list[np.ndarray]
    robot: list[np.ndarray]
    finger: list[np.ndarray]
    coverage: np.ndarray


def follow(universal: UniversalRetargeter, hand: HandModel, hands: Recording) -> Adaptation:
    """Follows a person who is unknown at first, as `RetargetingSystem` does, through valid hands."""
    following, maps, angles = PersonFollowing.start(universal), {}, []
    for row, (time, p_HK) in enumerate(zip(hands.t, hands.p_HK.astype(float), strict=True)):
        before, following = following.now, following.seeing(p_HK, time)
        if following.now is not None and following.now is not before:
            maps[row] = following.now
        angles.append(following.retarget(p_HK, time))
    p_HF = hands.fingertips(universal.human_keypoints)
    places = [first_in_voxels(p_HF[:, finger], PLACE) for finger in range(p_HF.shape[1])]
    reachable, canonical = robot_space(hand).reachable, fingertips_of(hand)
    human, robot, numbers, covered = [], [], [], []
    for row, retarget in maps.items():
        visited = [some[some <= row] for some in places]
        q_visited = [retarget(p_HF[some]) for some in visited]
        tips = [canonical(q)[:, i] for i, q in enumerate(q_visited)]
        human.append(np.concatenate([p_HF[some, i] for i, some in enumerate(visited)]))
        robot.append(np.concatenate([hand.fingertips(q)[:, i] for i, q in enumerate(q_visited)]))
        numbers.append(np.repeat(np.arange(len(tips)), [len(some) for some in visited]))
        covered.append(coverage(reachable, tips)["10mm"])
    return Adaptation(np.array(angles), np.array(list(maps)), human, robot, numbers, np.array(covered))
