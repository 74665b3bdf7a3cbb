"""The scripted robot of the trigger."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.trigger.planner import TriggerPlan, TriggerPlanner
from geort_drake.simulation.world import Scene, actuated_joints
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.python_system import PythonSystem
from scripted.robot import hand_order, run_script

_MOVES = (0.5, 2.0, 1.0)  # s, durations: wait, move the fingers around the handle, squeeze
_RATE = 100.0  # 1/(m s), fraction of the whole pull per missing travel of the pad and second


class ScriptedTrigger(PythonSystem):
    """Moves a hand between the planned postures, and pulls at a rate proportional to the missing travel.

    Input ports:
        cue (1), travel (1): ports of `TriggerMonitor`.
    Output port:
        desired_state (2n): joint positions and velocities in actuator order.
    """

    def __init__(self, plan: TriggerPlan, scene: Scene, description: HandDescription):
        super().__init__()
        order = hand_order(scene, description)
        start = np.array([joint.default_positions()[0] for joint in actuated_joints(scene.plant, scene.hand)])
        q_open, q_held, q_pulled = (q[order] for q in (plan.q_open, plan.q_held, plan.q_pulled))
        cue, travel = self.DeclareVectorInputPort("cue", 1), self.DeclareVectorInputPort("travel", 1)
        pulled = self.DeclareDiscreteState(1)  # fraction of the whole pull

        def update(context: Context, values) -> None:
            share = context.get_discrete_state(pulled).value()[0]
            is_pull = round(cue.Eval(context)[0]) == 1
            missing = plan.goal.travel - travel.Eval(context)[0] if is_pull else -0.02
            values.set_value(pulled, [np.clip(share + 0.01 * _RATE * missing, 0.0, 1.0)])

        def output(context: Context, vector: BasicVector) -> None:
            t, share = context.get_time() - _MOVES[0], context.get_discrete_state(pulled).value()[0]
            q = start + minimum_jerk(t / _MOVES[1]) * (q_open - start)
            q = q + minimum_jerk((t - _MOVES[1]) / _MOVES[2]) * (q_held - q) + share * (q_pulled - q_held)
            vector.SetFromVector(np.concatenate([q, np.zeros(len(q))]))

        self.DeclareVectorOutputPort("desired_state", 2 * len(start), output)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, update)


def plans(scenario: Scenario, description: HandDescription) -> list[TriggerPlan]:
    """Returns plans for the handle, the best first."""
    return TriggerPlanner(description).plans()


def scripted(scenario: Scenario, plan: TriggerPlan, seed: int) -> float:
    """Returns the score of the scripted robot in one trial, 0 without success."""
    return run_script(scenario, plan.goal, seed, lambda *robot: ScriptedTrigger(plan, *robot))
