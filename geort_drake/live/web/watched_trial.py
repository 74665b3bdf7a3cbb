"""The trial of a simulated person that the page shows where nobody has a camera."""

import dataclasses as dc
from typing import Any

from pydrake.systems.framework import Context

from geort_drake.retargeting.base import Retarget, forget
from geort_drake.simulation.diagram import TrialDiagram, make_trial_diagram
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Outcome
from geort_drake.simulation.trial import TrialBuilder


@dc.dataclass(frozen=True)
class WatchedTrial:
    """A trial of `geort-drake grasp` as a page's session; read in the same way as a `Teleoperation`.

    Attributes:
        parts: diagram of the trial.
        timeout: longest duration, s.
    """

    parts: TrialDiagram
    timeout: float
    simulated_person = True
    late = 0

    def outcome(self, root: Context) -> Outcome:
        """Returns the task's outcome so far; a trial that takes too long is over."""
        outcome = self.parts.stage.outcome(root)
        return outcome.replace(over=outcome.over or root.get_time() >= self.timeout)

    def restart(self, root: Context) -> None:
        """Does nothing, as a trial begins when its diagram does."""

    def phase(self, root: Context) -> str:
        """Returns the name of the task's present state."""
        return self.parts.stage.phase(root)

    def following(self, root: Context) -> bool:
        """Whether the robot follows the person."""
        return True

    def state(self, root: Context) -> str:
        """Returns what is shown as the state of the fingers."""
        return "a simulated person works"

    def delay(self, newest: int) -> dict[str, Any]:
        """Returns no figures, as nothing arrives from outside."""
        return {"count": 0, "median": None, "p99": None}


def make_watched_trial(builder: TrialBuilder, scenario: Scenario, retarget: Retarget) -> WatchedTrial:
    """Builds the trial that `geort-drake grasp` would simulate for this scenario and map.

    Planning and the person's free play take some seconds the first time.

    Args:
        builder: builder of trials with the robot's hand.
        scenario: with its object and seed.
        retarget: a method or map.

    Raises:
        ScenarioError: the hand cannot do the task.
    """
    trial = builder.trial(scenario, retarget)
    forget(trial.retarget)
    return WatchedTrial(make_trial_diagram(trial.scenario, trial.retarget, trial.human), scenario.timeout)
