"""A person who grasps an object and brings it to a place: carry, lower, open, retreat, and retry.

The person intends a motion of the object and moves their hand as if it held the object; they assume that
the robot hand moves alike. MIMICRY and ADAPTIVE also make each motion of the fingers (open, surround, close,
squeeze) with their own fingers, and correct the pinch. The person does not know the retargeting map.
"""

import dataclasses as dc
import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import limited
from geort_drake.simulation.operators.intention import (
    ADAPTIVE,
    MIMICRY,
    SERVO,
    IntentionConfig,
    LearnedMotion,
    learned_in_play,
)
from geort_drake.simulation.operators.perception import Seen, VisualError
from geort_drake.simulation.operators.state import OperatorState, Phase
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.systems.port_values import rotation_of_vector


class PlacingPerson(GraspingPerson):
    """Grasps an object and brings it to its place.

    The object's tilt is left to gravity: only its position and its yaw are corrected.

    Args:
        hand, goal, config, rng: see `GraspingPerson`.
        kind: SERVO, MIMICRY or ADAPTIVE.
        hover: height above its place from which the object is lowered, m.
    """

    def __init__(
        self,
        hand: HumanHand,
        goal: GraspGoal,
        config: OperatorConfig,
        rng: np.random.Generator,
        kind: str,
        intention: IntentionConfig,
        hover: float,
    ):
        super().__init__(hand, goal, config, rng)
        intention.validate()
        self._kind, self._intention, self._hover = kind, intention, hover
        # A separate generator, so that the errors of the place do not change other random numbers.
        self._place_rng = rng.spawn(1)[0]

    def start(self, X_WH: RigidTransform) -> OperatorState:
        error = VisualError.draw(0, self._config, self._place_rng)
        learned = LearnedMotion.unlearned(len(self._own), self._intention)
        play = self._goal.play
        if self._kind == ADAPTIVE and play is not None and len(play.p_HF):
            nearest = np.linalg.norm(play.p_BF - self._goal.p_BF_open, axis=-1).argmin(axis=0)
            p_HF = play.p_HF[nearest, np.arange(len(nearest))]
            learned = learned_in_play(play, p_HF, self._intention, self._config, self._place_rng)
        return dc.replace(super().start(X_WH), place_error=error, learned=learned)

    def step(self, state: OperatorState, t: float, scene: Seen) -> OperatorState:
        assert state.place_error is not None and scene.X_WP is not None  # set at the start
        error = state.place_error.later(self._config, self._place_rng)
        X_WP = RigidTransform(
            rotation_of_vector(error.turn[0]) @ scene.X_WP.rotation(), scene.X_WP.translation() + error.p[0]
        )
        return super().step(dc.replace(state, place_error=error), t, dc.replace(scene, X_WP=X_WP))

    def _expected(self, state: OperatorState, own: np.ndarray) -> np.ndarray:
        assert state.learned is not None  # set at the start
        return np.einsum("fij,fj->fi", state.learned.J, own)

    def _own_motion(self, state: OperatorState, robot: np.ndarray) -> np.ndarray:
        """Returns the own motion (F, 3), m, expected to move the robot's fingertips by `robot` (F, 3), m."""
        assert state.learned is not None  # set at the start
        return np.array([state.learned.own_motion(f, motion) for f, motion in enumerate(robot)])

    def _wanted_velocity(self, state: OperatorState, error: np.ndarray, limit: np.ndarray) -> np.ndarray:
        if self._kind == SERVO:
            return super()._wanted_velocity(state, error, limit)
        if state.intended is None:  # a new phase: corrects the seen error; a release moves back to its start
            state.intended = error
            if state.phase in (Phase.OPEN, Phase.RELEASE):
                assert state.p_HF_open is not None  # set before the fingers close
                state.intended = self._expected(state, (state.p_HF_open - state.p_HF_past[-1])[self._own])
        velocity = limited(state.intended / self._config.period, limit)
        state.intended = state.intended - self._config.period * velocity
        rate = self._intention.mimicry_rate if self._kind == MIMICRY else self._config.correction_rate
        # The fingers of a pinch are looked at together.
        velocity += rate * self._goal.touches[:, None] * (error - state.intended)
        return self._own_motion(state, velocity)

    def _inwards(self, state: OperatorState, share: float) -> np.ndarray:
        if self._kind == SERVO:
            return super()._inwards(state, share)
        assert state.n_BF is not None  # set when the squeeze begins
        return self._own_motion(state, self._config.squeeze * share * state.n_BF)

    def _enter(self, state: OperatorState, phase: Phase, t: float) -> None:
        super()._enter(state, phase, t)
        if phase == Phase.SURROUND:
            state.p_HF_open = state.p_HF_past[-1]

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
        """Returns the seen motion from object to place: yaw about the object's origin, translation in W."""
        assert seen.X_WP is not None  # see `step`
        yaw = _yaw(seen.X_WP) - _yaw(seen.X_WO)
        symmetry = self._goal.yaw_symmetry
        yaw = math.remainder(yaw, symmetry) if symmetry else 0.0
        return RigidTransform(
            RotationMatrix.MakeZRotation(yaw), seen.X_WP.translation() - seen.X_WO.translation()
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


def _yaw(X: RigidTransform) -> float:
    R = X.rotation().matrix()
    return math.atan2(R[1, 0], R[0, 0])
