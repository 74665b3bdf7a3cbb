"""Base classes of task monitors: settings, outcome, and a monitor that ends a decided simulation."""

import abc
import dataclasses as dc
import math
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, InputPort, State

from geort_drake.settings import require_numbers
from geort_drake.systems.port_values import Immutable
from geort_drake.systems.python_system import PythonSystem

PERIOD = 0.01  # s between two checks


@dc.dataclass(frozen=True)
class TaskSettings:
    """Base of a scenario's `task_settings`, all positive numbers."""

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "task_settings")


@dc.dataclass(frozen=True, kw_only=True)
class Outcome(abc.ABC, Immutable):
    """Result of a task so far, as judged by its monitor.

    Attributes:
        began: time at which the task began, s.
        t: time of the last check, s.
        peak_force: largest contact force between a finger and the object, N.
        self_contact_time: total time in which links of the hand touched each other, s; see `SceneView`.
    """

    began: float = 0.0
    t: float = 0.0
    peak_force: float = 0.0
    self_contact_time: float = 0.0

    @property
    @abc.abstractmethod
    def success(self) -> bool:
        """Whether the task is done."""

    @property
    @abc.abstractmethod
    def over(self) -> bool:
        """Whether the task is decided."""

    @property
    @abc.abstractmethod
    def score(self) -> float:
        """How much of the task is done, from 0 to 1."""

    @property
    def completion_time(self) -> float:
        """Simulation time at success, s; NaN without success."""
        return self.t if self.success else math.nan


Judged = TypeVar("Judged", bound=Outcome)


class TaskMonitor(PythonSystem, Generic[Judged]):
    """Judges a task periodically, and terminates the simulation once the task is decided.

    Input ports (F fingers):
        contact (F): force between each finger and the object, N.
        self_contact (1): above 0 while links of the hand touch each other.
    Output port:
        outcome (abstract): an `Outcome`.

    State (abstract): the outcome.

    Args:
        start: outcome before the first check.
        period: time between two checks, s.
    """

    def __init__(self, num_fingers: int, start: Judged, period: float = PERIOD):
        super().__init__()
        self._start, self._period = start, period
        self._contact = self.DeclareVectorInputPort("contact", num_fingers)
        self._self_contact = self.DeclareVectorInputPort("self_contact", 1)
        state = self.DeclareAbstractState(AbstractValue.Make(start))
        self._outcome_tickets = {self.abstract_state_ticket(state)}
        self.DeclareAbstractOutputPort(
            "outcome",
            lambda: AbstractValue.Make(start),
            lambda context, output: output.set_value(self.outcome(context)),
            self._outcome_tickets,
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._check)

    def _declare_output(self, name: str, size: int, value: Callable[[Judged], ArrayLike]) -> None:
        """Adds an output port with numbers (size,) computed from the outcome."""
        self.DeclareVectorOutputPort(
            name,
            size,
            lambda context, output: output.SetFromVector(
                np.array(value(self.outcome(context)), float, ndmin=1)
            ),
            self._outcome_tickets,
        )

    def _declare_positions(self, name: str, state: InputPort) -> None:
        """Adds an output port with the positions from an input port of positions, then velocities."""
        size = state.size() // 2
        self.DeclareVectorOutputPort(
            name,
            size,
            lambda context, output: output.SetFromVector(state.Eval(context)[:size]),
            {state.ticket()},
        )

    def outcome(self, context: Context) -> Judged:
        """Returns the outcome so far."""
        return context.get_abstract_state(0).get_value()

    def restart(self, context: Context) -> None:
        """Restarts the task at the present time."""
        context.SetAbstractState(0, self._start.having(began=context.get_time()))

    def _judged(self, context: Context, before: Judged) -> Judged:
        """Returns the new outcome except force and self-contact; `before` is the last with the new `t`."""
        raise NotImplementedError

    def _check(self, context: Context, state: State) -> EventStatus:
        before = self.outcome(context)
        if before.over:
            return EventStatus.DidNothing()
        touches_itself = context.get_time() > 0 and self._self_contact.Eval(context)[0] > 0
        outcome = self._judged(context, before.having(t=context.get_time())).having(
            peak_force=max(before.peak_force, float(self._contact.Eval(context).max())),
            self_contact_time=before.self_contact_time + self._period * bool(touches_itself),
        )
        state.get_mutable_abstract_state(0).set_value(outcome)
        if outcome.over:
            return EventStatus.ReachedTermination(self, "the task is judged")
        return EventStatus.Succeeded()
