"""A person who grasps with intended motions: MIMICRY and ADAPTIVE make them with their own fingers.

Each motion of the fingers (open, surround, close, squeeze) is made as the robot should move, or as the person
has learned that it is needed. The person corrects the errors of the fingers that they look at: the thumb and
each opposing finger in turn. They do not know the retargeting map.
"""

import dataclasses as dc

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import limited
from geort_drake.simulation.operators.goal import GraspGoal
from geort_drake.simulation.operators.intention import (
    ADAPTIVE,
    MIMICRY,
    SERVO,
    IntentionConfig,
    LearnedMotion,
    learned_in_play,
)
from geort_drake.simulation.operators.state import OperatorState, Phase


class IntendingPerson(GraspingPerson):
    """A grasping person of any kind.

    Args:
        hand, goal, config, rng: see `GraspingPerson`.
        kind: SERVO, MIMICRY or ADAPTIVE.
    """

    def __init__(
        self,
        hand: HumanHand,
        goal: GraspGoal,
        config: OperatorConfig,
        rng: np.random.Generator,
        kind: str,
        intention: IntentionConfig,
    ):
        super().__init__(hand, goal, config, rng)
        intention.validate()
        self._kind, self._intention = kind, intention
        thumb = np.array([name == "thumb" for name in goal.finger_names])
        self._opposing = np.flatnonzero(goal.touches & ~thumb)
        # A separate generator, so that what is learned does not change other random numbers.
        self._intention_rng = rng.spawn(1)[0]

    def start(self, X_WH: RigidTransform) -> OperatorState:
        learned = LearnedMotion.unlearned(len(self._own), self._intention)
        play = self._goal.play
        if self._kind == ADAPTIVE and play is not None and len(play.p_HF):
            nearest = np.linalg.norm(play.p_BF - self._goal.p_BF_open, axis=-1).argmin(axis=0)
            p_HF = play.p_HF[nearest, np.arange(len(nearest))]
            learned = learned_in_play(play, p_HF, self._intention, self._config, self._intention_rng)
        return dc.replace(super().start(X_WH), learned=learned)

    def _expected(self, state: OperatorState, own: np.ndarray) -> np.ndarray:
        assert state.learned is not None  # set at the start
        return np.einsum("fij,fj->fi", state.learned.J, own)

    def _own_motion(self, state: OperatorState, robot: np.ndarray) -> np.ndarray:
        """Returns the own motion (F, 3), m, expected to move the robot's fingertips by `robot` (F, 3), m."""
        assert state.learned is not None  # set at the start
        return np.array([state.learned.own_motion(f, motion) for f, motion in enumerate(robot)])

    def _wanted_velocity(
        self, state: OperatorState, t: float, error: np.ndarray, limit: np.ndarray
    ) -> np.ndarray:
        if self._kind == SERVO:
            return super()._wanted_velocity(state, t, error, limit)
        if state.intended is None:  # a new phase: corrects the seen error; a release moves back to its start
            state.intended = error
            if state.phase in (Phase.OPEN, Phase.RELEASE):
                assert state.p_HF_open is not None  # set before the fingers close
                state.intended = self._expected(state, (state.p_HF_open - state.p_HF_past[-1])[self._own])
        velocity = limited(state.intended / self._config.period, limit)
        state.intended = state.intended - self._config.period * velocity
        rate = self._intention.mimicry_rate if self._kind == MIMICRY else self._config.correction_rate
        velocity += rate * self._attended(t)[:, None] * (error - state.intended)
        return self._own_motion(state, velocity)

    def _attended(self, t: float) -> np.ndarray:
        """Returns whether each finger (F,) is looked at."""
        turn = int(t / self._intention.attention_time) % len(self._opposing)
        attended = self._goal.touches.copy()
        attended[self._opposing] = False
        attended[self._opposing[turn]] = True
        return attended

    def _inwards(self, state: OperatorState, share: float) -> np.ndarray:
        if self._kind == SERVO:
            return super()._inwards(state, share)
        assert state.n_BF is not None  # set when the squeeze begins
        return self._own_motion(state, self._config.squeeze * share * state.n_BF)

    def _enter(self, state: OperatorState, phase: Phase, t: float) -> None:
        super()._enter(state, phase, t)
        if phase == Phase.SURROUND:
            state.p_HF_open = state.p_HF_past[-1]
