"""A person who closes the robot's fingers around something and squeezes it."""

import dataclasses as dc
from typing import TypeVar

import numpy as np

from geort_drake.simulation.operators.finger_person import FingerPerson, FingerState, SeenFingers

# The first phases of every such person: move the fingers to their open positions; close them until the person
# feels the object; squeeze; wait for a cue.
SETTLE, CLOSE, SQUEEZE, WAIT = range(4)


@dc.dataclass
class HolderState(FingerState):
    """Memory of a person who holds something."""

    # (F,) motion of each fingertip from its open position towards the object, m.
    depth: np.ndarray = dc.field(default_factory=lambda: np.zeros(0))
    touching: frozenset[int] = frozenset()  # fingers that count as touching


State = TypeVar("State", bound=HolderState)


class HoldingPerson(FingerPerson[State]):
    """A person who closes the fingers and squeezes; perceives `contact` (F), N.

    Holding fingers keep their posture once they have squeezed. The goal has `p_BF_touch`.
    """

    @property
    def _holding(self) -> list[int]:
        """The fingers that hold."""
        return self._used.tolist()

    def _advance_phase(self, state: State, t: float, scene: SeenFingers) -> None:
        config, since = self._config, t - state.phase_start
        if not len(state.depth):
            state.depth = np.zeros(len(self._own))
        if state.phase == SETTLE:
            if since > state.settle_time and self._is_shaped(state, t, scene):
                self._enter(state, self.phases(CLOSE), t)
        elif state.phase == CLOSE:
            felt = np.flatnonzero(self._felt(scene) > config.touch_force)
            state.touching |= set(felt.tolist()) & set(self._holding)
            if len(state.touching) == len(self._holding) or since > self._longest_closing:
                state.touching = frozenset(self._holding)
                self._enter(state, self.phases(SQUEEZE), t)
        elif state.phase == SQUEEZE and since > config.squeeze_time + config.settle_time:
            self._enter(state, self.phases(WAIT), t)

    def _is_shaped(self, state: State, t: float, scene: SeenFingers) -> bool:
        """Whether the settled fingers are near enough to their open positions; if not, they are corrected."""
        return True

    @property
    def _longest_closing(self) -> float:
        """Time after which the closing fingers are seen to have moved `overshoot` beyond the surface, s."""
        gap = np.linalg.norm(self._goal.p_BF_touch - self._goal.p_BF_open, axis=1)[self._holding].max()
        return (gap + self._config.overshoot) / self._config.closing_speed + self._config.visual_delay

    def _felt(self, scene: SeenFingers) -> np.ndarray:
        """Returns the felt forces on the fingers, (F,) N."""
        noise = 1 + self._rng.normal(0, self._config.contact_noise, len(self._own))
        return self._config.touch * noise * scene.percepts["contact"]

    def _is_free(self, state: State, scene: SeenFingers, finger: int) -> bool:
        return finger not in state.touching and scene.percepts["contact"][finger] < self._config.touch_force

    def _close(self, state: State) -> None:
        """Moves the fingers that do not touch yet towards the object, for one period."""
        closing = [finger for finger in self._holding if finger not in state.touching]
        state.depth = state.depth.copy()
        state.depth[closing] += self._config.closing_speed * self._config.period

    def _grip(self, state: State, t: float) -> np.ndarray:
        """Returns the intended positions of the fingertips for the grip alone, (F, 3) m in B.

        The goal has `n_B`, the direction away from the object, (3,) or (F, 3).
        """
        config = self._config
        if state.phase == CLOSE:
            self._close(state)
        elif state.phase == SQUEEZE and t - state.phase_start <= config.squeeze_time:
            state.depth = state.depth.copy()
            state.depth[self._holding] += config.squeeze * config.period / config.squeeze_time
        return self._goal.p_BF_open - state.depth[:, None] * self._goal.n_B
