"""A person who moves the robot's fingers, as a system that replaces a glove and a tracker."""

from collections.abc import Mapping
from typing import Any

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_person import FingerPerson, SeenFingers
from geort_drake.simulation.operators.intention import IntentionConfig
from geort_drake.simulation.operators.simulated_operator import OperatorSystem
from geort_drake.systems.port_values import vector_to_pose


class FingerOperator(OperatorSystem):
    """Simulates a person who moves the robot by the fingers alone.

    Input ports (F robot fingers in the goal's order):
        fingertips (3F): p_WF of the robot, m.
        hand_pose (7): X_WB of the robot's hand base, qw qx qy qz x y z.
        one of each name and size in `percepts`.
    Output ports:
        keypoints (63): p_HK of the person's hand, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker on the person's wrist, which stays.
        valid (1): always 1.
        phase (1): one of the person's phases as a number.
        attempt (1): always 1.

    State: see `OperatorSystem`.

    Args:
        person: the type of the person.
        percepts: name → size of what the task shows or lets feel.
    """

    def __init__(
        self,
        person: type[FingerPerson],
        hand: HumanHand,
        goal: Any,
        kind: str,
        config: OperatorConfig,
        intention: IntentionConfig,
        X_WH_start: RigidTransform,
        seed: int,
        percepts: Mapping[str, int],
    ):
        super().__init__(hand, config, seed)
        intention.validate()
        self.phases = person.phases
        own = person(hand, goal, kind, config, intention, self._rng)
        self._fingertips = self.DeclareVectorInputPort("fingertips", 3 * len(goal.finger_names))
        self._hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        self._percepts = {name: self.DeclareVectorInputPort(name, size) for name, size in percepts.items()}
        self._begin(own, own.start(X_WH_start), config.period)

    def _see(self, context: Context) -> SeenFingers:
        X_WB = vector_to_pose(self._hand_pose.Eval(context))
        p_WF = self._fingertips.Eval(context).reshape(-1, 3)
        percepts = {name: port.Eval(context).copy() for name, port in self._percepts.items()}
        return SeenFingers(X_WB.inverse().multiply(p_WF.T).T, X_WB, percepts)
