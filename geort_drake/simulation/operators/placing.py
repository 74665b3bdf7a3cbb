"""A person who grasps an object and brings it to a place: carry, lower, open, retreat, and retry.

The person intends a motion of the object and moves their hand as if it held the object; they assume that
the robot hand moves alike.
"""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.goal import GraspGoal
from geort_drake.simulation.operators.intending import IntendingPerson
from geort_drake.simulation.operators.intention import IntentionConfig
from geort_drake.simulation.operators.perception import Seen, VisualError
from geort_drake.simulation.operators.state import OperatorState, Phase
from geort_drake.systems.port_values import rotation_of_vector


class PlacingPerson(IntendingPerson):
    """Grasps an object and brings it to its place.

    Args:
        hand, goal, config, rng, kind, intention: see `IntendingPerson`.
        hover: height above its place from which the object is lowered, m.
        upright: whether the person turns the object upright; otherwise, its tilt is left to gravity.
    """

    def __init__(
        self,
        hand: HumanHand,
        goal: GraspGoal,
        config: OperatorConfig,
        rng: np.random.Generator,
        kind: str,
        intention: IntentionConfig,
        *,
        hover: float,
        upright: bool,
    ):
        super().__init__(hand, goal, config, rng, kind, intention)
        self._hover, self._upright = hover, upright

    def start(self, X_WH: RigidTransform) -> OperatorState:
        error = VisualError.draw(0, self._config, self._intention_rng)
        return dc.replace(super().start(X_WH), place_error=error)

    def step(self, state: OperatorState, t: float, scene: Seen) -> OperatorState:
        assert state.place_error is not None and scene.X_WP is not None  # set at the start
        error = state.place_error.later(self._config, self._intention_rng)
        X_WP = RigidTransform(
            rotation_of_vector(error.turn[0]) @ scene.X_WP.rotation(), scene.X_WP.translation() + error.p[0]
        )
        return super().step(dc.replace(state, place_error=error), t, dc.replace(scene, X_WP=X_WP))

    def _advance_phase(self, state: OperatorState, t: float, seen: Seen) -> None:
        rests = self._wrist_rests(state, t)
        wrist_arrived = rests and (state.movements >= self._config.max_corrections or self._at(state, seen))
        if state.phase in (Phase.CARRY, Phase.LOWER) and self._has_slipped(state):
            self._enter(state, Phase.RELEASE, t)
            state.attempt += 1
        elif state.phase == Phase.CARRY:
            if wrist_arrived:
                self._enter(state, Phase.LOWER, t)
        elif state.phase == Phase.LOWER:
            # An object that is still above its place stands on something else.
            if rests and state.movement is not None:
                down = self._to_place(seen).translation()[2] > -self._config.reach_tolerance
                self._enter(state, Phase.OPEN if down else Phase.CARRY, t)
        elif state.phase == Phase.OPEN:
            if self._worst_error(state) < self._config.shape_tolerance or self._fingers_at_limit(state, t):
                self._enter(state, Phase.RETREAT, t)
        elif state.phase == Phase.RETREAT:
            distance = np.linalg.norm(self._to_place(seen).translation())
            if wrist_arrived and distance > 2 * self._config.reach_tolerance:
                self._enter(state, Phase.REACH, t)
                state.attempt += 1
        else:
            super()._advance_phase(state, t, seen)
            if state.phase == Phase.HOLD:
                self._enter(state, Phase.CARRY, t)

    def _to_place(self, seen: Seen) -> RigidTransform:
        """Returns the seen motion from object to place: rotation and translation of the origin in W."""
        assert seen.X_WP is not None  # see `step`
        R_WO = seen.X_WO.rotation()
        R = RotationMatrix()
        if self._upright:
            R = _tilt_to(R_WO.col(2), seen.X_WP.rotation().col(2))
        yaw, symmetry = _yaw(seen.X_WP.rotation()) - _yaw(R @ R_WO), self._goal.yaw_symmetry
        yaw = math.remainder(yaw, symmetry) if symmetry else 0.0
        return RigidTransform(
            RotationMatrix.MakeZRotation(yaw) @ R, seen.X_WP.translation() - seen.X_WO.translation()
        )

    def _target_hand_pose(self, state: OperatorState, seen: Seen) -> RigidTransform:
        if state.phase != Phase.CARRY:
            return super()._target_hand_pose(state, seen)
        motion = self._to_place(seen)
        p_OB_W = seen.X_WB.translation() - seen.X_WO.translation()
        above = seen.X_WO.translation() + motion.translation() + [0, 0, self._hover]
        return RigidTransform(motion.rotation() @ seen.X_WB.rotation(), above + motion.rotation() @ p_OB_W)

    def _reach_tolerance(self, state: OperatorState) -> float:
        carrying = state.phase == Phase.CARRY
        return self._intention.place_tolerance if carrying else super()._reach_tolerance(state)

    def _wrist_shift(
        self, state: OperatorState, t: float, seen: Seen
    ) -> tuple[np.ndarray, RotationMatrix] | None:
        if state.phase == Phase.OPEN or (state.phase == Phase.LOWER and state.movement is not None):
            return None
        if state.phase == Phase.LOWER:
            down = min(self._to_place(seen).translation()[2], 0.0) - self._intention.place_overshoot
            return np.array([0.0, 0.0, down]), RotationMatrix()
        return super()._wrist_shift(state, t, seen)


def _yaw(R: RotationMatrix) -> float:
    return math.atan2(R.matrix()[1, 0], R.matrix()[0, 0])


def _tilt_to(v: np.ndarray, u: np.ndarray) -> RotationMatrix:
    """Returns the smallest rotation that turns the unit vector v to u."""
    normal = np.cross(v, u)
    sine = np.linalg.norm(normal)
    return rotation_of_vector(normal / max(sine, 1e-12) * math.atan2(sine, v @ u))
