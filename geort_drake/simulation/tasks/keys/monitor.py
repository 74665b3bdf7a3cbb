"""Cues presses and judges them: the cued key must go down, the others stay still."""

import dataclasses as dc
import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context

from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings


@dc.dataclass(frozen=True)
class KeysSettings(TaskSettings):
    """Number and timing of the presses, and criteria for one to count."""

    # Number of cues; time before the first, longest time of a cue, and time between two, s. A cue ends when
    # its key was pressed and is up again.
    presses: float = 12
    ready_time: float = 6.0
    cue_time: float = 2.0
    rest_time: float = 0.5
    # During the cue, the cued key must go down by more than `depth` and no other by more than `still`, m.
    depth: float = 0.003
    still: float = 0.0005
    # Number of counted presses needed for success.
    enough: float = 10


@dc.dataclass(frozen=True)
class Press:
    """One cued press; lengths in m, times in s."""

    key: int
    depth: float = 0.0  # largest travel of the cued key
    others: float = 0.0  # largest travel of another key
    time: float = math.nan  # time from the cue until the key was down

    def seen(self, travel: np.ndarray, since: float, down: float) -> "Press":
        """Updates with the keys' travel (K,), `since` s after the cue; beyond `down` a key is down."""
        depth, others = float(travel[self.key]), float(np.delete(travel, self.key).max(initial=0.0))
        time = since if math.isnan(self.time) and depth > down else self.time
        return Press(self.key, max(self.depth, depth), max(self.others, others), time)


@dc.dataclass(frozen=True)
class KeysOutcome(Outcome):
    """The presses so far."""

    settings: KeysSettings
    # When the next cue follows, s after the task began; and since when the present cue is shown, s; NaN
    # between cues.
    next_cue: float
    cued_since: float = math.nan
    presses: tuple[Press, ...] = ()
    over: bool = False

    def clean(self, press: Press) -> bool:
        """Whether a press counts."""
        return press.depth > self.settings.depth and press.others < self.settings.still

    @property
    def score(self) -> float:
        """Fraction of the presses that count."""
        return sum(map(self.clean, self.presses)) / round(self.settings.presses)

    @property
    def success(self) -> bool:
        """Whether enough presses count."""
        return self.over and sum(map(self.clean, self.presses)) >= self.settings.enough


class KeysMonitor(TaskMonitor[KeysOutcome]):
    """Cues keys one after another, watches all of them, and terminates the simulation after the last cue.

    Input ports (K keys), besides those of `TaskMonitor`:
        joints (2K): travel of each key, m, then its speed.
    Output ports:
        cue (1): number of the key to press, from 1; 0 for none.
        travel (K): travel of each key, m.
        outcome (abstract KeysOutcome).

    Args:
        cued: key of each cue.
    """

    def __init__(self, num_keys: int, num_fingers: int, cued: Sequence[int], settings: KeysSettings):
        super().__init__(num_fingers, KeysOutcome(settings, settings.ready_time))
        self._cued, self._num_keys = list(cued), num_keys
        self._keys = self.DeclareVectorInputPort("joints", 2 * num_keys)
        self._declare_output(
            "cue", 1, lambda now: 0 if math.isnan(now.cued_since) else now.presses[-1].key + 1
        )
        self._declare_positions("travel", self._keys)

    def _judged(self, context: Context, before: KeysOutcome) -> KeysOutcome:
        settings, t = before.settings, before.t
        presses, cued_since, next_cue = before.presses, before.cued_since, before.next_cue
        if not math.isnan(cued_since):
            travel = self._keys.Eval(context)[: self._num_keys]
            press = presses[-1].seen(travel, t - cued_since, settings.depth)
            presses = (*presses[:-1], press)
            is_up = travel[press.key] < settings.still
            if t - cued_since > settings.cue_time - 1e-9 or (press.depth > settings.depth and is_up):
                cued_since, next_cue = math.nan, t - before.began + settings.rest_time
        elif t - before.began > next_cue - 1e-9:
            presses, cued_since = (*presses, Press(self._cued[len(presses)])), t
        return before.having(
            cued_since=cued_since,
            next_cue=next_cue,
            presses=presses,
            over=len(presses) == len(self._cued) and math.isnan(cued_since),
        )
