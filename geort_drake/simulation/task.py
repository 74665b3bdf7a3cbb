"""The interface of a task: what a person does with the robot, and how it is judged.

`geort_drake.simulation.tasks` finds the tasks.
"""

import abc
import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from geort_drake.hands.description import HandDescription
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.simulation.operators.goal import Intended
from geort_drake.simulation.operators.simulated_operator import Person
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import Scene


class PerceivedPort(NamedTuple):
    """A port that the person perceives with delay; `mirror` holds the signs that mirror its values."""

    port: OutputPort
    mirror: np.ndarray | None = None


# For recordings: name → port with the number of a state, and the states' names; name → port, names of its
# entries, and their unit.
States = Mapping[str, tuple[OutputPort, Sequence[str]]]
Signals = Mapping[str, tuple[OutputPort, Sequence[str], str]]


@dc.dataclass(frozen=True)
class Stage:
    """The systems and ports that a task adds to a trial's diagram.

    Attributes:
        scene: the plant and its robot.
        monitor: judges the task.
        shown: name of the person's input port → the port that it perceives.
        states, signals: states and signals to record.
        bodies: free bodies whose path is recorded, and that are transparent in close-ups.
    """

    scene: Scene
    monitor: TaskMonitor
    shown: Mapping[str, PerceivedPort]
    states: States
    bodies: Sequence[RigidBody] = ()
    signals: Signals = dc.field(default_factory=dict)

    def restart(self, root: Context) -> None:
        """Restarts the task at the present time, when the person is ready."""
        self.monitor.restart(self.monitor.GetMyMutableContextFromRoot(root))


@dc.dataclass(frozen=True)
class TrialResult:
    """Result of one trial; times in simulated s. Tasks add fields."""

    # Name of the task, and of its case, the object.
    task: str
    object: str
    seed: int
    success: bool
    # Degree of success from 0 to 1.
    score: float
    # "success", or the reason for failure.
    outcome: str
    # The simulated operator's last phase, for example approach or close; None in a replay.
    operator_phase: str | None
    # Time from the start to success; None without success.
    completion_time: float | None
    # Whether the first attempt succeeded, and the number of attempts; None in a replay.
    first_attempt: bool | None
    attempts: int | None
    simulated_time: float
    # Fraction of the time during which two links of the hand touched each other, see `SceneView`.
    self_contact: float
    peak_force: float
    wall_time: float

    def to_json(self) -> dict:
        """Returns plain JSON types."""
        return dc.asdict(self)


class Task(abc.ABC, Generic[Intended]):
    """Base class of tasks. Each module `tasks/NAME/task.py` defines an instance named `TASK`.

    Attributes:
        name: name of the task and its folder.
        summary: one line for --help.
        kinds: kinds of simulated people for the task; the first is the default.
        result: type of a trial's result.
        scenario: file and name of its scenario.
        begins_after_play: whether people learn the map in free play before the trial and keep the map that
            they played with; otherwise a universal map first sees them in the trial.
    """

    name: str
    summary: str
    kinds: tuple[str, ...]
    result: type[TrialResult]
    scenario: tuple[Path, str]
    begins_after_play: bool = True

    def cases(self) -> list[str]:
        """Returns the cases of the task, one per trial, such as objects; by default the task itself."""
        return [self.name]

    def choose(self, scenario: Scenario, case: str) -> None:
        """Sets the case in a scenario; raises UnknownNameError if there is none of that name."""

    def case_of(self, scenario: Scenario) -> str:
        """Returns the case of a scenario."""
        return self.name

    @abc.abstractmethod
    def plans(self, scenario: Scenario, description: HandDescription) -> list[Intended]:
        """Returns plans for the scenario's robot, best first; raises ScenarioError if there are none."""

    @abc.abstractmethod
    def add_stage(
        self,
        builder: DiagramBuilder,
        scenario: Scenario,
        description: HandDescription,
        goal: Intended | None,
        X_WB: RigidTransform,
        rng: np.random.Generator,
    ) -> Stage:
        """Adds plant and monitor to a diagram.

        Args:
            goal: the person's goal; None in a replay.
            X_WB: initial pose of the hand.
            rng: draws everything that depends on the seed.

        Raises:
            ScenarioError, HandError: the scenario and the models do not fit together.
        """

    @abc.abstractmethod
    def person(self, scenario: Scenario, hand: HumanHand, goal: Intended, rng: np.random.Generator) -> Person:
        """Returns a person who perceives the ports of `Stage.shown`.

        Args:
            goal: mirrored for a left robot hand.
            rng: draws the noise of perception and motion.
        """

    @abc.abstractmethod
    def result_fields(self, outcome: Any, description: HandDescription) -> dict[str, Any]:
        """Returns `outcome` as text, and the fields that `result` adds to `TrialResult`."""

    def check_settings(self, settings: Mapping[str, float]) -> None:
        """Raises ValueError for a wrong entry of the scenario's `task_settings`."""
        if settings:
            raise ValueError(f"task_settings must be empty for task {self.name}, not {dict(settings)}")
