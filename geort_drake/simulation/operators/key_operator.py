"""A person who presses keys, as a system that replaces a glove and a tracker."""

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.intention import IntentionConfig
from geort_drake.simulation.operators.key_presser import KeyPresser
from geort_drake.simulation.operators.key_state import KeyPhase, SeenKeys
from geort_drake.simulation.operators.simulated_operator import OperatorSystem
from geort_drake.simulation.tasks.keys.goal import KeysGoal
from geort_drake.systems.port_values import vector_to_pose


class KeyOperator(OperatorSystem):
    """Simulates a person who presses keys with the robot by moving the fingers.

    Input ports (F robot fingers in the goal's order, K keys):
        fingertips (3F): p_WF of the robot, m.
        hand_pose (7): X_WB of the robot's hand base, qw qx qy qz x y z.
        travel (K): of the keys, m.
        cue (1): number of the key to press, from 1; 0 for none.
    Output ports:
        keypoints (63): p_HK of the person's hand, keypoint-major, m, wrist frame H.
        wrist_pose (abstract RigidTransform): X_WH of the tracker on the person's wrist, which stays.
        valid (1): always 1.
        phase (1): `KeyPhase` as a number.
        attempt (1): always 1.

    State: see `OperatorSystem`.
    """

    phases = KeyPhase

    def __init__(
        self,
        hand: HumanHand,
        goal: KeysGoal,
        kind: str,
        config: OperatorConfig,
        intention: IntentionConfig,
        X_WH_start: RigidTransform,
        seed: int,
    ):
        super().__init__(hand, config, seed)
        intention.validate()
        person = KeyPresser(hand, goal, kind, config, intention, self._rng)
        self._fingertips = self.DeclareVectorInputPort("fingertips", 3 * len(goal.finger_names))
        self._hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        self._travel = self.DeclareVectorInputPort("travel", len(goal.p_BK))
        self._cue = self.DeclareVectorInputPort("cue", 1)
        self._begin(person, person.start(X_WH_start), config.period)

    def _see(self, context: Context) -> SeenKeys:
        X_WB = vector_to_pose(self._hand_pose.Eval(context))
        p_WF = self._fingertips.Eval(context).reshape(-1, 3)
        return SeenKeys(
            p_BF=X_WB.inverse().multiply(p_WF.T).T,
            X_WB=X_WB,
            travel=self._travel.Eval(context).copy(),
            cue=round(self._cue.Eval(context)[0]),
        )
