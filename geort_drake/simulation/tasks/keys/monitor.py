"""Cues presses and judges them: the cued key down, the others still."""

import dataclasses as dc
import math
from collections.abc import Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from geort_drake.settings import require_numbers
from geort_drake.systems.port_values import Immutable

PERIOD = 0.01  # s, between two looks


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


class KeysMonitor(LeafSystem):
    """Cues keys one after the other, watches all of them, and terminates the simulation after the last.

    Input ports (K keys, F fingers):
        keys (2K): travel of each key, m, then its speed.
        contact (F): force between each finger and the keys, N.
        self_contact (1): above 0 while links of the hand touch each other.
    Output ports:
        cue (1): number of the key to press, from 1; 0 for none.
        travel (K): of each key, m.
        outcome (abstract KeysOutcome).

    State (abstract): the outcome.

    Args:
        cued: key of each press.
    """

    def __init__(self, num_keys: int, num_fingers: int, cued: Sequence[int], settings: KeysSettings):
        super().__init__()
        self._cued, self._settings, self._num_keys = list(cued), settings, num_keys
        self._keys = self.DeclareVectorInputPort("keys", 2 * num_keys)
        self._contact = self.DeclareVectorInputPort("contact", num_fingers)
        self._self_contact = self.DeclareVectorInputPort("self_contact", 1)
        start = KeysOutcome(settings, next_cue=settings.ready_time)
        ticket = {self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))}
        self.DeclareVectorOutputPort(
            "cue",
            1,
            lambda context, output: output.SetAtIndex(0, self._cue(self.outcome(context))),
            ticket,
        )
        self.DeclareVectorOutputPort(
            "travel",
            num_keys,
            lambda context, output: output.SetFromVector(self._keys.Eval(context)[:num_keys]),
            {self._keys.ticket()},
        )
        self.DeclareAbstractOutputPort(
            "outcome",
            lambda: AbstractValue.Make(start),
            lambda context, output: output.set_value(self.outcome(context)),
            ticket,
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._look)

    def outcome(self, context: Context) -> KeysOutcome:
        """The outcome so far."""
        return context.get_abstract_state(0).get_value()

    def restart(self, context: Context) -> None:
        """Forgets the presses, and cues the first one after the time to get ready."""
        start = KeysOutcome(self._settings, next_cue=context.get_time() + self._settings.ready_time)
        context.SetAbstractState(0, start)

    def _cue(self, outcome: KeysOutcome) -> int:
        """The cued key, counted from 1; 0 for none."""
        return 0 if math.isnan(outcome.cued_since) else outcome.presses[-1].key + 1

    def _look(self, context: Context, state: State) -> EventStatus:
        before, settings, t = self.outcome(context), self._settings, context.get_time()
        if before.over:
            return EventStatus.DidNothing()
        presses, cued_since, next_cue = before.presses, before.cued_since, before.next_cue
        if not math.isnan(cued_since):
            press = self._judged(presses[-1], self._keys.Eval(context)[: self._num_keys], t - cued_since)
            presses = (*presses[:-1], press)
            is_up = self._keys.Eval(context)[press.key] < settings.still
            if t - cued_since > settings.cue_time - 1e-9 or (press.depth > settings.depth and is_up):
                cued_since, next_cue = math.nan, t + settings.rest_time
        elif t > next_cue - 1e-9:
            presses, cued_since = (*presses, Press(self._cued[len(presses)])), t
        outcome = dc.replace(
            before,
            t=t,
            cued_since=cued_since,
            next_cue=next_cue,
            presses=presses,
            over=len(presses) == len(self._cued) and math.isnan(cued_since),
            peak_force=max(before.peak_force, float(self._contact.Eval(context).max())),
            self_contact_time=before.self_contact_time
            + PERIOD * bool(t > 0 and self._self_contact.Eval(context)[0] > 0),
        )
        state.get_mutable_abstract_state(0).set_value(outcome)
        if outcome.over:
            return EventStatus.ReachedTermination(self, "the presses are judged")
        return EventStatus.Succeeded()

    def _judged(self, press: Press, travel: np.ndarray, since: float) -> Press:
        """A press with the keys' present travel (K,), m, this long after its cue, s."""
        depth, others = float(travel[press.key]), float(np.delete(travel, press.key).max(initial=0.0))
        is_first = math.isnan(press.time) and depth > self._settings.depth
        return Press(
            press.key,
            max(press.depth, depth),
            max(press.others, others),
            since if is_first else press.time,
        )
