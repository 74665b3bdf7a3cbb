"""Plans the grasp of an object: hand poses and contacts.

The planner knows the object's shape and grip, the robot and its surroundings, but no retargeter. It places
contacts on the object at several yaws and heights, and takes the most comfortable collision-free posture of
arm and hand that reaches them.
"""

import dataclasses as dc
import itertools
from operator import itemgetter

import numpy as np

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.finger_planner import require_fingers
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.approach import GraspApproach
from geort_drake.simulation.tasks.grasp.contacts import (
    GRIPS,
    Contact,
    contact_heights,
    finger_offsets,
    grip_contacts,
    grip_of,
    palm_contact,
    vertical_extent,
    yaw_candidates,
)
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.simulation.tasks.grasp.kinematics import GraspKinematics

# Least gap between two fingertips, and between a fingertip and the object's support, m.
_TIP_GAP = 0.002
# Discomfort of each step down the list of heights.
_HEIGHT_STEP = 0.2
# Largest number of candidates tried for each of `finger_offsets`.
_TRIES = 36
# Grip → grip to try next if no grasp with it is found.
_FALLBACK_GRIPS = {"power": "tripod", "tripod": "pinch"}
# Opening of the fingertips around their contacts, m.
_OPENING = 0.025


class GraspPlanner:
    """Plans grasps of one object with the scenario's robot.

    If the object's grip gives no grasp, the planner tries contacts as close together as the hand's fingers,
    and then the next grip of power, tripod and pinch.

    Args:
        grip: one of `GRIPS`; None for the object's.
        tip_height: height of the fingertips above the object's bottom, m; None for `contact_heights`.

    Raises:
        ScenarioError: the hand lacks a finger of the object's grip.
        UnknownNameError: no grip is known for the object.
    """

    def __init__(
        self,
        scenario: Scenario,
        description: HandDescription,
        grip: str | None = None,
        tip_height: float | None = None,
    ):
        self._grip, self._tip_height = grip or grip_of(scenario.object.name), tip_height
        require_fingers(description, GRIPS[self._grip].fingers, f"a {self._grip} grasp needs")
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

    def plans(self, enough: int = 20) -> list[GraspGoal]:
        """Returns up to `enough` different grasps, the most comfortable first; deterministic.

        Raises:
            ScenarioError: no grasp is found.
        """
        robot = self._kinematics
        offsets = finger_offsets(robot.shape, self._grip)
        found = self._search(robot.q_default, [(offset, None) for offset in offsets], enough)
        if not found:
            found = self._search(robot.q_middle, [(offsets[0], robot.finger_spacing)], enough)
        if found:
            return [goal for _, goal in sorted(found, key=itemgetter(0))]
        if self._grip in _FALLBACK_GRIPS and self._tip_height is None:
            return GraspPlanner(self._scenario, self._description, _FALLBACK_GRIPS[self._grip]).plans(enough)
        raise ScenarioError(
            f"the robot cannot grasp object '{self._scenario.object.name}' at "
            f"{self._scenario.object.position}: no collision-free {self._grip} grasp was found"
        )

    def _search(
        self, q_start: np.ndarray, distances: list[tuple[float, float | None]], enough: int
    ) -> list[tuple[float, GraspGoal]]:
        """Returns up to `enough` grasps with their costs.

        Args:
            q_start: initial positions of the plant.
            distances: `offset` and `spacing` of `grip_contacts`, in order of preference.
        """
        found: list[tuple[float, GraspGoal]] = []
        for offset, spacing in distances:
            for candidate in self._candidates(q_start, offset, spacing)[:_TRIES]:
                if len(found) == enough:
                    break
                grasp = self._grasp_from(candidate)
                if grasp is not None:
                    found.append(grasp)
        return found

    def _grasp_from(self, candidate: "_Candidate") -> tuple[float, GraspGoal] | None:
        """Returns cost and goal of a collision-free grasp that the open hand can approach, or None."""
        robot = self._kinematics
        # At a low object, the support often separates the first guess from all solutions.
        guesses = (
            [candidate.q] if self._tip_height is None else [candidate.q, robot.q_default, robot.q_middle]
        )
        touched = (robot.touch(candidate.contacts, candidate.palm, guess) for guess in guesses)
        solution = next((found for found in touched if found is not None), None)
        if solution is None:
            return None
        discomfort, q_touch = solution
        # The whole hand opens to take an object into the palm, or if a finger has fewer than three joints
        # and so cannot leave a surface in a straight line.
        wide = candidate.palm is not None or self._fewest_joints < 3
        q_open = robot.open_wide(q_touch) if wide else robot.open(candidate.contacts, _OPENING, q_touch)
        if q_open is None:
            return None
        X_OB = robot.hand_pose(q_touch)
        waiting = self._approach.waiting_pose(X_OB, robot.joint_positions(q_open))
        if waiting is None:
            return None
        X_OB_before, clearance = waiting
        names = tuple(finger.name for finger in self._description.fingers)
        normals = {contact.part: contact.n_O for contact in candidate.contacts}
        goal = GraspGoal(
            finger_names=names,
            touches=np.array([name in normals for name in names]),
            X_OB=X_OB,
            X_OB_before=X_OB_before,
            # A hand that opens wide need not keep its fingertips anywhere.
            clearance=np.inf if wide else clearance,
            p_BF_open=X_OB.inverse().multiply(robot.fingertips(q_open).T).T,
            p_OF_touch=robot.fingertips(q_touch),
            n_OF=np.array([normals.get(name, np.zeros(3)) for name in names]),
            yaw_symmetry=yaw_candidates(robot.shape)[1],
        )
        return discomfort + candidate.penalty, goal

    def _candidates(self, q_start: np.ndarray, offset: float, spacing: float | None) -> list["_Candidate"]:
        """Returns contacts within reach, the most promising first; for the arguments see `_search`.

        They are ranked by inverse kinematics without collisions, which takes a hundredth of the time and
        rarely changes the discomfort.
        """
        robot, side = self._kinematics, self._description.side
        shape = robot.shape
        lowest = max(finger.tip_radius for finger in self._description.fingers) + _TIP_GAP
        heights = contact_heights(shape, self._grip, lowest, spacing)
        if self._tip_height is not None:
            bottom, top = vertical_extent(shape)
            heights = [self._tip_height / (top - bottom)] if self._tip_height > lowest - 1e-9 else []
        candidates = []
        for step, height in enumerate(heights):
            for yaw in yaw_candidates(shape)[0]:
                contacts = grip_contacts(shape, yaw, height, self._grip, side, offset, spacing)
                palm = palm_contact(shape, yaw, height, side) if GRIPS[self._grip].palm else None
                if not self._tips_are_clear(contacts):
                    continue
                relaxed = robot.touch(contacts, palm, q_start, collisions=False)
                if relaxed is not None:
                    penalty = step * _HEIGHT_STEP
                    candidates.append(_Candidate(relaxed[0] + penalty, penalty, contacts, palm, relaxed[1]))
        return sorted(candidates, key=lambda candidate: candidate.cost)

    def _tips_are_clear(self, contacts: list[Contact]) -> bool:
        """Whether fingertips at these contacts are clear of each other."""
        radius = {finger.name: finger.tip_radius for finger in self._description.fingers}
        tips = [
            (contact.p_OC - contact.n_O * radius[contact.part], radius[contact.part]) for contact in contacts
        ]
        return all(
            np.linalg.norm(p - other_p) > r + other_r + _TIP_GAP
            for (p, r), (other_p, other_r) in itertools.combinations(tips, 2)
        )


@dc.dataclass(frozen=True)
class _Candidate:
    """Contacts that are reachable if collisions are ignored."""

    cost: float  # discomfort and penalty
    penalty: float  # discomfort for the height
    contacts: list[Contact]
    palm: Contact | None
    q: np.ndarray
