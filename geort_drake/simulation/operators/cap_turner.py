"""A person who unscrews a cap with the robot's fingers."""

import dataclasses as dc
import enum

import numpy as np

from geort_drake.simulation.operators.finger_person import SeenFingers
from geort_drake.simulation.operators.holding import HolderState, HoldingPerson
from geort_drake.simulation.operators.intention import SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk

_VISIBLE_TURN = np.deg2rad(1.0)  # smallest turn of the cap that is seen as progress


class CapPhase(enum.IntEnum):
    """Phases of a person who unscrews a cap."""

    SETTLE = 0  # moves the fingers around the cap
    CLOSE = 1  # until the cap is felt
    SQUEEZE = 2
    TURN = 3
    OPEN = 4
    RETURN = 5  # to the beginning of a stroke


@dc.dataclass
class TurnerState(HolderState):
    """Memory of a person who unscrews a cap; `depth` is inwards from its surface."""

    squeezed: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))  # depth when opening began
    turn: float = 0.0  # intended position in the stroke, rad
    # Largest turn seen in this stroke, rad, and when it last grew, s.
    farthest: float = 0.0
    progress_at: float = 0.0


class CapTurner(HoldingPerson[TurnerState]):
    """Closes the fingers around a cap, squeezes, turns, opens and returns, again and again.

    The person perceives `positions` (1), the cap's turn, rad, besides `contact`. A stroke ends when the cap
    is seen to turn no further. Squeezing and opening are not corrected by sight.
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
            turned = np.sign(self._goal.stroke) * scene.percepts["positions"][0]
            if turned > state.farthest + _VISIBLE_TURN:
                state.farthest, state.progress_at = turned, t
            stroke_over = since > self._stroke_time + config.visual_delay
            if stroke_over and t - state.progress_at > config.patience:
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
        excluded = state.touching if state.phase == CapPhase.CLOSE else frozenset()
        return [finger for finger in super()._corrected(state) if finger not in excluded]

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
            # The surface stops the squeezing fingertips, so errors normal to it are ignored.
            normal = (p_BF - self._goal.p_BC) * [0.0, 1.0, 1.0]
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            error -= np.sum(error * normal, axis=1, keepdims=True) * normal
        return error

    def _own_movement(self, state: TurnerState, t: float, change: np.ndarray) -> np.ndarray:
        """Returns the learned motion for the intended one; SERVO uses it only to squeeze and open."""
        step = np.zeros((5, 3))
        if self._kind == SERVO and state.phase not in (CapPhase.SQUEEZE, CapPhase.OPEN):
            return step
        for finger in self._used:
            step[self._own[finger]] = self._intended(state, int(finger), change[finger])
        return step
