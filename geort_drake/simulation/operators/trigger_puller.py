"""A person who holds a handle with two robot fingers and pulls its trigger with another."""

import dataclasses as dc
import enum

import numpy as np

from geort_drake.simulation.operators.finger_person import SeenFingers
from geort_drake.simulation.operators.holding import HolderState, HoldingPerson
from geort_drake.simulation.operators.intention import SERVO
from geort_drake.simulation.wrist_motion import minimum_jerk

_MOVED = 0.0005  # m; travel beyond which the pad is seen to move
_PULL = 1  # value of the cue to pull


class TriggerPhase(enum.IntEnum):
    """Phases of a person who pulls a trigger."""

    SETTLE = 0  # moves the fingers to handle and pad
    CLOSE = 1  # closes the fingers around the handle until it is felt
    SQUEEZE = 2
    WAIT = 3
    PULL = 4
    RELEASE = 5


@dc.dataclass
class PullerState(HolderState):
    """Memory of a person who pulls a trigger."""

    pushed: float = 0.0  # motion of the finger beyond touching the pad, m, kept from pull to pull
    push: float = 0.0  # change of `pushed` in the last decision, m


class TriggerPuller(HoldingPerson[PullerState]):
    """Closes two fingers around a handle, squeezes, and pulls with the index finger at each cue.

    The person perceives `travel` (1) of the pad, m, and `cue`, see `TriggerMonitor`, besides `contact`, and
    moves the index finger at `correction_rate` times the remaining travel.
    """

    phases, state = TriggerPhase, PullerState

    def _advance_phase(self, state: PullerState, t: float, scene: SeenFingers) -> None:
        super()._advance_phase(state, t, scene)
        since, cue = t - state.phase_start, round(scene.percepts["cue"][0])
        state.finger = self._goal.trigger
        if state.phase == TriggerPhase.WAIT:
            if cue == _PULL:
                self._enter(state, TriggerPhase.PULL, t)
                state.p_HF_press = state.p_HF_past[-1]
        elif state.phase == TriggerPhase.PULL:
            if cue != _PULL:
                self._enter(state, TriggerPhase.RELEASE, t)
                state.p_HF_release = state.p_HF_past[-1]
        elif state.phase == TriggerPhase.RELEASE and since > self._intention.press_time:
            self._enter(state, TriggerPhase.WAIT, t)

    @property
    def _holding(self) -> list[int]:
        return [finger for finger in self._used.tolist() if finger != self._goal.trigger]

    def _watched(self, state: PullerState) -> np.ndarray:
        if state.phase < TriggerPhase.CLOSE:
            return self._used
        closing = [finger for finger in self._holding if finger not in state.touching]
        return np.array(closing or [self._goal.trigger])

    def _corrected(self, state: PullerState) -> list[int]:
        released = self._kind != SERVO and state.phase == TriggerPhase.RELEASE
        excluded = state.touching | ({self._goal.trigger} if released else set())
        return [finger for finger in super()._corrected(state) if finger not in excluded]

    def _reference(self, state: PullerState, t: float, scene: SeenFingers) -> np.ndarray:
        goal, config, since = self._goal, self._config, t - state.phase_start
        reference = self._grip(state, t)
        travel, state.push = float(scene.percepts["travel"][0]), 0.0
        arrived = since > self._intention.press_time + config.visual_delay
        if state.phase == TriggerPhase.PULL and (arrived or travel > _MOVED):
            speed = config.correction_rate * (goal.travel - travel)
            state.push = config.period * float(np.clip(speed, -0.02, self._intention.push_speed))
            state.pushed += state.push
        if state.phase in (TriggerPhase.PULL, TriggerPhase.RELEASE):
            share = minimum_jerk(since / self._intention.press_time)
            share = share if state.phase == TriggerPhase.PULL else 1 - share
            displacement = (goal.p_BF_touch - goal.p_BF_open)[goal.trigger]
            reference[goal.trigger] += share * (displacement - state.pushed * goal.n_B)
        return reference

    def _error(self, state: PullerState, p_BF: np.ndarray, scene: SeenFingers) -> np.ndarray:
        error = super()._error(state, p_BF, scene)
        if state.phase == TriggerPhase.PULL and (self._kind != SERVO or scene.percepts["travel"][0] > _MOVED):
            # The pad alone shows how far the finger has pulled, so errors along the pull are ignored.
            error[self._goal.trigger] -= (error[self._goal.trigger] @ self._goal.n_B) * self._goal.n_B
        return error

    def _own_movement(self, state: PullerState, t: float, change: np.ndarray) -> np.ndarray:
        """Returns learned motions to close and pull, or the way back; SERVO only squeezes and pushes."""
        step = np.zeros((5, 3))
        own, trigger = self._own, self._goal.trigger
        for finger in self._holding:
            if self._kind != SERVO or state.phase == TriggerPhase.SQUEEZE:
                step[own[finger]] = self._intended(state, finger, change[finger])
        if state.phase == TriggerPhase.PULL:
            push = change[trigger] if self._kind != SERVO else -state.push * self._goal.n_B
            step[own[trigger]] = self._intended(state, trigger, push)
        elif state.phase == TriggerPhase.RELEASE and self._kind != SERVO:
            step[own[trigger]] = self._return(state, t)
        return step
