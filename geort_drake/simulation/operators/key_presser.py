"""A person who presses keys with the robot's fingers."""

import dataclasses as dc
import enum

import numpy as np

from geort_drake.simulation.operators.finger_person import FingerPerson, FingerState, SeenFingers
from geort_drake.simulation.operators.intention import SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk

_DOWN = 0.0035  # m; travel beyond which a key is seen to be down
_MOVED = 0.0005  # m; travel beyond which a key is seen to move
_PRESS = np.array([1.0, 0.0, 0.0])  # direction of a press in B


class KeyPhase(enum.IntEnum):
    """Phases of a person who presses keys."""

    SETTLE = 0  # moves the fingers above the keys
    WAIT = 1
    CHOOSE = 2  # a cue is seen
    PRESS = 3
    RELEASE = 4


@dc.dataclass
class PresserState(FingerState):
    """Memory of a person who presses keys."""

    handled_cue: int = 0  # last cue that was acted on; 0 once no cue is shown
    # (F,) height by which each fingertip is raised above its open position, m.
    raised: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))


_ACTIVE = (KeyPhase.CHOOSE, KeyPhase.PRESS, KeyPhase.RELEASE)


class KeyPresser(FingerPerson[PresserState]):
    """Presses the cued key; perceives `positions` (K,), the travel of the keys, m, and `cue` (1)."""

    phases, state = KeyPhase, PresserState

    def _advance_phase(self, state: PresserState, t: float, scene: SeenFingers) -> None:
        config, since, cue = self._intention, t - state.phase_start, round(scene.percepts["cue"][0])
        if cue == 0:
            state.handled_cue = 0
        if state.phase == KeyPhase.SETTLE:
            if since > state.settle_time:
                self._enter(state, KeyPhase.WAIT, t)
        elif state.phase == KeyPhase.WAIT:
            if cue and cue != state.handled_cue:
                state.handled_cue = cue
                state.finger = int(np.flatnonzero(self._goal.key_of == cue - 1)[0])
                self._enter(state, KeyPhase.CHOOSE, t)
        elif state.phase == KeyPhase.CHOOSE:
            if since > config.choice_time:
                self._enter(state, KeyPhase.PRESS, t)
                state.p_HF_press = state.p_HF_past[-1]
        elif state.phase == KeyPhase.PRESS:
            if scene.percepts["positions"][self._goal.key_of[state.finger]] > _DOWN or not cue:
                self._enter(state, KeyPhase.RELEASE, t)
                state.p_HF_release = state.p_HF_past[-1]
        elif since > config.press_time:
            self._enter(state, KeyPhase.WAIT, t)

    def _watched(self, state: PresserState) -> np.ndarray:
        return np.array([state.finger]) if state.phase in _ACTIVE else self._used

    def _is_free(self, state: PresserState, scene: SeenFingers, finger: int) -> bool:
        return scene.percepts["positions"][self._goal.key_of[finger]] <= _MOVED

    def _corrected(self, state: PresserState) -> list[int]:
        # A releasing finger moves back to where it began, without correction.
        released = state.finger if self._kind != SERVO and state.phase == KeyPhase.RELEASE else -1
        return [finger for finger in super()._corrected(state) if finger != released]

    def _reference(self, state: PresserState, t: float, scene: SeenFingers) -> np.ndarray:
        goal, config, since = self._goal, self._intention, t - state.phase_start
        # A finger whose key goes down without a cue is too low.
        idle = np.array([f for f in self._used if f != state.finger or state.phase == KeyPhase.WAIT])
        low = [f for f in idle if scene.percepts["positions"][goal.key_of[f]] > _MOVED]
        state.raised = state.raised.copy() if len(state.raised) else np.zeros(len(self._own))
        for finger in low:
            step = config.lift * self._config.period / config.attention_time
            state.raised[finger] = min(state.raised[finger] + step, 3 * config.lift)
        reference = goal.p_BF_open - np.outer(state.raised, _PRESS)
        if state.phase in (KeyPhase.PRESS, KeyPhase.RELEASE):
            displacement = (goal.p_BF_pressed - goal.p_BF_open)[state.finger]
            share = minimum_jerk(since / config.press_time)
            if state.phase == KeyPhase.RELEASE:
                share = 1 - share
            overdue = max(since - config.press_time - self._config.visual_delay, 0.0)
            further = min(config.push_speed * overdue, config.most_push)
            push = further if state.phase == KeyPhase.PRESS else 0.0
            reference[state.finger] += share * displacement + push * _PRESS
        return reference

    def _own_movement(self, state: PresserState, t: float, change: np.ndarray) -> np.ndarray:
        """Returns the learned motion for a press, or the way back of a release; nothing for SERVO."""
        step = np.zeros((5, 3))
        if self._kind == SERVO:
            return step
        own = self._own[state.finger]
        if state.phase == KeyPhase.RELEASE:
            step[own] = self._return(state, t)
        elif state.phase == KeyPhase.PRESS:
            step[own] = self._intended(state, state.finger, change[state.finger])
        return step
