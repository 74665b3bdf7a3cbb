"""Tasks for the fingers of a parked hand."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem

from geort_drake.hands.description import HandDescription
from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.free_play import keep_reached
from geort_drake.simulation.operators.finger_operator import FingerOperator
from geort_drake.simulation.operators.finger_person import FingerPerson
from geort_drake.simulation.operators.intention import ADAPTIVE, MIMICRY
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import SERVO, Goal, Task, require_settings


class Planner(Protocol):
    """Finds ways to do a task; raises ScenarioError, also when it is made, if the hand has none."""

    def __init__(self, description: HandDescription): ...

    def plans(self) -> Sequence[Any]:
        """Plans with a `goal`, the best first."""


class FingerTask(Task[Goal]):
    """A task for the fingers of a parked hand, which all kinds of people can do.

    Attributes:
        settings: dataclass of the scenario's `task_settings`.
        planner: of the goals.
        person_type: decides how the fingers move.
    """

    kinds = (ADAPTIVE, MIMICRY, SERVO)
    settings: ClassVar[type]
    planner: ClassVar[type[Planner]]
    person_type: ClassVar[type[FingerPerson]]

    @abc.abstractmethod
    def places(self, goal: Goal) -> Sequence[np.ndarray]:
        """Fingertip points (F, 3), m in B, that free play must reach."""

    @abc.abstractmethod
    def percepts(self, goal: Goal) -> dict[str, int]:
        """Name → size of what the person perceives besides fingertips and hand pose."""

    def check_settings(self, settings: Mapping[str, float]) -> None:
        require_settings(self.settings, settings)

    def plans(self, scenario: Scenario, description: HandDescription) -> list[Goal]:
        return [plan.goal for plan in self.planner(description).plans()]

    def keep(self, plans: Sequence[Goal], play: FreePlay) -> tuple[Goal, bool]:
        """The first plan whose places the person could reach in free play, or the nearest."""
        return keep_reached(plans, play, self.places)

    def person(
        self, scenario: Scenario, hand: HumanHand, goal: Goal, X_WH_start: RigidTransform, seed: int
    ) -> LeafSystem:
        return FingerOperator(
            self.person_type,
            hand,
            goal,
            scenario.kind,
            scenario.operator,
            scenario.intention,
            X_WH_start,
            seed,
            self.percepts(goal),
        )
