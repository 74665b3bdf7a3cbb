"""Judges how far a cap is unscrewed."""

import dataclasses as dc
import math

from pydrake.systems.framework import Context

from geort_drake.simulation.monitor import Outcome, TaskMonitor, TaskSettings

STEPS = 8  # number of steps into which recordings divide the turn


@dc.dataclass(frozen=True)
class CapSettings(TaskSettings):
    """The turn that counts as unscrewed."""

    turn: float = 360.0  # degrees


@dc.dataclass(frozen=True)
class CapOutcome(Outcome):
    """How far the cap has been turned."""

    settings: CapSettings
    turned: float = 0.0  # degrees

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


class CapMonitor(TaskMonitor[CapOutcome]):
    """Watches the cap, and terminates the simulation when it is off.

    Input port, besides those of `TaskMonitor`:
        joints (2): turn of the cap, rad, and its speed.
    Output ports:
        turned (1): turn of the cap, rad.
        step (1): number of completed steps, of STEPS equal ones.
        outcome (abstract CapOutcome).
    """

    def __init__(self, num_fingers: int, settings: CapSettings):
        super().__init__(num_fingers, CapOutcome(settings))
        self._cap = self.DeclareVectorInputPort("joints", 2)
        self._declare_positions("turned", self._cap)
        self._declare_output("step", 1, lambda outcome: int(STEPS * outcome.score))

    def _judged(self, context: Context, before: CapOutcome) -> CapOutcome:
        return before.having(turned=math.degrees(self._cap.Eval(context)[0]))
