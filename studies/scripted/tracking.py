"""The scripted robot of in-grasp tracking."""

import numpy as np
from plans import DAMPING
from pydrake.systems.framework import BasicVector, Context

from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.tracking.planner import HOVER, TrackingPlan, TrackingPlanner
from geort_drake.simulation.world import Scene
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.port_values import vector_to_pose
from geort_drake.systems.python_system import PythonSystem
from scripted.robot import hand_order, run_script

_PERIOD = 0.01  # s
_MOVES = (0.5, 2.0, 2.0)  # s, durations: wait, move the fingers around the puck, squeeze
_SQUEEZE = 0.010  # m, depth of fingertips below the puck's surface
_RATE, _SPEED = 3.0, 0.03  # correction rate of the puck's error, 1/s; largest speed of a fingertip, m/s
_PULL = 0.05  # fraction of the distance to the middle of the joint ranges per iteration


class ScriptedTracking(PythonSystem):
    """Closes the fingers on the puck, and then moves their targets by v + ω × r towards the puck's target.

    Input ports:
        hand_pose (7), object_pose (7), target_pose (7), cue (1): ports of `Stage.shown`.
    Output port:
        desired_state (2n): joint positions and velocities in actuator order.
    """

    def __init__(self, plan: TrackingPlan, scene: Scene, description: HandDescription):
        super().__init__()
        hand = HandModel(description)
        kinematics, order = NumpyKinematics(hand.kinematics()), hand_order(scene, description)
        middle, n, goal = 0.5 * (hand.lower + hand.upper), len(order), plan.goal
        held = np.flatnonzero(goal.touches)
        hand_pose = self.DeclareVectorInputPort("hand_pose", 7)
        object_pose, target_pose = (
            self.DeclareVectorInputPort(name, 7) for name in ("object_pose", "target_pose")
        )
        cue = self.DeclareVectorInputPort("cue", 1)
        # Joint positions, and targets of the holding fingertips in B.
        state = self.DeclareDiscreteState(
            np.concatenate([hand.default_position, goal.p_BF_open[held].ravel()])
        )

        def update(context: Context, values) -> None:
            memory, t = context.get_discrete_state(state).value(), context.get_time() - _MOVES[0]
            q, p_BF = memory[:n], memory[n:].reshape(-1, 3)
            if t < _MOVES[1]:
                share = minimum_jerk(t / _MOVES[1])
                q = hand.default_position + share * (plan.q_open - hand.default_position)
            else:
                if not cue.Eval(context)[0]:
                    share = minimum_jerk((t - _MOVES[1]) / _MOVES[2])
                    p_BF = goal.p_BF_open[held] - share * (HOVER + _SQUEEZE) * goal.n_B[held]
                else:
                    X_BW = vector_to_pose(hand_pose.Eval(context)).inverse()
                    X_BO, X_BT = (
                        X_BW @ vector_to_pose(port.Eval(context)) for port in (object_pose, target_pose)
                    )
                    axes = (X.rotation().matrix()[:, 2] for X in (X_BO, X_BT))
                    v, turn = X_BT.translation() - X_BO.translation(), np.cross(*axes)
                    step = _RATE * (v + np.cross(turn, p_BF - X_BO.translation()))
                    speed = np.linalg.norm(step, axis=1).max()
                    p_BF = p_BF + _PERIOD * step * min(1.0, _SPEED / max(speed, 1e-9))
                for _ in range(3):
                    tips, J = kinematics.fingertips_and_jacobians(q[None])
                    J = J[0, held].reshape(-1, n)
                    inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING**2 * np.eye(len(J)))
                    step = inverse @ (p_BF - tips[0, held]).ravel()
                    step += _PULL * (np.eye(n) - inverse @ J) @ (middle - q)
                    q = np.clip(q + step, hand.lower, hand.upper)
            values.set_value(state, np.concatenate([q, p_BF.ravel()]))

        def output(context: Context, vector: BasicVector) -> None:
            q = context.get_discrete_state(state).value()[:n]
            vector.SetFromVector(np.concatenate([q[order], np.zeros(n)]))

        self.DeclareVectorOutputPort("desired_state", 2 * n, output)
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, update)


def plans(scenario: Scenario, description: HandDescription) -> list[TrackingPlan]:
    """Returns plans of grips of the puck, the best first."""
    return TrackingPlanner(description).plans()


def scripted(scenario: Scenario, plan: TrackingPlan, seed: int) -> float:
    """Returns the score of the scripted robot in one trial, 0 without success."""
    return run_script(scenario, plan.goal, seed, lambda *robot: ScriptedTracking(plan, *robot))
