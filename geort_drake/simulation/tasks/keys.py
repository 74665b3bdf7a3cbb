"""The keys: press the cued one of three without moving the others, with a parked hand.

Figures of the result: `pressed` and `still`, presses in which the cued key went down, and in which the others
stayed still.
"""

import dataclasses as dc
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, PrismaticSpring, SpatialInertia

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.person.keys import KEYS
from geort_drake.simulation.plan.fingertips import FingerPlanner, Plan
from geort_drake.simulation.task import PARKED_HAND, Handled, Judgement, Observation, Outcome, Site, Task

# Size of a key cap along and across the fingers, and distance between the centres of neighbours, m.
CAP_LENGTH, CAP_WIDTH, PITCH = 0.040, 0.018, 0.045
FINGERS = ("index", "middle", "ring")  # finger of each key, from the thumb's side
HOVER = 0.002  # m, gap between a waiting fingertip and its key
TRAVEL = 0.005  # m, full travel of a key
_CLEARANCE = 0.008  # m, distance by which free play may miss a fingertip's place above its key
# Positions of the keys' tops along x and z of B to try, m.
_X, _Z = np.arange(0.05, 0.141, 0.01), np.arange(-0.02, 0.121, 0.01)
# The last link must point down by this much, so that its tip touches first: sine of the angle.
_MIN_SLOPE = 0.5
_CAP_HEIGHT, _CAP_MASS = 0.006, 0.005  # m, kg
_STIFFNESS, _DAMPING = 150.0, 1.7  # N/m and N s/m of a key; the damping is critical
_FRICTION = CoulombFriction(0.6, 0.6)
_COLOR, _BED_COLOR = np.array([0.93, 0.93, 0.90, 1.0]), np.array([0.25, 0.26, 0.28, 1.0])


@dc.dataclass(frozen=True)
class KeysSettings:
    """Number and timing of the presses, and criteria for one to count."""

    # Number of cues; time before the first, longest time of a cue, and time between two, s. A cue ends when
    # its key was pressed and is up again.
    presses: float = 12
    ready_time: float = 6.0
    cue_time: float = 2.0
    rest_time: float = 0.5
    # During the cue, the cued key must go down by more than `depth` and no other by more than `still`, m.
    depth: float = 0.003
    still: float = 0.0005
    # Number of counted presses needed for success.
    enough: float = 10


class Press(NamedTuple):
    """One cued press; lengths in m."""

    key: int
    depth: float = 0.0  # largest travel of the cued key
    others: float = 0.0  # largest travel of another key


def judgement(settings: KeysSettings, cued: Sequence[int]) -> Judgement:
    """Returns the function that cues keys one after another and judges the presses.

    Args:
        cued: key of each cue.
    """

    def judge(previous: Outcome, observation: Observation) -> Outcome:
        t, travel = previous.t, observation["joints"][: len(observation["joints"]) // 2]
        # When the next cue follows, s after the task began; since when the present cue is shown, s, or NaN.
        next_cue = previous.memory.get("next_cue", settings.ready_time)
        cued_since = previous.memory.get("cued_since", math.nan)
        presses: tuple[Press, ...] = previous.memory.get("presses", ())
        if not math.isnan(cued_since):
            press, since = presses[-1], t - cued_since
            depth, others = float(travel[press.key]), float(np.delete(travel, press.key).max(initial=0.0))
            press = Press(press.key, max(press.depth, depth), max(press.others, others))
            presses = (*presses[:-1], press)
            is_up = travel[press.key] < settings.still
            if since > settings.cue_time - 1e-9 or (press.depth > settings.depth and is_up):
                cued_since, next_cue = math.nan, t - previous.began + settings.rest_time
        elif t - previous.began > next_cue - 1e-9:
            presses, cued_since = (*presses, Press(cued[len(presses)])), t
        pressed = [press for press in presses if press.depth > settings.depth]
        still = sum(press.others < settings.still for press in presses)
        clean_presses = sum(press.others < settings.still for press in pressed)
        over = len(presses) == len(cued) and math.isnan(cued_since)
        success = over and clean_presses >= settings.enough
        faults = f"{len(presses) - len(pressed)} not pressed, {len(presses) - still} with others"
        return previous.replace(
            phase=0 if math.isnan(cued_since) else presses[-1].key + 1,
            success=success,
            over=over,
            score=clean_presses / len(cued),
            completion_time=t if success else math.nan,
            text="success" if success else faults,
            memory={"next_cue": next_cue, "cued_since": cued_since, "presses": presses},
            metrics={"pressed": len(pressed), "still": still},
        )

    return judge


@dc.dataclass(frozen=True)
class KeysGoal(Goal):
    """Three keys under the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. Keys are pressed along +x of B, out of the palm.
    """

    # (3, 3) centre of each key's top at rest in B, m.
    p_BK: np.ndarray
    # (F,) key of each finger, -1 for none.
    key_of: np.ndarray
    # (F, 3) fingertips in B above the keys and on pressed keys, m.
    p_BF_open: np.ndarray
    p_BF_pressed: np.ndarray

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.p_BF_pressed


def plans(description: HandDescription) -> list[Plan]:
    """Plans places of the keys. Postures: `open` above them, and `pressed`, one for each pressed key."""
    planner = FingerPlanner(description, FINGERS, "the keys need")
    hand = planner.hand
    # The hand starts in its default position. Fingers that start inside the keys stay hooked under them.
    tips = hand.fingertips(hand.default_position)
    start = tips[planner.fingers, 0] + planner.radius
    y = tips[planner.fingers[1], 1]

    def reach(p_BF: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
        q = planner.reach(p_BF, guess)
        return q if q is not None and planner.tips_point_down(q, _MIN_SLOPE) else None

    def plan_at(x: float, z: float) -> Plan | None:
        p_BK = np.array([[x, y + planner.side * offset, z] for offset in (PITCH, 0.0, -PITCH)])
        p_BK_above = p_BK - np.outer(planner.radius + HOVER, [1.0, 0.0, 0.0])
        if (q_open := reach(p_BK_above, hand.default_position)) is None:
            return None
        q_pressed = []
        for key in range(3):
            target = p_BK_above.copy()
            target[key, 0] += HOVER + TRAVEL
            if (q := reach(target, q_open)) is None:
                return None
            q_pressed.append(q)
        key_of = np.full(len(planner.touches), -1)
        key_of[planner.fingers] = np.arange(len(planner.fingers))
        p_BF_open = planner.all_tips(p_BK_above)
        goal = KeysGoal(
            finger_names=tuple(hand.finger_names),
            touches=planner.touches,
            clearance=_CLEARANCE,
            p_BK=p_BK,
            key_of=key_of,
            p_BF_open=p_BF_open,
            p_BF_pressed=p_BF_open + [HOVER + TRAVEL, 0.0, 0.0],
        )
        return Plan(goal, (planner.discomfort(q_open),), {"open": q_open, "pressed": q_pressed})

    reached = [plan for x in _X[_X > start.max() + HOVER] for z in _Z if (plan := plan_at(x, z)) is not None]
    return planner.best_first(reached, f"reach three keys {1000 * PITCH:.0f} mm apart")


def _add(site: Site) -> Handled:
    """Adds key caps on springs above a bed; they are pressed along +x of B."""
    plant, goal, X_WB = site.plant, site.goal, site.X_WB
    assert isinstance(goal, KeysGoal)
    model = plant.AddModelInstance("keys")
    bed = plant.AddRigidBody("bed", model, SpatialInertia.SolidBoxWithMass(0.5, 0.006, 0.15, 0.06))
    depth = _CAP_HEIGHT + TRAVEL + 0.004  # from the caps' tops to the middle of the bed
    X_WBed = X_WB @ RigidTransform(goal.p_BK.mean(axis=0) + [depth, 0, 0])
    plant.WeldFrames(plant.world_frame(), bed.body_frame(), X_WBed)
    plant.RegisterVisualGeometry(bed, RigidTransform(), Box(0.006, 0.15, 0.06), "bed", _BED_COLOR)
    caps, joints = [], []
    shape = Box(_CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
    for number, p in enumerate(goal.p_BK):
        inertia = SpatialInertia.SolidBoxWithMass(_CAP_MASS, _CAP_HEIGHT, CAP_WIDTH, CAP_LENGTH)
        cap = plant.AddRigidBody(f"cap_{number + 1}", model, inertia)
        X_WCap = X_WB @ RigidTransform(p + [_CAP_HEIGHT / 2, 0, 0])
        rest = plant.AddFrame(FixedOffsetFrame(f"rest_{number + 1}", bed, X_WBed.inverse() @ X_WCap))
        axis = [1.0, 0.0, 0.0]
        joint = plant.AddJoint(
            PrismaticJoint(f"key_{number + 1}", rest, cap.body_frame(), axis, 0.0, TRAVEL, _DAMPING)
        )
        plant.AddForceElement(PrismaticSpring(joint, 0.0, _STIFFNESS))
        plant.RegisterCollisionGeometry(cap, RigidTransform(), shape, "cap", _FRICTION)
        plant.RegisterVisualGeometry(cap, RigidTransform(), shape, "cap", _COLOR)
        caps.append(cap)
        joints.append(joint)
    # Cues every key equally often.
    cued = site.rng.permutation(np.arange(round(site.settings.presses)) % len(goal.p_BK))
    names = [f"key {number + 1}" for number in range(len(caps))]
    return Handled(
        bed,
        judgement(site.settings, cued.tolist()),
        ["none", *names],
        parts=caps,
        joints=joints,
        positions=(names, "m"),
    )


TASK = Task(
    name="keys",
    summary="press the cued one of three keys without moving the others",
    scenario=PARKED_HAND,
    plans=lambda scenario, description: [plan.goal for plan in plans(description)],
    add=_add,
    phases=KEYS,
    percepts=("positions", "phase"),  # the phase is the cued key
    settings=KeysSettings,
)
