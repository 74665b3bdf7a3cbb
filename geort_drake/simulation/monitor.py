"""What the monitors of tasks share: ports, state, and the end of a decided simulation."""

from typing import Any, Generic, TypeVar

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

PERIOD = 0.01  # s, between two checks

Judged = TypeVar("Judged", bound=Any)  # an `Outcome`, a frozen dataclass that is `Immutable`


class TaskMonitor(LeafSystem, Generic[Judged]):
    """Judges a task periodically, and terminates a simulation that is decided.

    Input ports (F fingers):
        contact (F): force between each finger and what is handled, N.
        self_contact (1): above 0 while links of the hand touch each other.
    Output port:
        outcome (abstract): an `Outcome`.

    State (abstract): the outcome.

    Args:
        start: outcome before the first check.
        period: between two checks, s.
    """

    def __init__(self, num_fingers: int, start: Judged, period: float = PERIOD):
        super().__init__()
        self._start, self._period = start, period
        self._contact = self.DeclareVectorInputPort("contact", num_fingers)
        self._self_contact = self.DeclareVectorInputPort("self_contact", 1)
        self._of_outcome = {self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))}
        self.DeclareAbstractOutputPort(
            "outcome",
            lambda: AbstractValue.Make(start),
            lambda context, output: output.set_value(self.outcome(context)),
            self._of_outcome,
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._look)

    def outcome(self, context: Context) -> Judged:
        """The outcome so far."""
        return context.get_abstract_state(0).get_value()

    def restart(self, context: Context) -> None:
        """Restarts the task now."""
        context.SetAbstractState(0, self._beginning(context.get_time()))

    def _beginning(self, t: float) -> Judged:
        """The outcome before the first check of a task that begins at t, s."""
        return self._start

    def _judged(self, context: Context, before: Judged) -> Judged:
        """The outcome now, except for forces and contacts of the hand with itself."""
        raise NotImplementedError

    def _look(self, context: Context, state: State) -> EventStatus:
        before = self.outcome(context)
        if before.over:
            return EventStatus.DidNothing()
        touches_itself = context.get_time() > 0 and self._self_contact.Eval(context)[0] > 0
        outcome = self._judged(context, before).having(
            peak_force=max(before.peak_force, float(self._contact.Eval(context).max())),
            self_contact_time=before.self_contact_time + self._period * bool(touches_itself),
        )
        state.get_mutable_abstract_state(0).set_value(outcome)
        if outcome.over:
            return EventStatus.ReachedTermination(self, "the task is judged")
        return EventStatus.Succeeded()
