"""Judges how far a cap is unscrewed."""

import dataclasses as dc
import math

from pydrake.systems.framework import Context

from geort_drake.settings import require_numbers
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.systems.port_values import Immutable

STEPS = 8  # into which a viewer divides the turn


@dc.dataclass(frozen=True)
class CapSettings:
    """What counts as unscrewed."""

    turn: float = 360.0  # degrees

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "task_settings")


@dc.dataclass(frozen=True)
class CapOutcome(Immutable):
    """How far the cap is turned."""

    settings: CapSettings
    t: float = 0.0  # s
    turned: float = 0.0  # degrees
    peak_force: float = 0.0
    self_contact_time: float = 0.0

    @property
    def score(self) -> float:
        """Fraction of the turn that is done."""
        return min(max(self.turned / self.settings.turn, 0.0), 1.0)

    @property
    def success(self) -> bool:
        """Whether the cap is off."""
        return self.turned >= self.settings.turn

    @property
    def over(self) -> bool:
        """Whether the cap is off."""
        return self.success

    @property
    def completion_time(self) -> float:
        """Time from the start, s; NaN without success."""
        return self.t if self.success else math.nan


class CapMonitor(TaskMonitor[CapOutcome]):
    """Watches the cap, and terminates the simulation when it is off.

    Input port, besides those of `TaskMonitor`:
        cap (2): turn of the cap, rad, and its speed.
    Output ports:
        turned (1): turn of the cap, rad.
        step (1): how many of STEPS equal parts of the wanted turn are done.
        outcome (abstract CapOutcome).
    """

    def __init__(self, num_fingers: int, settings: CapSettings):
        super().__init__(num_fingers, CapOutcome(settings))
        self._cap = self.DeclareVectorInputPort("cap", 2)
        self.DeclareVectorOutputPort(
            "turned",
            1,
            lambda context, output: output.SetAtIndex(0, self._cap.Eval(context)[0]),
            {self._cap.ticket()},
        )
        self.DeclareVectorOutputPort(
            "step",
            1,
            lambda context, output: output.SetAtIndex(0, int(STEPS * self.outcome(context).score)),
            self._of_outcome,
        )

    def _judged(self, context: Context, before: CapOutcome) -> CapOutcome:
        turned = math.degrees(self._cap.Eval(context)[0])
        return dc.replace(before, t=context.get_time(), turned=turned)
