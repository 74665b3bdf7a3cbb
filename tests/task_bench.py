"""The monitor of a task by itself, and people who do tasks through maps that need no training."""

from functools import cache
from typing import Any

import numpy as np
from grasp_setup import allegro, person_who_plays, play
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from geort_drake import load_scenario, run_trial
from geort_drake.retargeting.methods import make_untrained
from geort_drake.simulation.free_play import keep_reached, seen_fingertips
from geort_drake.simulation.monitor import TaskMonitor
from geort_drake.simulation.operators.perception import FreePlay
from geort_drake.simulation.task import TrialResult
from geort_drake.simulation.tasks import find_task


def judged(monitor: TaskMonitor, until: float, begins: float = 0.0, **inputs: tuple) -> Any:
    """The outcome at the time `until`, s, of a task that is restarted at `begins`, s.

    Inputs are times (T,), s, and values (T, n), with lines between them; others are zero.
    """
    builder = DiagramBuilder()
    builder.AddSystem(monitor)
    for port in map(monitor.get_input_port, range(monitor.num_input_ports())):
        if port.get_name() in inputs:
            t, values = inputs[port.get_name()]
            source = TrajectorySource(PiecewisePolynomial.FirstOrderHold(t, np.transpose(values)))
        else:
            source = ConstantVectorSource(np.zeros(port.size()))
        builder.Connect(builder.AddSystem(source).get_output_port(), port)
    simulator = Simulator(builder.Build())
    context = monitor.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    if begins:
        simulator.AdvanceTo(begins)
        monitor.restart(context)
    simulator.AdvanceTo(until)
    return monitor.outcome(context)


@cache
def plans(task: str) -> list:
    """A finger task's plans for the Allegro hand, the best first."""
    return find_task(task).planner(allegro().description).plans()


@cache
def retarget_and_play(method: str) -> tuple[Any, FreePlay]:
    """A map without training for the person who plays, and what that person sees of it in free play."""
    frames = play().fingertips([4, 8, 12, 16])
    retarget = make_untrained(method, allegro().kinematics(), frames=frames)
    return retarget, seen_fingertips(retarget, allegro(), person_who_plays())


def attempt(task: str, method: str, settings: str) -> tuple[TrialResult, bool]:
    """A person's trial of a finger task, and whether the plan that they keep was attainable."""
    retarget, seen = retarget_and_play(method)
    goal, attainable = keep_reached([plan.goal for plan in plans(task)], seen)
    scenario = load_scenario(*find_task(task).scenario, settings)
    return run_trial(scenario, retarget, (person_who_plays(), goal))[0], attainable
