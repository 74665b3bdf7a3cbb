"""The cap: unscrew it with three fingers, which must let go and grip again.

Figure of the result: `turned`, the turn of the cap, degrees.
"""

import dataclasses as dc
import itertools
import math

import numpy as np
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, ScrewJoint, SpatialInertia

from geort_drake.hands.description import HandDescription
from geort_drake.simulation.person.cap import CAP
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.plan.fingertips import FingerPlanner, Plan
from geort_drake.simulation.task import PARKED_HAND, Handled, Judgement, Observation, Outcome, Site, Task

RADIUS, HEIGHT = 0.020, 0.025  # m
FINGERS = ("thumb", "index", "middle")
GAP, SQUEEZE = 0.010, 0.020  # m; distance of open fingertips from the cap, depth of squeezing ones
_CLEARANCE = 0.010  # m; distance by which free play may miss a fingertip's place
# Positions of the cap in B to try, m; and angles between index and middle finger around it, rad, the smaller
# first, because fingers slip less at it.
_X, _Y, _Z = np.arange(0.06, 0.131, 0.02), np.arange(-0.02, 0.061, 0.02), np.arange(-0.02, 0.081, 0.02)
_APART = np.deg2rad([60, 70])
_STEP, _MIN_STROKE = np.deg2rad(10), np.deg2rad(40)
_LINK_CLEARANCE = 0.002  # m; least distance of finger links from the cap
STEPS = 8  # number of steps into which recordings divide the turn
_MASS, _PITCH = 0.040, 0.004  # kg; m per turn
_THREAD_FRICTION = 0.03  # N m
_FRICTION, _VARIATION = 0.8, 0.2  # of the cap; fraction by which friction and brake vary with the seed
_NECK, _NECK_HEIGHT = 0.017, 0.10  # m, radius and height of the bottle's neck
_COLOR, _RIB_COLOR = np.array([0.95, 0.45, 0.10, 1.0]), np.array([0.75, 0.33, 0.05, 1.0])
_NECK_COLOR = np.array([0.75, 0.80, 0.85, 1.0])


@dc.dataclass(frozen=True)
class CapSettings:
    """The turn that counts as unscrewed."""

    turn: float = 360.0  # degrees


def judgement(settings: CapSettings) -> Judgement:
    """Returns the function that judges how far the cap is turned."""

    def judge(previous: Outcome, observation: Observation) -> Outcome:
        angle = math.degrees(observation["joints"][0])
        score, success = min(max(angle / settings.turn, 0.0), 1.0), angle >= settings.turn
        return previous.replace(
            phase=int(STEPS * score),
            success=success,
            over=success,
            score=score,
            completion_time=previous.t if success else math.nan,
            text="success" if success else f"turned by {angle:.0f}°",
            metrics={"turned": angle},
        )

    return judge


@dc.dataclass(frozen=True)
class CapGoal(Goal):
    """A cap between the fingertips of a parked hand.

    Frames: B the hand base; F a fingertip point. The cap's axis is along x of B. The cap rises along −x when
    it is unscrewed.
    """

    thumb: int  # index of the thumb
    # (3,) middle of the cap in B, m.
    p_BC: np.ndarray
    # (F, 3) fingertips in B that touch the cap at the beginning of a stroke, m.
    p_BF_touch: np.ndarray
    # Turn of the cap in a stroke about −x of B, rad, and distance of open fingertips from the cap, m.
    stroke: float
    gap: float

    @property
    def p_BF_open(self) -> np.ndarray:
        """(F, 3) open fingertips in B at the beginning of a stroke, m."""
        return self.fingertips(0.0, -self.gap)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_BF_open, self.fingertips(self.stroke, -self.gap)

    def fingertips(self, turn: float, depth: float | np.ndarray) -> np.ndarray:
        """Returns fingertips (F, 3) in B around the cap, m.

        Args:
            turn: turn since the beginning of the stroke, rad.
            depth: number or (F,), depth below the surface, m: of the thumb towards the axis, of the others
                towards the thumb.
        """
        p = self.p_BF_touch - self.p_BC
        inwards = -p[self.thumb] / np.linalg.norm(p[self.thumb])
        signs = np.where(np.arange(len(p)) == self.thumb, 1.0, -1.0)
        p = p + np.outer(signs * depth, inwards)
        return self.turned(self.p_BC + p, turn)

    def turned(self, p_BF: np.ndarray, turn: float) -> np.ndarray:
        """Returns points (F, 3) in B, m, turned with the cap about −x of B, rad."""
        x, y, z = (p_BF - self.p_BC).T
        c, s = np.cos(turn), np.sin(turn)
        return self.p_BC + np.column_stack([x, c * y + s * z, c * z - s * y])

    def mean_turn(self, p_BF: np.ndarray, p_BG: np.ndarray) -> float:
        """Returns the mean turn of the touching fingertips about the cap, rad, positive along a stroke.

        Args:
            p_BF, p_BG: their first and last positions in B, (F, 3) m.
        """
        (y, z), (v, w) = ((p - self.p_BC)[self.touches, 1:].T for p in (p_BF, p_BG))
        return float(np.mean(np.arctan2(z * v - y * w, y * v + z * w)) * np.sign(self.stroke))

    def mirrored(self) -> "CapGoal":
        return dc.replace(super().mirrored(), stroke=-self.stroke)


class CapPlanner(FingerPlanner):
    """Plans how a hand turns a cap."""

    def __init__(self, description: HandDescription):
        super().__init__(description, FINGERS, "the cap needs")
        # Points on the cap's surface, relative to its middle.
        around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        ring = RADIUS * np.column_stack([np.zeros(12), np.cos(around), np.sin(around)])
        top = np.array([-HEIGHT / 2, 0.0, 0.0])
        self._surface = np.vstack([top, ring + top, ring - top])

    def plans(self) -> list[Plan]:
        """Plans places of the cap; the longest strokes are the best.

        Postures, each at S equal steps of a stroke: `open` (S, n) off the cap, and `held` (S, n), which
        squeeze it.
        """
        places = [np.array([x, self.side * y, z]) for x, y, z in itertools.product(_X, _Y, _Z)]
        plans: list[Plan] = []
        for angle in _APART:
            plans = plans or [plan for p_BC in places if (plan := self._plan(p_BC, angle)) is not None]
        stroke = np.rad2deg(_MIN_STROKE)
        aim = f"turn a cap of {2000 * RADIUS:.0f} mm by {stroke:.0f}° with {', '.join(FINGERS)}"
        return self.best_first(plans, aim)

    def _plan(self, p_BC: np.ndarray, angle: float) -> Plan | None:
        hand = self.hand
        angles = 0.5 * np.array([-np.pi, np.pi - angle, np.pi + angle])
        around = np.column_stack([np.zeros(3), self.side * np.cos(angles), np.sin(angles)])
        middle = CapGoal(
            finger_names=tuple(hand.finger_names),
            touches=self.touches,
            clearance=_CLEARANCE,
            thumb=int(self.fingers[0]),
            p_BC=p_BC,
            p_BF_touch=self.all_tips(p_BC + (RADIUS + self.radius)[:, None] * around),
            stroke=0.0,
            gap=GAP,
        )
        first = self._postures(middle, 0.0, (hand.default_position, hand.default_position))
        if first is None:
            return None
        backward, forward = (self._path(middle, first, sign) for sign in (-1, 1))
        path = [*reversed(backward), first, *forward]
        stroke = _STEP * (len(path) - 1)
        if stroke < _MIN_STROKE - 1e-9:
            return None
        p_BF_touch = middle.fingertips(-_STEP * len(backward), 0.0)
        goal = dc.replace(middle, p_BF_touch=p_BF_touch, stroke=stroke)
        q_open, q_held = (np.array(each) for each in zip(*path, strict=True))
        cost = -round(goal.stroke, 6), self.discomfort(first[1])
        return Plan(goal, cost, {"open": q_open, "held": q_held})

    def _path(self, goal: CapGoal, first: tuple[np.ndarray, np.ndarray], sign: int) -> list[tuple]:
        """Returns postures step by step in one direction, as far as the hand reaches."""
        path: list[tuple] = []
        for step in range(1, 19):
            postures = self._postures(goal, sign * _STEP * step, path[-1] if path else first)
            if postures is None:
                break
            path.append(postures)
        return path

    def _postures(self, goal: CapGoal, turn: float, guess: tuple[np.ndarray, np.ndarray]) -> tuple | None:
        """Returns open and squeezing joint positions (n,), rad, or None."""
        q_open = self.reach(goal.fingertips(turn, -GAP)[self.fingers], guess[0])
        q_touch = None if q_open is None else self.reach(goal.fingertips(turn, 0.0)[self.fingers], q_open)
        if q_open is None or q_touch is None:
            return None
        if not all(self.is_clear(q, goal.p_BC + self._surface, _LINK_CLEARANCE) for q in (q_open, q_touch)):
            return None
        q_held = self.reach(goal.fingertips(turn, SQUEEZE)[self.fingers], q_touch)
        return None if q_held is None else (q_open, q_held)


def _add(site: Site) -> Handled:
    """Adds a cap on the neck of a bottle; the cap rises along −x of B when it is unscrewed.

    The cap's frame has z along its axis, upwards.
    """
    plant, goal, X_WB, rng = site.plant, site.goal, site.X_WB, site.rng
    assert isinstance(goal, CapGoal)
    friction_factor, brake_factor = rng.uniform(1 - _VARIATION, 1 + _VARIATION, 2)
    model = plant.AddModelInstance("bottle")
    X_WC = X_WB @ RigidTransform(RotationMatrix.MakeYRotation(-math.pi / 2), goal.p_BC)
    neck = plant.AddRigidBody(
        "neck", model, SpatialInertia.SolidCylinderWithMass(0.1, _NECK, _NECK_HEIGHT, [0, 0, 1])
    )
    X_CN = RigidTransform([0.0, 0.0, -(HEIGHT + _NECK_HEIGHT) / 2])
    plant.WeldFrames(plant.world_frame(), neck.body_frame(), X_WC @ X_CN)
    cap = plant.AddRigidBody(
        "cap", model, SpatialInertia.SolidCylinderWithMass(_MASS, RADIUS, HEIGHT, [0, 0, 1])
    )
    joint = plant.AddJoint(
        ScrewJoint(
            "thread",
            plant.AddFrame(FixedOffsetFrame("thread_start", neck, X_CN.inverse())),
            cap.body_frame(),
            [0.0, 0.0, 1.0],
            _PITCH,
            0.0,
        )
    )
    # Drake has no dry friction in joints: a strong damper of limited torque sticks like one.
    brake = plant.AddJointActuator("brake", joint, brake_factor * _THREAD_FRICTION)
    brake.set_controller_gains(PdControllerGains(p=1e-6, d=50.0))
    friction = CoulombFriction(friction_factor * _FRICTION, friction_factor * _FRICTION)
    shapes = ((neck, Cylinder(_NECK, _NECK_HEIGHT), _NECK_COLOR), (cap, Cylinder(RADIUS, HEIGHT), _COLOR))
    for body, shape, color in shapes:
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, body.name(), friction)
        plant.RegisterVisualGeometry(body, RigidTransform(), shape, body.name(), color)
    # A mark that makes the turn visible.
    plant.RegisterVisualGeometry(
        cap, RigidTransform([RADIUS / 2, 0, 0]), Box(RADIUS, 0.004, HEIGHT + 0.001), "mark", _RIB_COLOR
    )
    steps = [f"{angle:.0f}°" for angle in np.linspace(0, site.settings.turn, STEPS + 1)]
    judge = judgement(site.settings)
    return Handled(cap, judge, steps, joints=[joint], positions=(["cap"], "rad"))


TASK = Task(
    name="cap",
    summary="unscrew a cap with three fingers, which grip again and again",
    scenario=PARKED_HAND,
    plans=lambda scenario, description: [plan.goal for plan in CapPlanner(description).plans()],
    add=_add,
    phases=CAP,
    percepts=("positions",),
    begins_straight=True,
    settings=CapSettings,
)
