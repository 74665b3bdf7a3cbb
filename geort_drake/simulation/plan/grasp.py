"""Plans the grasp of an object: hand poses and contacts.

The planner knows the object's shape and grip, the robot and its surroundings, but no retargeter. It places
contacts on the object at several yaws and heights, and takes the most comfortable collision-free posture of
arm and hand that reaches them.
"""

import itertools
import math
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.plan.approach import APPROACH_CLEARANCE, GraspApproach
from geort_drake.simulation.plan.contacts import (
    GRIPS,
    Contact,
    contact_heights,
    finger_offsets,
    grip_contacts,
    grip_of,
    vertical_extent,
    yaw_candidates,
)
from geort_drake.simulation.plan.fingertips import require_fingers
from geort_drake.simulation.plan.kinematics import GraspKinematics
from geort_drake.simulation.scenario import Scenario

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
# Number of places of an open thumb to try, for a hand that has a finger with one or two joints.
_THUMBS = 64


class GraspPlanner:
    """Plans grasps of one object with the scenario's robot.

    If the object's grip gives no grasp, the planner tries contacts as close together as the hand's fingers,
    and then the next grip of power, tripod and pinch.

    Args:
        grip: one of `GRIPS`; None for the object's.
        tip_height: height of the fingertips above the object's bottom, m; None for `contact_heights`.
        X_WP: pose to which the arm must be able to bring the grasped object; None for no such place.

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
        X_WP: RigidTransform | None = None,
    ):
        self._grip, self._tip_height = grip or grip_of(scenario.object.name), tip_height
        self._X_WP = X_WP
        require_fingers(description, GRIPS[self._grip], f"a {self._grip} grasp needs")
        self._description = description
        self._scenario = scenario
        grasping = [finger for finger in description.fingers if finger.name in GRIPS[self._grip]]
        # Least height of a fingertip's centre above the object's support, m.
        self._lowest = max(finger.tip_radius for finger in description.fingers) + _TIP_GAP
        self._fewest_joints = min(len(finger.joints) for finger in grasping)
        self._kinematics = GraspKinematics(scenario, description, list(GRIPS[self._grip]))
        robot = self._kinematics
        self._approach = GraspApproach(
            description,
            scenario.object.name,
            robot.hand_pose(robot.q_default),
            robot.joint_positions(robot.q_default),
        )

    def plans(self, enough: int = 20) -> list[GraspGoal]:
        """Returns up to `enough` different grasps, the most comfortable first; deterministic.

        A grasp of a hand that has a finger with one or two joints is returned once for each opening.

        Raises:
            ScenarioError: no grasp is found.
        """
        robot = self._kinematics
        offsets = finger_offsets(robot.shape, self._grip)
        grasps = self._search(robot.q_default, [(offset, math.inf) for offset in offsets], enough)
        if not grasps:
            grasps = self._search(robot.q_middle, [(offsets[0], robot.finger_spacing)], enough)
        if grasps:
            return [goal for _, goals in sorted(grasps, key=itemgetter(0)) for goal in goals]
        if self._grip in _FALLBACK_GRIPS and self._tip_height is None:
            fallback = _FALLBACK_GRIPS[self._grip]
            return GraspPlanner(self._scenario, self._description, fallback, X_WP=self._X_WP).plans(enough)
        reason = f"no collision-free {self._grip} grasp was found"
        if self._X_WP is not None:
            reason += f" with which the arm reaches the place at {self._X_WP.translation().round(3).tolist()}"
        if self._tip_height is None and not contact_heights(robot.shape, self._grip, self._lowest):
            bottom, top = vertical_extent(robot.shape)
            reason = (
                f"it is {1e3 * (top - bottom):.1f} mm high, too low for fingertips whose centres stay "
                f"{1e3 * self._lowest:.1f} mm above its support"
            )
        raise ScenarioError(
            f"the robot cannot grasp object '{self._scenario.object.name}' at "
            f"{self._scenario.object.position}: {reason}"
        )

    def _search(
        self, q_start: np.ndarray, distances: list[tuple[float, float]], enough: int
    ) -> list[tuple[float, list[GraspGoal]]]:
        """Returns up to `enough` grasps with their costs, each with its openings.

        Args:
            q_start: initial positions of the plant.
            distances: `offset` and `spacing` of `grip_contacts`, in order of preference.
        """
        grasps: list[tuple[float, list[GraspGoal]]] = []
        for offset, spacing in distances:
            for candidate in self._candidates(q_start, offset, spacing)[:_TRIES]:
                if len(grasps) == enough:
                    break
                grasp = self._grasp_from(candidate)
                if grasp is not None:
                    grasps.append(grasp)
        return grasps

    def _grasp_from(self, candidate: "_Candidate") -> tuple[float, list[GraspGoal]] | None:
        """Returns cost and goals of a collision-free grasp that the open hand can approach, or None."""
        robot = self._kinematics
        # At a low object, the support often separates the first guess from all solutions.
        guesses = (
            [candidate.q] if self._tip_height is None else [candidate.q, robot.q_default, robot.q_middle]
        )
        touched = (robot.touch(candidate.contacts, guess) for guess in guesses)
        solution = next((solution for solution in touched if solution is not None), None)
        if solution is None:
            return None
        discomfort, q_touch = solution
        X_OB = robot.hand_pose(q_touch)
        if self._X_WP is not None and not robot.reaches(self._X_WP @ X_OB, q_touch):
            return None
        names = tuple(finger.name for finger in self._description.fingers)
        normals = {contact.part: contact.n_O for contact in candidate.contacts}
        touch = {
            "finger_names": names,
            "touches": np.array([name in normals for name in names]),
            "X_OB": X_OB,
            "p_OF_touch": robot.fingertips(q_touch),
            "n_OF": np.array([normals.get(name, np.zeros(3)) for name in names]),
            "yaw_symmetry": yaw_candidates(robot.shape)[1],
            "weight": robot.weight,
        }
        goals = [
            GraspGoal(
                **touch,
                X_OB_before=X_OB_before,
                clearance=clearance,
                p_BF_open=X_OB.inverse().multiply(robot.fingertips(q_open).T).T,
            )
            for q_open, X_OB_before, clearance in self._openings(candidate, q_touch, X_OB)
        ]
        return (discomfort + candidate.penalty, goals) if goals else None

    def _openings(
        self, candidate: "_Candidate", q_touch: np.ndarray, X_OB: RigidTransform
    ) -> list[tuple[np.ndarray, RigidTransform, float]]:
        """Returns positions of the open hand, X_OB of the waiting hand, and the clearance; best first."""
        robot, palm = self._kinematics, candidate.contacts[-1].part == "palm"
        if self._fewest_joints >= 3:
            # The whole hand opens to take an object into the palm, and need not keep its fingertips anywhere.
            q = robot.open_wide(q_touch) if palm else robot.open(candidate.contacts, _OPENING, q_touch)
            waiting = None if q is None else self._approach.waiting_pose(X_OB, robot.joint_positions(q))
            return [] if q is None or waiting is None else [(q, waiting[0], np.inf if palm else waiting[1])]
        # A finger with fewer joints cannot leave a surface in a straight line. Fingers go to their default
        # positions; the thumb has a choice, because a person may be unable to show its default position.
        openings = []
        for q in robot.open_thumbs(q_touch, _THUMBS):
            waiting = self._approach.waiting_pose(X_OB, robot.joint_positions(q))
            if waiting is not None:
                openings.append((q, *waiting))
        least = min(max((clearance for *_, clearance in openings), default=0.0), APPROACH_CLEARANCE)
        return [opening for opening in openings if opening[2] >= 0.9 * least]

    def _candidates(self, q_start: np.ndarray, offset: float, spacing: float) -> list["_Candidate"]:
        """Returns contacts within reach, the most promising first; for the arguments see `_search`.

        They are ranked by inverse kinematics without collisions, which takes a hundredth of the time and
        rarely changes the discomfort.
        """
        robot, side = self._kinematics, self._description.side
        shape = robot.shape
        heights = contact_heights(shape, self._grip, self._lowest, spacing)
        if self._tip_height is not None:
            bottom, top = vertical_extent(shape)
            heights = [self._tip_height / (top - bottom)] if self._tip_height > self._lowest - 1e-9 else []
        candidates = []
        for step, height in enumerate(heights):
            for yaw in yaw_candidates(shape)[0]:
                contacts = grip_contacts(shape, yaw, height, self._grip, side, offset, spacing)
                if not self._tips_are_clear(contacts):
                    continue
                relaxed = robot.touch(contacts, q_start, collisions=False)
                if relaxed is not None:
                    penalty = step * _HEIGHT_STEP
                    candidates.append(_Candidate(relaxed[0] + penalty, penalty, contacts, relaxed[1]))
        return sorted(candidates, key=lambda candidate: candidate.cost)

    def _tips_are_clear(self, contacts: list[Contact]) -> bool:
        """Whether fingertips at these contacts are clear of each other."""
        radius = {finger.name: finger.tip_radius for finger in self._description.fingers}
        tips = [
            (contact.p_OC - contact.n_O * radius[contact.part], radius[contact.part])
            for contact in contacts
            if contact.part != "palm"
        ]
        return all(
            np.linalg.norm(p - other_p) > r + other_r + _TIP_GAP
            for (p, r), (other_p, other_r) in itertools.combinations(tips, 2)
        )


class _Candidate(NamedTuple):
    """Contacts that are reachable if collisions are ignored."""

    cost: float  # discomfort and penalty
    penalty: float  # discomfort for the height
    contacts: list[Contact]
    q: np.ndarray
