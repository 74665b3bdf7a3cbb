"""Tasks that bring an object to a place, in steps.

Figures of their results: `place_error` and `place_turn`, final horizontal distance from the place, m, and
signed angle about the vertical, rad; `step_times`, step → time at which it was reached, s.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geort_drake.simulation.person.goal import yaw_of
from geort_drake.simulation.person.handling import PLACE
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Handled, Judgement, Observation, Outcome, Site, Task
from geort_drake.simulation.world import add_placed_object
from geort_drake.systems.port_values import vector_to_pose

# Part of the tasks' scenarios: the arm's posture above a bare table, and its mirror image for a left hand.
ARM_POSTURE = """
arm_posture: &posture
  panda_joint1: 0.09
  panda_joint2: 0.39
  panda_joint3: 0.11
  panda_joint4: -1.42
  panda_joint5: -0.76
  panda_joint6: 0.69
  panda_joint7: -0.48
left_arm_posture:
  <<: *posture
  panda_joint1: -0.09
  panda_joint3: -0.11
  panda_joint5: 0.76
  panda_joint7: 0.48
"""
TOUCH_FORCE = 0.02  # N, force above which a finger touches
HOLD_TIME = 0.5  # s for which the last step must stay done
# The object is lost if it is this far below its place, or this far from it and untouched, m.
_MAX_FALL, _MAX_OFFSET = 0.025, 0.4


class CarriedState(NamedTuple):
    """An object relative to its place; lengths in m, angles in rad."""

    height: float  # height of its lowest point above where that belongs
    offset: float  # horizontal distance
    turn: float  # angle about the vertical, modulo the quarter turns of a square
    tilt: float  # angle from the vertical of the one of its axes that is nearest to it
    touching: int  # number of fingers that touch it


# Name of a step → whether it is done; a step counts only after those before it.
Steps = Mapping[str, Callable[[CarriedState], bool]]


def judgement(
    steps: Steps, X_WP: RigidTransform, lowest_point: Callable[[RigidTransform], float]
) -> Judgement:
    """Returns the function that judges a transfer.

    Args:
        steps: the steps, in order.
        X_WP: pose at which the object belongs.
        lowest_point: maps X_WO to the height in W of the object's lowest point, m.
    """
    ground, is_done = lowest_point(X_WP), list(steps.values())

    def carried_state(observation: Observation) -> CarriedState:
        X_WO = vector_to_pose(observation["object_pose"])
        offset = X_WO.translation() - X_WP.translation()
        R_PO = X_WP.rotation().inverse() @ X_WO.rotation()
        return CarriedState(
            height=lowest_point(X_WO) - ground,
            offset=math.hypot(*offset[:2]),
            turn=math.remainder(yaw_of(R_PO), math.pi / 2),
            tilt=math.acos(min(np.abs(X_WO.rotation().matrix()[2]).max(), 1.0)),
            touching=int(np.sum(observation["contact"] > TOUCH_FORCE)),
        )

    def judge(previous: Outcome, observation: Observation) -> Outcome:
        t, state = previous.t, carried_state(observation)
        times: tuple[float, ...] = previous.memory.get("times", ())
        done_since = math.nan
        if is_done[len(times)](state):
            if len(times) < len(steps) - 1:
                times = (*times, t)
            else:
                done_since = previous.memory.get("done_since", math.nan)
                done_since = t if math.isnan(done_since) else done_since
                if t - done_since > HOLD_TIME - 1e-9:
                    times = (*times, done_since)
        lost = state.height < -_MAX_FALL or (state.offset > _MAX_OFFSET and state.touching == 0)
        success = len(times) == len(steps)
        step_times = dict(zip(steps, times, strict=False))
        last = list(step_times)[-1] if step_times else "reach"
        return previous.replace(
            phase=len(times),
            success=success,
            over=success or lost,
            score=len(times) / len(steps),
            completion_time=times[-1] if success else math.nan,
            text="success" if success else f"{'lost' if lost else 'timeout'}: {last}",
            memory={"times": times, "done_since": done_since},
            metrics={
                "place_error": state.offset,
                "place_turn": state.turn,
                "step_times": {name: round(time, 6) for name, time in step_times.items()},
            },
        )

    return judge


class Transfer(NamedTuple):
    """What a task that brings an object to its place adds to the grasp.

    Attributes:
        steps: the steps, in order.
        place: returns X_WP from scenario, side of the hand and generator.
        hover: height above its place from which the person lowers the object, m.
        upright: whether the person turns the object upright before they put it down. Otherwise, they put it
            down as it hangs in the hand, and it may lie on any side.
        add_fixtures: adds geometry that depends on the place.
    """

    steps: Steps
    place: Callable[[Scenario, str, np.random.Generator], RigidTransform]
    hover: float
    upright: bool
    add_fixtures: Callable[[MultibodyPlant, RigidTransform], None] = lambda plant, X_WP: None

    def add(self, site: Site) -> Handled:
        """Adds the object and what marks its place; see `Task`."""
        X_WP = self.place(site.scenario, site.description.side, site.rng.spawn(1)[0])
        self.add_fixtures(site.plant, X_WP)
        body, shape, mass_factor = add_placed_object(
            site.plant, site.scene_graph, site.scenario, site.description, site.rng
        )
        judge = judgement(self.steps, X_WP, shape.lowest_point)
        return Handled(body, judge, ["reach", *self.steps], mass_factor=mass_factor, X_WP=X_WP)

    def task(self, **fields: Any) -> Task:
        """Returns a task with these further fields of `Task`."""
        return Task(add=self.add, phases=PLACE, placing=self, percepts=("place_pose",), **fields)
