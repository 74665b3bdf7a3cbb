"""The grasp: lift an object and hold it.

Figures of the result: `tip_success`, whether only fingertip links touched the object during the hold;
`holding`, link → time for which it did, s; `phase_times`, phase → time of its first entry, s; and
`peak_height`, m.
"""

import dataclasses as dc
import enum
import math
from collections.abc import Callable, Collection, Sequence

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.resources import diagrams_dir, object_names
from geort_drake.simulation.person.handling import GRASP
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.task import PERIOD, Handled, Judgement, Observation, Outcome, Site, Task
from geort_drake.simulation.world import add_placed_object
from geort_drake.systems.port_values import vector_to_pose


class GraspPhase(enum.IntEnum):
    """Phases of a grasp, as the judge sees it."""

    REACH = 0  # nothing touches the object
    TOUCH = 1  # one finger touches
    GRASP = 2  # two or more fingers touch
    LIFT = 3  # ... and the object has left its support
    HOLD = 4  # ... and the object is high enough
    DONE = 5  # ... and the object stayed there long enough
    THROWN = 6  # the object lies off its support, out of reach


@dc.dataclass(frozen=True)
class GraspSettings:
    """Criteria of a successful grasp."""

    # The object's lowest point must be this high above its support, m, for this long, s.
    height: float = 0.10
    hold_time: float = 2.0
    # Height above which the object has left its support, m.
    lifted: float = 0.005
    # The object was thrown if it is this far below its support, or this far from its start and untouched, m.
    fallen: float = 0.03
    strayed: float = 0.30
    # Contact force above which a finger touches, N.
    touch_force: float = 0.02


# What each phase says of the moment in which a trial ended.
_ENDINGS = {
    GraspPhase.REACH: "no finger touched the object",
    GraspPhase.TOUCH: "only one finger touched the object",
    GraspPhase.GRASP: "two fingers or more touched the object, but had not lifted it",
    GraspPhase.LIFT: "the object was lifted, but not high enough",
    GraspPhase.HOLD: "the object was high enough, but not for long enough",
}


_REASONS = {
    "timeout": "time ran out; at the end,",
    "thrown": "the object fell or was pushed away; just before,",
    "lost": "the object fell or was pushed away;",
}


def explain(outcome: str) -> str:
    """Returns in a sentence what the outcome of a failed trial such as "timeout: touch" means.

    It says how things stood at the end, not how far the person had come before. Of a task without such
    phases, it names the step that was reached last.
    """
    ending, _, phase = outcome.partition(": ")
    if ending not in _REASONS:
        return outcome
    known = phase.upper() in GraspPhase.__members__
    last = _ENDINGS[GraspPhase[phase.upper()]] if known else f"the last step was: {phase}"
    return f"{_REASONS[ending]} {last}"


def judgement(
    settings: GraspSettings,
    links: Sequence[str],
    tip_links: Collection[str],
    lowest_point: Callable[[RigidTransform], float],
    support_height: float,
) -> Judgement:
    """Returns the function that judges a grasp.

    Args:
        links: names of the hand's links.
        tip_links: those that carry fingertips.
        lowest_point: maps X_WO to the height in W of the object's lowest point, m.
        support_height: height of the support in W, m.
    """
    names = np.array(links)
    at_start = {
        "times": {},
        "held_since": math.nan,
        "holding": {},
        "last_touched": GraspPhase.REACH,
        "peak_height": 0.0,
        "p_WO_start": None,
    }

    def judge(previous: Outcome, observation: Observation) -> Outcome:
        t, memory = previous.t, dict(previous.memory or at_start)
        X_WO, force = vector_to_pose(observation["object_pose"]), observation["contact"].tolist()
        if memory["p_WO_start"] is None:
            memory["p_WO_start"] = X_WO.translation()
        height = lowest_point(X_WO) - support_height
        touching = sum(one > settings.touch_force for one in force)
        x, y = (X_WO.translation() - memory["p_WO_start"])[:2].tolist()
        held_since, holding = math.nan, {}
        if height >= settings.height and touching >= 2:
            held_since = t if math.isnan(memory["held_since"]) else memory["held_since"]
            links = names[observation["link_contact"] > settings.touch_force].tolist()
            holding = memory["holding"] | {link: memory["holding"].get(link, 0.0) + PERIOD for link in links}
            phase = GraspPhase.DONE if t - held_since >= settings.hold_time else GraspPhase.HOLD
        elif height < -settings.fallen or (math.hypot(x, y) > settings.strayed and touching == 0):
            phase = GraspPhase.THROWN
        elif height > settings.lifted and touching >= 2:
            phase = GraspPhase.LIFT
        else:
            phase = GraspPhase(min(touching, 2))
        memory |= {"held_since": held_since, "holding": holding}

        memory["times"] = {**memory["times"], phase.name: memory["times"].get(phase.name, t)}
        memory["peak_height"] = max(memory["peak_height"], height)
        over = phase in (GraspPhase.DONE, GraspPhase.THROWN)
        if touching and not over:
            memory["last_touched"] = phase
        reached = [GraspPhase[name] for name in memory["times"] if name != GraspPhase.THROWN.name]
        success = phase == GraspPhase.DONE
        text = f"timeout: {phase.name.lower()}"
        if phase == GraspPhase.THROWN:
            text = f"thrown: {memory['last_touched'].name.lower()}"
        return previous.replace(
            phase=int(phase),
            success=success,
            over=over,
            score=max(reached, default=0) / GraspPhase.DONE,
            completion_time=held_since if success else math.nan,
            text="success" if success else text,
            memory=memory,
            metrics={
                "tip_success": success and holding.keys() <= set(tip_links),
                "holding": {link: round(spent, 6) for link, spent in holding.items()},
                "phase_times": memory["times"],
                "peak_height": memory["peak_height"],
            },
        )

    return judge


def _add(site: Site) -> Handled:
    body, shape, mass_factor = add_placed_object(
        site.plant, site.scene_graph, site.scenario, site.description, site.rng
    )
    hand = site.plant.GetModelInstanceByName("hand")
    links = [site.plant.get_body(index).name() for index in site.plant.GetBodyIndices(hand)]
    tip_links = [finger.tip_link for finger in site.description.fingers]
    support = site.scenario.object.support_height
    judge = judgement(site.settings, links, tip_links, shape.lowest_point, support)
    states = [phase.name.lower() for phase in GraspPhase]
    return Handled(body, judge, states, mass_factor=mass_factor)


TASK = Task(
    name="grasp",
    summary="lift an object and hold it",
    scenario=(diagrams_dir() / "grasp.scenarios.yaml", "Grasp"),
    plans=lambda scenario, description: GraspPlanner(scenario, description).plans(),
    add=_add,
    phases=GRASP,
    objects=object_names(),
    settings=GraspSettings,
)
