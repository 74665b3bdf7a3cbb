"""The scripted robot of the keys."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.plan.fingertips import Plan
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage
from geort_drake.simulation.tasks import keys
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.joint_limits import actuated_joints
from geort_drake.systems.python_system import PythonSystem
from scripted.robot import hand_order, run_script

MOVE = 0.3  # s, duration of a finger's movement


class ScriptedKeys(PythonSystem):
    """Moves a hand between the planned postures above and on the keys.

    Input ports:
        phase (1): number of the key to press, from 1; 0 for none.
    Output ports:
        desired_state (2n): joint positions and velocities in actuator order.
    """

    def __init__(self, plan: Plan, stage: Stage, description: HandDescription):
        super().__init__()
        order = hand_order(stage, description)
        start = np.array([joint.default_positions()[0] for joint in actuated_joints(stage.plant, stage.hand)])
        postures = [start, plan.postures["open"][order], *(q[order] for q in plan.postures["pressed"])]
        cue = self.DeclareVectorInputPort("phase", 1)
        # Start of the last movement (n), number of its target posture, and its start time.
        state = self.DeclareDiscreteState(np.array([*start, 0.0, 0.0]))
        n = len(start)

        def position(context: Context) -> np.ndarray:
            memory = context.get_discrete_state(state).value()
            share = minimum_jerk(
                (context.get_time() - memory[n + 1]) / (3 * MOVE if memory[n] == 1 else MOVE)
            )
            return memory[:n] + share * (postures[int(memory[n])] - memory[:n])

        def update(context: Context, values) -> None:
            memory, t = context.get_discrete_state(state).value(), context.get_time()
            wanted = 1 + round(cue.Eval(context)[0])
            # A press is held briefly and released before its cue ends.
            if memory[n] > 1 and t - memory[n + 1] > 2 * MOVE:
                wanted = 1
            elif memory[n] == 1 and wanted > 1 and t - memory[n + 1] < 6 * MOVE:
                wanted = 1
            if wanted != memory[n]:
                values.set_value(state, np.array([*position(context), wanted, t]))

        def output(context: Context, vector: BasicVector) -> None:
            vector.SetFromVector(np.concatenate([position(context), np.zeros(n)]))

        self.DeclareVectorOutputPort("desired_state", 2 * n, output)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, update)


def plans(scenario: Scenario, description: HandDescription) -> list[Plan]:
    """Returns plans for the keys, the best first."""
    return keys.plans(description)


def scripted(scenario: Scenario, plan: Plan, seed: int) -> float:
    """Returns the score of the scripted robot in one trial, 0 without success."""
    return run_script(scenario, plan.goal, seed, lambda *robot: ScriptedKeys(plan, *robot))
