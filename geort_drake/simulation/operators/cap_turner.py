"""A person who unscrews a cap with the robot's fingers."""

import dataclasses as dc
import enum

import numpy as np

from geort_drake.simulation.operators.finger_person import SeenFingers
from geort_drake.simulation.operators.holding import HolderState, HoldingPerson
from geort_drake.simulation.operators.intention import SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk

_TURNED = np.deg2rad(1.0)  # a cap that has turned so far is seen to turn


class CapPhase(enum.IntEnum):
    """What the person is doing."""

    SETTLE = 0  # moves the fingers around the cap
    CLOSE = 1  # until the cap is felt
    SQUEEZE = 2
    TURN = 3
    OPEN = 4
    RETURN = 5  # to the beginning of a stroke


@dc.dataclass
class TurnerState(HolderState):
    """Memory of a person who unscrews a cap; `depth` is inwards from its surface."""

    squeezed: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))  # depth when the hand began to open
    turn: float = 0.0  # intended place in the stroke, rad
    # Largest turn seen in this stroke, rad, and when it last grew, s.
    farthest: float = 0.0
    progress_at: float = 0.0


class CapTurner(HoldingPerson[TurnerState]):
    """Closes the fingers around a cap, squeezes, turns, opens and returns, again and again.

    Perceives by how much the cap is `turned` (1), rad, besides the `contact`. A stroke ends when the cap is
    not seen to turn any more. Touch, not sight, tells how deep a squeeze is, and how to undo it.
    """

    phases, state, begins_open = CapPhase, TurnerState, True

    def _advance_phase(self, state: TurnerState, t: float, scene: SeenFingers) -> None:
        config, since = self._config, t - state.phase_start
        if not len(state.depth):
            state.depth = np.full(len(self._own), -self._goal.gap)
        if state.phase <= CapPhase.CLOSE:
            super()._advance_phase(state, t, scene)
        elif state.phase == CapPhase.SQUEEZE:
            if since > config.squeeze_time:
                self._enter(state, CapPhase.TURN, t)
                state.farthest, state.progress_at = -np.inf, t
        elif state.phase == CapPhase.TURN:
            turned = np.sign(self._goal.stroke) * scene.percepts["turned"][0]
            if turned > state.farthest + _TURNED:
                state.farthest, state.progress_at = turned, t
            is_made = since > self._stroke_time + config.visual_delay
            if is_made and t - state.progress_at > config.patience:
                self._enter(state, CapPhase.OPEN, t)
                state.squeezed = state.depth
        elif state.phase == CapPhase.OPEN:
            if since > config.squeeze_time + config.visual_delay:
                state.touching = frozenset()
                self._enter(state, CapPhase.RETURN, t)
        elif since > self._stroke_time + config.visual_delay + config.settle_time:
            self._enter(state, CapPhase.CLOSE, t)
            state.attempt += 1

    @property
    def _stroke_time(self) -> float:
        """Duration of a stroke's minimum-jerk movement, s."""
        goal = self._goal
        length = abs(goal.stroke) * np.linalg.norm((goal.p_BF_open - goal.p_BC)[goal.thumb])
        return max(self._config.min_movement_time, 1.875 * length / self._config.max_fingertip_speed)

    def _watched(self, state: TurnerState) -> np.ndarray:
        closing = [finger for finger in self._used.tolist() if finger not in state.touching]
        return np.array(closing) if closing and state.phase == CapPhase.CLOSE else self._used

    def _corrected(self, state: TurnerState) -> list[int]:
        if state.phase in (CapPhase.SQUEEZE, CapPhase.OPEN):
            return []
        still = state.touching if state.phase == CapPhase.CLOSE else frozenset()
        return [finger for finger in super()._corrected(state) if finger not in still]

    def _reference(self, state: TurnerState, t: float, scene: SeenFingers) -> np.ndarray:
        goal, config, since = self._goal, self._config, t - state.phase_start
        share = minimum_jerk(since / self._stroke_time)
        if state.phase == CapPhase.CLOSE:
            self._close(state)
        elif state.phase == CapPhase.SQUEEZE:
            state.depth = state.depth + config.squeeze * self._progress(since, config.squeeze_time)
        elif state.phase == CapPhase.TURN:
            state.turn = share * goal.stroke
        elif state.phase == CapPhase.OPEN:
            opened = minimum_jerk(since / config.squeeze_time)
            state.depth = (1 - opened) * state.squeezed - opened * goal.gap
        elif state.phase == CapPhase.RETURN:
            state.turn = (1 - share) * goal.stroke
        return goal.fingertips(state.turn, state.depth)

    def _error(self, state: TurnerState, p_BF: np.ndarray, scene: SeenFingers) -> np.ndarray:
        error = super()._error(state, p_BF, scene)
        if state.phase == CapPhase.TURN:
            # The surface is in the way of a squeeze: only the way around the axis and along it is seen.
            out = (p_BF - self._goal.p_BC) * [0.0, 1.0, 1.0]
            out /= np.linalg.norm(out, axis=1, keepdims=True)
            error -= np.sum(error * out, axis=1, keepdims=True) * out
        return error

    def _own_movement(self, state: TurnerState, t: float, change: np.ndarray) -> np.ndarray:
        """Of the intended motion as learned; each kind squeezes and opens so."""
        step = np.zeros((5, 3))
        if self._kind == SERVO and state.phase not in (CapPhase.SQUEEZE, CapPhase.OPEN):
            return step
        for finger in self._used:
            step[self._own[finger]] = self._intended(state, int(finger), change[finger])
        return step
