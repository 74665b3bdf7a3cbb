"""Cues presses and judges them: the cued key down, the others still."""

import dataclasses as dc
import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context

from geort_drake.settings import require_numbers
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.systems.port_values import Immutable


@dc.dataclass(frozen=True)
class KeysSettings:
    """The presses, and when one counts."""

    # Number of cues, and time before the first, of each at most, and between two, s. A cue ends when its key
    # was pressed and is up again.
    presses: float = 12
    ready_time: float = 6.0
    cue_time: float = 2.0
    rest_time: float = 0.5
    # The cued key must go down by more than `depth` and no other by more than `still` during the cue, m.
    depth: float = 0.003
    still: float = 0.0005
    # Presses without fault that make a success.
    enough: float = 10

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "task_settings")


@dc.dataclass(frozen=True)
class Press:
    """One cued press; lengths in m, times in s."""

    key: int
    depth: float = 0.0  # largest travel of the cued key
    others: float = 0.0  # largest travel of another key
    time: float = math.nan  # from the cue until the key was down


@dc.dataclass(frozen=True)
class KeysOutcome(Immutable):
    """The presses so far."""

    settings: KeysSettings
    t: float = 0.0
    # Since when the present cue is shown, NaN between two; and when the next one follows, s.
    cued_since: float = math.nan
    next_cue: float = 0.0
    presses: tuple[Press, ...] = ()
    over: bool = False
    peak_force: float = 0.0
    self_contact_time: float = 0.0

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

    @property
    def completion_time(self) -> float:
        """Time from the start to the end of the last cue, s; NaN without success."""
        return self.t if self.success else math.nan


class KeysMonitor(TaskMonitor[KeysOutcome]):
    """Cues keys one after the other, watches all of them, and terminates the simulation after the last.

    Input ports (K keys), besides those of `TaskMonitor`:
        keys (2K): travel of each key, m, then its speed.
    Output ports:
        cue (1): number of the key to press, from 1; 0 for none.
        travel (K): of each key, m.
        outcome (abstract KeysOutcome).

    Args:
        cued: key of each press.
    """

    def __init__(self, num_keys: int, num_fingers: int, cued: Sequence[int], settings: KeysSettings):
        super().__init__(num_fingers, KeysOutcome(settings, next_cue=settings.ready_time))
        self._cued, self._settings, self._num_keys = list(cued), settings, num_keys
        self._keys = self.DeclareVectorInputPort("keys", 2 * num_keys)
        self.DeclareVectorOutputPort(
            "cue",
            1,
            lambda context, output: output.SetAtIndex(0, self._cue(self.outcome(context))),
            self._of_outcome,
        )
        self.DeclareVectorOutputPort(
            "travel",
            num_keys,
            lambda context, output: output.SetFromVector(self._keys.Eval(context)[:num_keys]),
            {self._keys.ticket()},
        )

    def _beginning(self, t: float) -> KeysOutcome:
        return KeysOutcome(self._settings, next_cue=t + self._settings.ready_time)

    def _cue(self, outcome: KeysOutcome) -> int:
        """The cued key, counted from 1; 0 for none."""
        return 0 if math.isnan(outcome.cued_since) else outcome.presses[-1].key + 1

    def _judged(self, context: Context, before: KeysOutcome) -> KeysOutcome:
        settings, t = self._settings, context.get_time()
        presses, cued_since, next_cue = before.presses, before.cued_since, before.next_cue
        if not math.isnan(cued_since):
            press = self._watched(presses[-1], self._keys.Eval(context)[: self._num_keys], t - cued_since)
            presses = (*presses[:-1], press)
            is_up = self._keys.Eval(context)[press.key] < settings.still
            if t - cued_since > settings.cue_time - 1e-9 or (press.depth > settings.depth and is_up):
                cued_since, next_cue = math.nan, t + settings.rest_time
        elif t > next_cue - 1e-9:
            presses, cued_since = (*presses, Press(self._cued[len(presses)])), t
        return dc.replace(
            before,
            t=t,
            cued_since=cued_since,
            next_cue=next_cue,
            presses=presses,
            over=len(presses) == len(self._cued) and math.isnan(cued_since),
        )

    def _watched(self, press: Press, travel: np.ndarray, since: float) -> Press:
        """A press with the keys' present travel (K,), m, this long after its cue, s."""
        depth, others = float(travel[press.key]), float(np.delete(travel, press.key).max(initial=0.0))
        is_first = math.isnan(press.time) and depth > self._settings.depth
        return Press(
            press.key,
            max(press.depth, depth),
            max(press.others, others),
            since if is_first else press.time,
        )
