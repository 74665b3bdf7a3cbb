"""The simulated person as a system that replaces a glove and a tracker."""

import enum
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.perception import Seen
from geort_drake.simulation.operators.state import Phase
from geort_drake.simulation.tasks.grasp.goal import GraspGoal
from geort_drake.systems.port_values import vector_to_pose


class OperatorSystem(LeafSystem):
    """Outputs what a glove and a tracker measure of a person, who decides once every period.

    The inputs, which a subclass declares before it calls `_begin`, should be delayed by
    `OperatorConfig.visual_delay`.

    Output ports:
        keypoints (63): p_HK of the person's hand, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker on the person's wrist.
        valid (1): always 1.
        phase (1): one of `phases` as a number.
        attempt (1): number of attempts so far, from 1.

    State: the person's memory (abstract) and the keypoints (63). The noise generator is not part of the
    state, so a system serves one simulation.

    Attributes:
        phases: enumeration of what the person can be doing.
    """

    phases: type[enum.IntEnum]

    def __init__(self, hand: HumanHand, config: OperatorConfig, seed: int):
        super().__init__()
        config.validate()
        self._rng = np.random.default_rng(seed)
        self._hand = hand
        self._tremor = config.tremor / np.sqrt(3)
        self._tremor_rng = np.random.default_rng(self._rng.integers(2**63))
        # The delays' outputs are zero until their first sample has passed.
        self._vision_start = config.visual_delay - 0.5 * config.period

    def _begin(self, person: Any, start: Any, period: float) -> None:
        """Declares state and outputs.

        Args:
            person: has `step(state, t, scene)`, which returns the next state.
            start: the first state, with own joint angles `theta`, `X_WH`, `phase` and `attempt`.
        """
        self._person = person
        state = self.DeclareAbstractState(AbstractValue.Make(start))
        # The last posture and its keypoints, as a hand that holds something keeps it.
        self._posture, self._p_HK = start.theta, self._hand.keypoints(start.theta)
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
        self.DeclareVectorOutputPort(
            "attempt", 1, lambda context, output: output.SetAtIndex(0, self.memory(context).attempt), ticket
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._decide)

    def memory(self, context: Context) -> Any:
        """Returns the person's memory; do not change it."""
        return context.get_abstract_state(0).get_value()

    def _decide(self, context: Context, state: State) -> EventStatus:
        before = self.memory(context)
        if context.get_time() < self._vision_start:
            return EventStatus.DidNothing()
        after = self._person.step(before, context.get_time(), self._see(context))
        state.get_mutable_abstract_state(0).set_value(after)
        if after.theta is not self._posture:
            self._posture, self._p_HK = after.theta, self._hand.keypoints(after.theta)
        keypoints = self._p_HK.copy()
        keypoints[1:] += self._tremor_rng.normal(0, self._tremor, (20, 3))
        state.get_mutable_discrete_state(self._keypoints).set_value(keypoints.ravel())
        return EventStatus.Succeeded()

    def _see(self, context: Context) -> Any:
        """What the person sees and feels."""
        raise NotImplementedError


class SimulatedOperator(OperatorSystem):
    """Simulates a person who grasps with the robot by moving hand and wrist.

    `GraspingPerson` decides once every `OperatorConfig.period`. The inputs should be delayed by
    `OperatorConfig.visual_delay`.

    Input ports (F robot fingers in the goal's order):
        fingertips (3F): p_WF of the robot, m.
        hand_pose (7): X_WB of the robot's hand base, qw qx qy qz x y z.
        object_pose (7): X_WO, qw qx qy qz x y z.
        contact (F): force between each finger and the object, N.
        place_pose (7): X_WP, where the object belongs, as the others; only with `has_place`.
    Output ports:
        keypoints (63): p_HK of the person's hand, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker on the person's wrist.
        valid (1): always 1.
        phase (1): `Phase` as a number.
        attempt (1): number of grasp attempts so far, from 1.

    State: the person's memory (abstract OperatorState) and the keypoints (63). The noise generator is not
    part of the state, so a system serves one simulation.

    Args:
        person: makes the person of hand, goal, config and a generator.
    """

    phases = Phase

    def __init__(
        self,
        hand: HumanHand,
        goal: GraspGoal,
        config: OperatorConfig,
        X_WH_start: RigidTransform,
        seed: int,
        person: Callable[..., GraspingPerson] = GraspingPerson,
        has_place: bool = False,
    ):
        super().__init__(hand, config, seed)
        num_fingers = len(goal.finger_names)
        self._fingertips = self.DeclareVectorInputPort("fingertips", 3 * num_fingers)
        self._hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 7)
        self._contact = self.DeclareVectorInputPort("contact", num_fingers)
        self._place_pose = self.DeclareVectorInputPort("place_pose", 7) if has_place else None
        own = person(hand, goal, config, self._rng)
        self._begin(own, own.start(X_WH_start), config.period)

    def _see(self, context: Context) -> Seen:
        return Seen(
            p_WF=self._fingertips.Eval(context).reshape(-1, 3),
            X_WB=vector_to_pose(self._hand_pose.Eval(context)),
            X_WO=vector_to_pose(self._object_pose.Eval(context)),
            contact=self._contact.Eval(context).copy(),
            X_WP=self._place_pose and vector_to_pose(self._place_pose.Eval(context)),
        )
