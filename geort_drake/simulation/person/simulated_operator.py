"""A system that replaces glove and tracker by a simulated person."""

from collections.abc import Mapping

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, State

from geort_drake.simulation.person.engine import Memory, Person
from geort_drake.simulation.person.perception import Percept
from geort_drake.systems.python_system import PythonSystem


class SimulatedOperator(PythonSystem):
    """Outputs what a glove and a tracker measure of a person, who decides once every `OperatorConfig.period`.

    The inputs should be delayed by `OperatorConfig.visual_delay`.

    Input ports (F robot fingers in the goal's order), those of `inputs`:
        fingertips (3F): p_WF of the robot, m.
        hand_pose (7): X_WB of the robot's hand base, qw qx qy qz x y z.
        object_pose (7): X_WO, qw qx qy qz x y z.
        place_pose (7): X_WP, where the object belongs, qw qx qy qz x y z.
        contact (F): force between each finger and the object, N.
        others: what the task's judge shows.
    Output ports:
        keypoints (63): p_HK of the person's hand, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker on the person's wrist.
        valid (1): always 1.
        phase (1): one of `phases` as a number.

    State: the person's memory (abstract) and the keypoints (63). The noise generator is not part of the
    state, so a system serves one simulation.

    Attributes:
        phases: names of the person's phases.

    Args:
        X_WH_start: initial pose of the wrist.
        inputs: name → size of each input port.
    """

    def __init__(self, person: Person, X_WH_start: RigidTransform, inputs: Mapping[str, int]):
        super().__init__()
        config, hand = person.config, person.hand
        config.validate()
        self._person = person
        self._tremor = config.tremor / np.sqrt(3)
        self._tremor_rng = np.random.default_rng(person.rng.integers(2**63))
        # The delays output zeros until their first sample has passed.
        self._vision_start = config.visual_delay - 0.5 * config.period
        self._inputs = {name: self.DeclareVectorInputPort(name, size) for name, size in inputs.items()}
        self.phases = [phase.name for phase in person.phases]
        start = person.start(X_WH_start)
        state = self.DeclareAbstractState(AbstractValue.Make(start))
        # The last posture and its keypoints, which a holding hand keeps.
        self._posture, self._p_HK = start.theta, hand.keypoints(start.theta)
        # A state, because the tremor is drawn once per decision.
        self._keypoints = self.DeclareDiscreteState(self._p_HK.ravel())
        ticket = {self.abstract_state_ticket(state)}
        self.DeclareStateOutputPort("keypoints", self._keypoints)
        self.DeclareAbstractOutputPort(
            "wrist_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            lambda context, output: output.set_value(self.memory(context).X_WH),
            ticket,
        )
        self.DeclareVectorOutputPort(
            "valid", 1, lambda context, output: output.SetAtIndex(0, 1.0), {self.nothing_ticket()}
        )
        self.DeclareVectorOutputPort(
            "phase",
            1,
            lambda context, output: output.SetAtIndex(0, float(self.memory(context).phase)),
            ticket,
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._decide)

    def memory(self, context: Context) -> Memory:
        """Returns the person's memory; do not change it."""
        return context.get_abstract_state(0).get_value()

    def _decide(self, context: Context, state: State) -> EventStatus:
        memory = self.memory(context)
        if context.get_time() < self._vision_start:
            return EventStatus.DidNothing()
        values = {name: port.Eval(context).copy() for name, port in self._inputs.items()}
        decision = self._person.step(memory, context.get_time(), Percept.of_ports(values))
        state.get_mutable_abstract_state(0).set_value(decision)
        if decision.theta is not self._posture:
            self._posture, self._p_HK = decision.theta, self._person.hand.keypoints(decision.theta)
        keypoints = self._p_HK.copy()
        keypoints[1:] += self._tremor_rng.normal(0, self._tremor, (20, 3))
        state.get_mutable_discrete_state(self._keypoints).set_value(keypoints.ravel())
        return EventStatus.Succeeded()
