"""Judges a task: one system that steps a pure function from outcome and observation to outcome."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, State

from geort_drake.systems.port_values import Immutable
from geort_drake.systems.python_system import PythonSystem

PERIOD = 0.01  # s between two observations

# Name of an input port of the judge → its values.
Observation = Mapping[str, np.ndarray]


@dc.dataclass(frozen=True)
class Outcome(Immutable):
    """Result of a task so far, and what its judge remembers.

    Attributes:
        began: time at which the task began, s.
        t: time of the last observation, s.
        phase: number of the task's present state.
        success: whether the task is done.
        over: whether the task is decided.
        score: how much of the task is done, from 0 to 1.
        completion_time: simulation time of the success, s; NaN without success.
        text: "success", or the reason for failure if the trial ended now.
        metrics: further figures of the result, as JSON types.
        memory: what the judge needs at the next observation; empty before the first.
        peak_force: largest contact force between a finger and the object, N.
        self_contact_time: total time in which links of the hand touched each other, s; see `SceneView`.
    """

    began: float = 0.0
    t: float = 0.0
    phase: int = 0
    success: bool = False
    over: bool = False
    score: float = 0.0
    completion_time: float = math.nan
    text: str = ""
    metrics: Mapping[str, Any] = dc.field(default_factory=dict)
    memory: Mapping[str, Any] = dc.field(default_factory=dict)
    peak_force: float = 0.0
    self_contact_time: float = 0.0


# Returns the next outcome without changing the one before, whose `t` is the present time; the judge adds
# forces and contacts.
Judgement = Callable[[Outcome, Observation], Outcome]


class Judge(PythonSystem):
    """Judges a task periodically, without delay or noise, and ends the simulation once it is decided.

    Input ports (F fingers, L links, K joints):
        contact (F): force between each finger and the object, N.
        self_contact (1): above 0 while links of the hand touch each other.
        object_pose (7): X_WO, qw qx qy qz x y z.
        hand_pose (7): X_WB of the robot's hand base.
        link_contact (L): force between each link of the hand and the object, N.
        joints (2K): positions, then velocities of the object's joints; only if it has any.
    Output ports:
        outcome (abstract Outcome).
        phase (1): number of the task's present state.
        positions (K): positions of the object's joints; only if it has any.
        others (n): see `shows`.

    State (abstract): the outcome.

    Args:
        judgement: the task's pure function.
        num_fingers, num_links, num_joints: F, L and K.
        shows: name → function from the outcome to the values of an output port, for what the task shows to
            the person.
    """

    def __init__(
        self,
        judgement: Judgement,
        num_fingers: int,
        num_links: int,
        num_joints: int = 0,
        shows: Mapping[str, Callable[[Outcome], Sequence[float] | np.ndarray]] | None = None,
    ):
        super().__init__()
        self._judgement = judgement
        sizes = {"contact": num_fingers, "self_contact": 1, "object_pose": 7, "hand_pose": 7}
        sizes |= {"link_contact": num_links, "joints": 2 * num_joints}
        self._inputs = {name: self.DeclareVectorInputPort(name, size) for name, size in sizes.items() if size}
        state = self.DeclareAbstractState(AbstractValue.Make(Outcome()))
        tickets = {self.abstract_state_ticket(state)}
        self.DeclareAbstractOutputPort(
            "outcome",
            lambda: AbstractValue.Make(Outcome()),
            lambda context, output: output.set_value(self.outcome(context)),
            tickets,
        )
        shows = {"phase": lambda outcome: [outcome.phase], **(shows or {})}
        for name, values in shows.items():
            self.DeclareVectorOutputPort(
                name,
                len(values(Outcome())),
                lambda context, output, values=values: output.SetFromVector(
                    np.array(values(self.outcome(context)), float)
                ),
                tickets,
            )
        if num_joints:
            joints = self._inputs["joints"]
            self.DeclareVectorOutputPort(
                "positions",
                num_joints,
                lambda context, output: output.SetFromVector(joints.Eval(context)[:num_joints]),
                {joints.ticket()},
            )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._observe)

    def outcome(self, context: Context) -> Outcome:
        """Returns the outcome so far."""
        return context.get_abstract_state(0).get_value()

    def restart(self, context: Context) -> None:
        """Restarts the task at the present time."""
        context.SetAbstractState(0, Outcome(began=context.get_time()))

    def _observe(self, context: Context, state: State) -> EventStatus:
        before, t = self.outcome(context), context.get_time()
        if before.over:
            return EventStatus.DidNothing()
        seen = {name: port.Eval(context) for name, port in self._inputs.items()}
        touches_itself = t > 0 and seen["self_contact"][0] > 0
        outcome = self._judgement(before.having(t=t), seen).having(
            peak_force=max(before.peak_force, float(seen["contact"].max())),
            self_contact_time=before.self_contact_time + PERIOD * bool(touches_itself),
        )
        state.get_mutable_abstract_state(0).set_value(outcome)
        if outcome.over:
            return EventStatus.ReachedTermination(self, "the task is judged")
        return EventStatus.Succeeded()
