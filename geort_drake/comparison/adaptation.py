"""Measures how the universal map adapts to a person in the course of a recording."""

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
    """The map of a person at the K frames, of T, in which it changes.

    Attributes:
        q: (T, n) joint positions of the map as it adapts from the first frame on, rad.
        rows: (K,) numbers of the frames in which the map changes.
        human: K arrays (M, 3) of the positions that fingertips visited until then, in H of a right hand, m.
        robot: K arrays (M, 3) of the robot fingertips to which the map of then maps them, in B, m.
        finger: K arrays (M,) of the fingers' numbers.
        coverage: (K,) fraction of the robot's C-space within 10 mm of `robot`.
    """

    q: np.ndarray
    rows: np.ndarray
    human: list[np.ndarray]
    robot: list[np.ndarray]
    finger: list[np.ndarray]
    coverage: np.ndarray


def follow(universal: UniversalRetargeter, hand: HandModel, hands: Recording) -> Adaptation:
    """Follows an initially unknown person through valid frames, as `RetargetingSystem` does."""
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
        visited = [frames[frames <= row] for frames in places]
        q_visited = [retarget(p_HF[frames]) for frames in visited]
        tips = [canonical(q)[:, i] for i, q in enumerate(q_visited)]
        human.append(np.concatenate([p_HF[frames, i] for i, frames in enumerate(visited)]))
        robot.append(np.concatenate([hand.fingertips(q)[:, i] for i, q in enumerate(q_visited)]))
        numbers.append(np.repeat(np.arange(len(tips)), [len(frames) for frames in visited]))
        covered.append(coverage(reachable, tips)["10mm"])
    return Adaptation(np.array(angles), np.array(list(maps)), human, robot, numbers, np.array(covered))
