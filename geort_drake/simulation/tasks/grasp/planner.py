"""Finds where the robot hand should be and touch to grasp an object.

The planner knows the object's shape and grip, the robot and the surroundings, and nothing of retargeting.
It places contacts by the object's shape, from several yaws and at several heights, and keeps the most
comfortable posture of arm and hand together that reaches them, free of collisions.
"""

import dataclasses as dc
import itertools

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.approach import GraspApproach
from geort_drake.simulation.tasks.grasp.contacts import (
    GRIPS,
    Contact,
    contact_heights,
    grip_contacts,
    grip_of,
    palm_contact,
    rooms_beside,
    yaw_candidates,
)
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.kinematics import GraspKinematics

# Least gap between two fingertips on the object, and between a fingertip and what the object stands on, m.
_TIP_GAP = 0.002
# A step down the list of heights counts like this discomfort.
_HEIGHT_STEP = 0.2
# Of so many grasps the best is taken, and so many places are tried at most.
_ENOUGH, _TRIES = 2, 15
# How far fingertips open around their contacts, m.
_OPENING = 0.025


class GraspPlanner:
    """Plans grasps of one object with the scenario's robot.

    Raises:
        ScenarioError: the hand lacks a finger of the object's grip.
        UnknownNameError: no grip is known for the object.
    """

    def __init__(self, scenario: Scenario, description: HandDescription):
        self._grip = grip_of(scenario.object.name)
        names = [finger.name for finger in description.fingers]
        for needed in GRIPS[self._grip].fingers:
            if needed not in names:
                raise ScenarioError(
                    f"a {self._grip} grasp needs a {needed}; hand '{description.name}' has: "
                    f"{', '.join(names)}"
                )
        self._description = description
        self._scenario = scenario
        grasping = [finger for finger in description.fingers if finger.name in GRIPS[self._grip].fingers]
        self._fewest_joints = min(len(finger.joints) for finger in grasping)
        self._kinematics = GraspKinematics(scenario, description, list(GRIPS[self._grip].fingers))
        robot = self._kinematics
        self._approach = GraspApproach(
            description,
            scenario.object.name,
            robot.hand_pose(robot.q_default),
            robot.joint_positions(robot.q_default),
        )

    @property
    def shape(self) -> ObjectShape:
        """The object's shape."""
        return self._kinematics.shape

    def plan(self) -> GraspGoal:
        """The most comfortable grasp that was found; the same one every time.

        Raises:
            ScenarioError: none was found.
        """
        robot, best = self._kinematics, self._search()
        names = tuple(finger.name for finger in self._description.fingers)
        normals = {contact.part: contact.n_O for contact in best.contacts}
        X_OB = robot.hand_pose(best.q_touch)
        return GraspGoal(
            finger_names=names,
            touches=np.array([name in normals for name in names]),
            X_OB=X_OB,
            X_OB_before=best.X_OB_before,
            p_BF_open=X_OB.inverse().multiply(robot.fingertips(best.q_open).T).T,
            p_OF_touch=robot.fingertips(best.q_touch),
            n_OF=np.array([normals.get(name, np.zeros(3)) for name in names]),
            yaw_symmetry=yaw_candidates(robot.shape)[1],
        )

    def _search(self) -> "_Grasp":
        for beside in rooms_beside(self._kinematics.shape, self._grip):
            found: list[_Grasp] = []
            for place in self._places(beside)[:_TRIES]:
                if len(found) == _ENOUGH or any(place.rank >= grasp.rank for grasp in found):
                    break
                grasp = self._grasp_at(place)
                if grasp is not None:
                    found.append(grasp)
            if found:
                return min(found, key=lambda grasp: grasp.rank)
        raise ScenarioError(
            f"the robot cannot grasp object '{self._scenario.object.name}' at "
            f"{self._scenario.object.position}: no collision-free {self._grip} grasp was found"
        )

    def _grasp_at(self, place: "_Place") -> "_Grasp | None":
        """The grasp there without collisions, with open fingers and a way to it; None if there is none."""
        robot = self._kinematics
        solution = robot.touch(place.contacts, place.palm, place.q)
        if solution is None:
            return None
        discomfort, q_touch = solution
        # To take an object into the palm, the whole hand opens; and so do fingers that cannot leave a surface
        # straight, as three joints are needed to put a tip anywhere.
        wide = place.palm is not None or self._fewest_joints < 3
        q_open = robot.open_wide(q_touch) if wide else robot.open(place.contacts, _OPENING, q_touch)
        if q_open is None:
            return None
        X_OB_before = self._approach.waiting_pose(robot.hand_pose(q_touch), robot.joint_positions(q_open))
        if X_OB_before is None:
            return None
        return _Grasp(discomfort + place.penalty, place.contacts, q_touch, q_open, X_OB_before)

    def _places(self, beside: float) -> list["_Place"]:
        """Where fingertips and palm can reach, the most promising first.

        Ranked by inverse kinematics without collisions, which takes a hundredth of the time with them and
        is hardly ever less comfortable.

        Args:
            beside: one of `rooms_beside`.
        """
        robot, side = self._kinematics, self._description.side
        shape = robot.shape
        lowest = max(finger.tip_radius for finger in self._description.fingers) + _TIP_GAP
        places = []
        for step, height in enumerate(contact_heights(shape, self._grip, lowest)):
            for yaw in yaw_candidates(shape)[0]:
                contacts = grip_contacts(shape, yaw, height, self._grip, side, beside)
                palm = palm_contact(shape, yaw, height, side) if GRIPS[self._grip].palm else None
                if not self._room_for_tips(contacts):
                    continue
                relaxed = robot.touch(contacts, palm, robot.q_default, collisions=False)
                if relaxed is not None:
                    penalty = step * _HEIGHT_STEP
                    places.append(_Place(relaxed[0] + penalty, penalty, contacts, palm, relaxed[1]))
        return sorted(places, key=lambda place: place.rank)

    def _room_for_tips(self, contacts: list[Contact]) -> bool:
        """Whether the fingertips at these contacts would be clear of each other."""
        radius = {finger.name: finger.tip_radius for finger in self._description.fingers}
        tips = [
            (contact.p_OC - contact.n_O * radius[contact.part], radius[contact.part]) for contact in contacts
        ]
        return all(
            np.linalg.norm(p - other_p) > r + other_r + _TIP_GAP
            for (p, r), (other_p, other_r) in itertools.combinations(tips, 2)
        )


@dc.dataclass(frozen=True)
class _Place:
    """Contacts that can be reached, if nothing is in the way."""

    rank: float  # less is better
    penalty: float  # for the height, part of the rank
    contacts: list[Contact]
    palm: Contact | None
    q: np.ndarray


@dc.dataclass(frozen=True)
class _Grasp:
    """Postures of arm and hand that touch and that are open, and where the hand waits before."""

    rank: float
    contacts: list[Contact]
    q_touch: np.ndarray
    q_open: np.ndarray
    X_OB_before: RigidTransform
