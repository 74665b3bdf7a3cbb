"""The scripted robot of the cap."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.plan.fingertips import Plan
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage
from geort_drake.simulation.tasks import cap
from geort_drake.simulation.wrist_motion import minimum_jerk
from geort_drake.systems.joint_limits import actuated_joints
from geort_drake.systems.python_system import PythonSystem
from scripted.robot import hand_order, run_script

_START = 2.0  # s, time until the fingers are around the cap
_MOVES = (0.5, 1.0, 0.5, 0.5)  # s, durations: squeeze, turn, open, return
# Fingers are commanded this many times as far as the plan squeezes. Without it, they slip at a step of 5 ms.
_SQUEEZE = 1.5


class ScriptedCap(PythonSystem):
    """Repeats the planned stroke without feedback.

    Output ports:
        desired_state (2n): joint positions and velocities in actuator order.
    """

    def __init__(self, plan: Plan, stage: Stage, description: HandDescription):
        super().__init__()
        order = hand_order(stage, description)
        start = np.array([joint.default_positions()[0] for joint in actuated_joints(stage.plant, stage.hand)])
        q_open, q_held = plan.postures["open"][:, order], plan.postures["held"][:, order]

        def at(path: np.ndarray, share: float) -> np.ndarray:
            place = share * (len(path) - 1)
            first = min(int(place), len(path) - 2)
            return path[first] + (place - first) * (path[first + 1] - path[first])

        def output(context: Context, vector: BasicVector) -> None:
            t = context.get_time()
            q = start + minimum_jerk(t / _START) * (q_open[0] - start)
            since = (t - _START) % sum(_MOVES)
            if t > _START:
                ends = np.cumsum(_MOVES)
                held, turned, opened, returned = (
                    minimum_jerk((since - end + move) / move) for end, move in zip(ends, _MOVES, strict=True)
                )
                place, squeeze = turned - returned, _SQUEEZE * (held - opened)
                q = at(q_open, place) + squeeze * (at(q_held, place) - at(q_open, place))
            vector.SetFromVector(np.concatenate([q, np.zeros(len(q))]))

        self.DeclareVectorOutputPort("desired_state", 2 * len(start), output)


def plans(scenario: Scenario, description: HandDescription) -> list[Plan]:
    """Returns plans for the cap, the best first."""
    return cap.CapPlanner(description).plans()


def scripted(scenario: Scenario, plan: Plan, seed: int) -> float:
    """Returns the score of the scripted robot in one trial, 0 without success."""
    return run_script(scenario, plan.goal, seed, lambda *robot: ScriptedCap(plan, *robot))
