"""The simulated person by itself: what is decided on what is seen."""

import dataclasses as dc
from collections import deque
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from grasp_setup import reach_goal
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from shared import synthesized

from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.solid import MAX_INTERPENETRATION, SolidHand
from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.engine import KINDS, Moment, Person, opposition
from geort_drake.simulation.person.finger_motion import FingerMotion
from geort_drake.simulation.person.handling import (
    GRASP,
    PLACE,
    closing_speed,
    has_closed,
    has_retreated,
    is_before,
    is_down,
    is_gathered,
    is_lifted,
    let_go,
    letting_go_speed,
    rise,
    squeeze,
)
from geort_drake.simulation.person.perception import FreePlay, Percept
from geort_drake.simulation.wrist_motion import WristMovement

QUIET = dict.fromkeys(
    ("visual_noise", "visual_depth_noise", "visual_turn_noise", "contact_noise", "motor_noise"), 0.0
)
# Fingers bend their last joint by two thirds of the one before; the thumb bends both alike.
COUPLING = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 2 / 3])


@cache
def own_play() -> np.ndarray:
    """Fingertips (T, 4, 3), m, of half a minute of the person's free play."""
    return synthesized(0, 30.0, 30.0).fingertips([4, 8, 12, 16])


class StandInWorld:
    """A robot without physics: its tips move with the human tips at a known gain, and are seen late.

    A finger touches where its tip is at the wanted surface point or beyond, in the inward direction, and no
    farther than `radius`, m, from it across. From the moment all grasping fingers touch and the hand is
    raised, the object comes along, but not on the first `slips` lifts.
    """

    radius = np.inf

    def __init__(self, gain: float, config: OperatorConfig, slips: int = 0):
        self.hand = HumanHand.anatomical()
        self.config = config
        self._gain, self._slips = gain, slips
        theta = FingerMotion(self.hand).rest
        self._rest = rest = self.hand.fingertips(theta)[:4]
        centre = rest[:3].mean(axis=0)
        X_OB = RigidTransform(-centre)
        usual = reach_goal()  # of thumb, index and middle fingers
        n_OF = opposition(rest, usual.touches, 0)
        n_OF /= np.maximum(np.linalg.norm(n_OF, axis=1, keepdims=True), 1e-9)
        self.goal = dc.replace(
            usual,
            X_OB=X_OB,
            X_OB_before=X_OB @ RigidTransform([-0.08, 0, 0]),
            p_BF_open=rest - 0.024 * n_OF,
            p_OF_touch=rest - 0.012 * n_OF - centre,
            n_OF=n_OF,
        )
        self.X_WO = RigidTransform([0.5, 0.02, 0.15])
        self.X_WB_start = RigidTransform([0.3, 0.1, 0.2])
        self.X_WB = self.X_WB_start
        self._p_BO_held: np.ndarray | None = None
        self._past: deque[Percept] = deque(maxlen=round(config.visual_delay / config.period))

    def robot_tips(self, p_HF: np.ndarray) -> np.ndarray:
        """(..., 4, 3) in B for own fingertips, m."""
        return self._rest + self._gain * (p_HF - self._rest)

    def advance(self, theta: np.ndarray, X_WH: RigidTransform, lifting: bool) -> Percept:
        """What the person sees after the robot has followed hand and wrist."""
        self.X_WB = RigidTransform(X_WH.rotation(), self.X_WB_start.translation() + X_WH.translation())
        p_BF = self.robot_tips(self.hand.fingertips(theta)[:4])
        p_WF = self.X_WB.multiply(p_BF.T).T
        off = p_WF - self.X_WO.translation() - self.goal.p_OF_touch
        depth = (off * self.goal.n_OF).sum(axis=1)
        beside = np.linalg.norm(off - depth[:, None] * self.goal.n_OF, axis=1) > self.radius
        beside |= np.linalg.norm(off, axis=1) > 0.06  # has not come to the object
        contact = np.where(self.goal.touches & ~beside, np.maximum(100.0 * (depth + 1e-4), 0.0), 0.0)
        if lifting and self._p_BO_held is None and contact[self.goal.touches].all():
            self._p_BO_held = (self.X_WB.inverse() @ self.X_WO).translation()
        if not lifting and self._p_BO_held is not None:
            self._p_BO_held = None
            self._slips -= 1
        if self._p_BO_held is not None and self._slips <= 0:
            self.X_WO = RigidTransform(self.X_WB @ self._p_BO_held)
        self._past.append(Percept(p_WF, self.X_WB, self.X_WO, contact, RigidTransform([0.5, 0.2, 0.15])))
        return self._past[0]


class PinchWorld(StandInWorld):
    """An object of 10 mm between thumb and index finger, and a map that leaves `gap`, m, where they pinch."""

    radius = 0.005

    def __init__(self, gap: float, config: OperatorConfig):
        super().__init__(1.0, config)
        play = own_play()[:, :2]
        apart = np.linalg.norm(play[:, 1] - play[:, 0], axis=1)
        pinch = int(apart.argmin())
        thumb, index = play[pinch]
        along = (index - thumb) / np.linalg.norm(index - thumb)
        outwards = np.array([-along, along, 0 * along, 0 * along])
        self._opening, middle = gap / 2 * outwards, 0.5 * (thumb + index)
        X_OB, p_BF_open = RigidTransform(-middle), np.full((4, 3), np.nan)
        p_BF_open[:2] = play[pinch + int((apart[pinch:] > 0.04).argmax())]
        self.goal = dc.replace(
            self.goal,
            touches=np.array([True, True, False, False]),
            X_OB=X_OB,
            X_OB_before=X_OB @ RigidTransform([-0.08, 0, 0]),
            p_BF_open=p_BF_open,
            p_OF_touch=0.005 * outwards,
            n_OF=-outwards,
        )

    def robot_tips(self, p_HF: np.ndarray) -> np.ndarray:
        return p_HF + self._opening


def act(
    gain: float,
    seed: int = 3,
    slips: int = 0,
    kind: str = "servo",
    phases: tuple = GRASP,
    duration: float = 30.0,
    **changes: float,
) -> SimpleNamespace:
    """Lets a person grasp in the stand-in world."""
    config = dc.replace(OperatorConfig(), **changes)
    return act_in(StandInWorld(gain, config, slips), seed, kind, phases, duration)


def act_in(
    world: StandInWorld, seed: int = 3, kind: str = "servo", phases: tuple = GRASP, duration: float = 30.0
) -> SimpleNamespace:
    """Lets a person grasp to one second into the hold, or grasp and lift to carry, in that world."""
    config = world.config
    own = own_play()
    goal = dc.replace(world.goal, play=FreePlay(own, world.robot_tips(own)))
    placing = SimpleNamespace(hover=0.02, upright=False)
    person = Person(world.hand, goal, phases, kind, config, placing, np.random.default_rng(seed))
    names = [phase.name for phase in phases]
    memory = person.start(RigidTransform())
    p_WO = world.X_WO.translation()
    visited, theta, wrist, force = ["reach"], [memory.theta], [], []
    for step in range(round(duration / config.period)):
        phase = names[memory.phase]
        seen = world.advance(memory.theta, memory.X_WH, phase in ("lift", "hold"))
        memory = person.step(memory, step * config.period, seen)
        theta.append(memory.theta)
        wrist.append(memory.X_WH.translation())
        if names[memory.phase] != visited[-1]:
            visited.append(names[memory.phase])
        if visited[-1] == "lift":
            force.append(seen.contact[:3])
        if visited[-1] == "carry":
            break
        if visited[-1] == "hold" and step * config.period > memory.phase_start + 1.0:
            break
    return SimpleNamespace(
        phases=visited,
        theta=np.array(theta),
        wrist=np.array(wrist),
        attempts=memory.attempt,
        raised=float(world.X_WO.translation()[2] - p_WO[2]),
        force=np.array(force[-1]) if force else np.zeros(3),
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gain", [pytest.param(0.7, marks=pytest.mark.slow), 1.5])
def test_every_kind_of_person_squeezes_until_it_feels_enough(gain, kind):
    """At first try, and whatever the gain: the weaker side feels half of the force or more, within limits."""
    session = act(gain, kind=kind, phases=PLACE)
    assert session.phases == [*STRAIGHT[:-1], "carry"]
    # Motion during the delay of touch, and its average, adds to the force at which the person stops.
    config = OperatorConfig()
    delay = config.visual_delay + config.judging_time + 2 * config.period
    late = 100.0 * gain * config.squeeze_speed * delay
    thumb, others = session.force[0], session.force[1:].sum()
    assert 0.5 * config.grip_force < min(thumb, others) < 1.4 * config.grip_force + late


def test_what_presses_is_internal(rng):
    """It neither shifts nor turns what is held, wherever the contacts are; a finger that is off it rests."""
    for _ in range(20):
        p, touches = rng.normal(0, 0.03, (4, 3)), np.array([True, True, True, False])
        motion = opposition(p, touches, 0)
        np.testing.assert_allclose(motion.sum(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.cross(p, motion).sum(axis=0), 0.0, atol=1e-12)
        assert np.linalg.norm(motion[1]) == pytest.approx(0.5) and not motion[3].any()


@pytest.mark.parametrize(("upright", "roll"), [(True, 0.2), (False, 0.2), (True, 1.4), (False, 1.4)])
def test_a_person_turns_an_object_upright_only_if_it_must_stand(upright, roll, rng):
    """On the way to its place."""
    config = dc.replace(OperatorConfig(), **QUIET)
    world = StandInWorld(1.0, config)
    goal, placing = dc.replace(world.goal, yaw_symmetry=0.0), SimpleNamespace(hover=0.02, upright=upright)
    person = Person(world.hand, goal, PLACE, "servo", config, placing, rng)
    X_WB, X_WO = world.X_WB, RigidTransform(RollPitchYaw(roll, -0.1, 0.5), [0.5, 0, 0.3])
    X_BO = X_WB.inverse() @ X_WO
    carry = [phase.name for phase in PLACE].index("carry")
    notes = {"p_BO": X_BO.translation(), "pressed": np.zeros((4, 3))}
    memory = dc.replace(
        person.start(RigidTransform()), phase=carry, is_looking=True, p_BO=X_BO.translation(), notes=notes
    )
    seen = Percept(np.zeros((4, 3)), X_WB, X_WO, np.ones(4), RigidTransform([0.5, 0.2, 0.15]))
    end = person.step(memory, 1.0, seen).movement.X_end  # of the wrist, from the identity
    X_WB = RigidTransform(end.rotation() @ X_WB.rotation(), X_WB.translation() + end.translation())
    np.testing.assert_allclose((X_WB @ X_BO).translation(), [0.5, 0.2, 0.17], atol=1e-9)
    up = (X_WB @ X_BO).rotation().matrix()[2, 2]
    assert up == pytest.approx(1.0 if upright else X_WO.rotation().matrix()[2, 2])


def moment(world: StandInWorld, phase: str, seen: Percept, rng: np.random.Generator, **notes) -> Moment:
    """What a person decides upon, one second after a phase of `PLACE` began."""
    placing = SimpleNamespace(hover=0.02, upright=False)
    person = Person(world.hand, world.goal, PLACE, "servo", world.config, placing, rng)
    p_BO = (seen.X_BW @ seen.X_WO).translation()
    memory = dc.replace(
        person.start(RigidTransform()),
        phase=[row.name for row in PLACE].index(phase),
        p_BO=p_BO,
        error=np.zeros((4, 3)),
        movement=WristMovement(RigidTransform(), RigidTransform(), 0.0, 9.0),
        notes={"p_BO": p_BO, **notes},
    )
    return Moment(1.0, seen, memory, np.zeros((4, 3)), world.goal, world.config, placing)


@pytest.mark.parametrize(
    ("slid", "below", "lowered", "following"),
    [
        (0.0, 0.03, 0, None),
        (0.03, 0.03, 0, "carry"),
        (0.03, 0.03, 3, "carry"),
        (0.03, 0.03, 4, "open"),
        (0.03, 0.0, 0, "open"),
    ],
)
def test_a_hand_stops_lowering_what_stays_behind_it(slid, below, lowered, following, rng):
    """One that stands above its place is raised again, up to four times; one at its place is let go."""
    world = StandInWorld(1.0, OperatorConfig())
    X_WO = RigidTransform([0.5, 0.2, 0.15])
    seen = Percept(
        np.zeros((4, 3)), world.X_WB, X_WO, np.ones(4), RigidTransform(X_WO.translation() - [0, 0, below])
    )
    before = (seen.X_BW @ X_WO).translation() - seen.X_BW.rotation().matrix() @ [0, 0, slid]
    m = moment(world, "lower", seen, rng, p_BO_carried=before, lowered=lowered)
    assert is_down(m) == following


@pytest.mark.parametrize(
    ("risen", "movements", "rises"), [(0.15, 1, False), (0.13, 1, False), (0.1, 1, True), (0.1, 4, False)]
)
def test_a_hand_that_stayed_too_low_rises_again(risen, movements, rises, rng):
    """As after a gap of the tracker in which the robot's hand stood; up to four times."""
    world = StandInWorld(1.0, OperatorConfig())
    seen = Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.ones(4))
    m = moment(world, "lift", seen, rng, contact=np.ones(4))
    m.memory.movement = None
    intended = rise(m)
    np.testing.assert_allclose((intended.translation() - world.X_WB.translation())[2], 0.15)
    X_WB = RigidTransform([0, 0, risen]) @ world.X_WB
    m.percept = dc.replace(seen, X_WB=X_WB)
    m.memory.movement, m.memory.movements = WristMovement(X_WB, X_WB, 0.0, 0.5), movements
    assert is_lifted(m) == (None if rises else "hold")
    assert (rise(m) is intended) == rises


def test_a_hand_lowers_what_it_holds_slowly(rng):
    """From 0.1 m above its place; other movements of the wrist are faster."""
    world, config = StandInWorld(1.0, OperatorConfig()), OperatorConfig()
    X_WP = RigidTransform(world.X_WO.translation() - [0, 0, 0.1])
    m = moment(world, "lower", Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.ones(4), X_WP), rng)
    m.memory.movement = None
    person = Person(world.hand, world.goal, PLACE, "servo", config, m.settings, rng)
    person._move_wrist(m)
    movement = m.memory.movement
    way = np.linalg.norm(movement.X_end.translation() - movement.X_start.translation())
    peak = 1.875 * way / movement.duration
    assert 0.9 * config.lowering_speed < peak < 1.1 * config.lowering_speed < config.peak_wrist_speed


def test_fingers_let_go_straight_off_the_object_and_open_once_they_no_longer_feel_it(rng):
    """Along the surface they would turn it over, and a slow one would push it when others have left."""
    world = StandInWorld(1.0, OperatorConfig())
    p_BF = world.goal.p_BF_open + rng.normal(0, 0.01, (4, 3))
    touches = world.goal.touches
    for feels in (touches, np.zeros(4, bool)):
        p_WF = world.X_WB.multiply(p_BF.T).T
        seen = Percept(p_WF, world.X_WB, world.X_WO, feels.astype(float), world.X_WO)
        m = moment(world, "open", seen, rng, pressed=np.zeros((4, 3)))
        way, inwards = let_go(m) - p_BF, opposition(p_BF, touches, m.thumb)
        off = -np.einsum("fi,fi->f", way, inwards) / np.linalg.norm(inwards, axis=1).clip(1e-9)
        speed = letting_go_speed(m)
        if feels.any():
            np.testing.assert_allclose(off[feels], np.linalg.norm(way[feels], axis=1))
            assert (speed[feels] == world.config.squeeze_speed).all()
        np.testing.assert_allclose((p_BF + way)[~feels], world.goal.p_BF_open[~feels])
        assert (speed[~feels] == world.config.opening_speed).all()


@pytest.mark.parametrize(
    ("since", "away", "following"), [(0.9, 0.0, None), (1.1, 0.0, "reach"), (1.1, 0.1, None)]
)
def test_a_person_whose_task_is_not_over_begins_again(since, away, following, rng):
    """Once the hand is back before the object."""
    world = StandInWorld(1.0, OperatorConfig())
    X_WB = RigidTransform([away, 0, 0]) @ world.goal.object_frame(world.X_WO) @ world.goal.X_OB_before
    m = moment(world, "retreat", Percept(np.zeros((4, 3)), X_WB, world.X_WO, np.zeros(4)), rng)
    m.t, m.memory.movement = since, None
    assert has_retreated(m) == following


@pytest.mark.parametrize(("pushed", "following"), [(0.0, None), (0.01, "close")])
def test_an_object_that_moves_while_the_hand_surrounds_it_is_grasped_at_once(pushed, following, rng):
    """However far the fingers still are; the wrist is on its way."""
    world = StandInWorld(1.0, OperatorConfig())
    seen = Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.zeros(4))
    m = moment(world, "surround", seen, rng, p_WO=world.X_WO.translation() + [pushed, 0, 0])
    assert is_gathered(m) == following


@pytest.mark.parametrize(
    ("contact", "still", "following"),
    [
        ((1.0, 1.0, 1.0, 0.0), False, "squeeze"),
        ((1.0, 1.0, 0.0, 0.0), False, None),  # the middle finger still comes nearer
        ((1.0, 1.0, 0.0, 0.0), True, "squeeze"),
        ((0.0, 1.0, 1.0, 0.0), True, "release"),  # nothing is held without the thumb
        ((1.0, 0.0, 0.0, 0.0), True, "release"),
        ((0.0, 0.0, 0.0, 0.0), True, "release"),
        ((1.0, 0.0, 0.0, 0.0), False, None),
    ],
)
def test_a_finger_that_comes_no_nearer_is_not_waited_for(contact, still, following, rng):
    """The person squeezes what others hold, or tries again."""
    world = StandInWorld(1.0, OperatorConfig())
    seen = Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.array(contact))
    m = moment(world, "close", seen, rng)
    m.t, m.memory.movement, m.memory.movements = 3.0, None, world.config.max_corrections
    m.memory.best_time = 0.0 if still else m.t
    assert has_closed(m) == following
    assert m.memory.attempt == (2 if following == "release" else 1)


@pytest.mark.parametrize(("moved", "better"), [(2.0, 0.0), (0.0, 2.0)])
def test_fingers_have_the_time_to_close_after_the_hand_has_moved_and_they_came_nearer(moved, better, rng):
    """31.5 mm at 20 mm/s, and the delay of vision; the thumb alone feels the object."""
    world = StandInWorld(1.0, OperatorConfig())
    contact = np.array([1.0, 0.0, 0.0, 0.0])
    m = moment(world, "close", Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, contact), rng)
    m.memory.movements, m.memory.best_time = world.config.max_corrections, better
    m.memory.movement = WristMovement(RigidTransform(), RigidTransform(), 0.0, moved)
    m.t = 3.4
    assert has_closed(m) is None
    m.t = 3.9
    assert has_closed(m) == "release"


def test_a_contact_that_is_not_felt_for_a_moment_still_holds(rng):
    world = StandInWorld(1.0, OperatorConfig())
    seen = [
        Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.array([1.0, f, 0.0, 0.0])) for f in (1.0, 0.0)
    ]
    m = moment(world, "close", seen[0], rng)
    m.t, m.memory.movement, m.memory.best_time = 1.70, None, 0.0
    m.memory.movements = world.config.max_corrections
    assert has_closed(m) is None
    late = Moment(1.74, seen[1], m.memory, m.expected, m.goal, m.config, m.settings)
    assert has_closed(late) is None
    late.t = 1.76  # 31.5 mm at 20 mm/s, and the delay of vision
    assert has_closed(late) == "squeeze"


def test_leading_fingers_do_not_wait_for_one_that_comes_no_nearer(rng):
    world = StandInWorld(1.0, OperatorConfig())
    m = moment(world, "close", Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, np.zeros(4)), rng)
    m.memory.error = np.array([[0.02, 0.0, 0.0], [0.02, 0.0, 0.0], [0.04, 0.0, 0.0], [0.0, 0.0, 0.0]])
    m.memory.best_time = m.t
    np.testing.assert_allclose(closing_speed(m)[:3], [0.0, 0.0, world.config.closing_speed])
    m.memory.best_time = 0.0
    np.testing.assert_allclose(closing_speed(m)[:3], world.config.closing_speed)


@pytest.mark.parametrize(
    ("error", "since", "still", "away", "following"),
    [
        (0.02, 1.0, True, 0.0, None),
        (0.02, 5.0, True, 0.0, "approach"),
        (0.02, 5.0, False, 0.0, None),  # the fingers still come nearer
        (0.02, 5.0, True, 0.1, None),  # the hand is not there yet
        (0.011, 1.0, True, 0.0, "approach"),
    ],
)
def test_fingers_that_cannot_be_shaped_go_to_the_object_all_the_same(
    error, since, still, away, following, rng
):
    """The clearance is 12 mm."""
    world = StandInWorld(1.0, OperatorConfig())
    X_WB = RigidTransform([away, 0, 0]) @ world.goal.object_frame(world.X_WO) @ world.goal.X_OB_before
    m = moment(world, "reach", Percept(np.zeros((4, 3)), X_WB, world.X_WO, np.zeros(4)), rng)
    m.t, m.memory.movement, m.memory.best_time = since, None, 0.0 if still else since
    m.memory.error = np.array([[error, 0.0, 0.0]] * 4)
    assert is_before(m) == following


@pytest.mark.parametrize("kind", KINDS)
def test_the_hand_opens_once_as_it_did_in_play(kind):
    """The remembered movement leads to the open hand, and what is intended then begins there."""
    config = dc.replace(OperatorConfig(), **QUIET)
    world = StandInWorld(1.0, config)
    goal = dc.replace(world.goal, play=FreePlay(own_play(), world.robot_tips(own_play())))
    person = Person(world.hand, goal, GRASP, kind, config, None, np.random.default_rng(0))
    memory, off = person.start(RigidTransform()), []
    for step in range(150):
        memory = person.step(memory, step * config.period, world.advance(memory.theta, memory.X_WH, False))
        if step * config.period > memory.phase_start + memory.settle_time and memory.phase == 0:
            if not off:
                np.testing.assert_array_equal(memory.reference, goal.p_BF_open)
            off.append(np.linalg.norm(memory.p_HF_past[-1] - memory.p_HF_open, axis=1)[:3].max())
    assert off[0] < 0.003
    assert max(off) < (0.018 if kind == "mimicry" else 0.02)


def test_the_hand_opens_again_from_where_it_is(rng):
    """After it has retreated from an object that it put down in the wrong place."""
    config = dc.replace(OperatorConfig(), **QUIET)
    world = StandInWorld(1.0, config)
    placing = SimpleNamespace(hover=0.02, upright=False)
    person = Person(world.hand, world.goal, PLACE, "servo", config, placing, rng)
    X_WB = world.goal.object_frame(world.X_WO) @ world.goal.X_OB_before
    start = person.start(RigidTransform())
    memory = dc.replace(
        start,
        theta=np.deg2rad([30.0, 0, 10, 10] + 4 * [0, 20, 20, 13]),
        phase=[row.name for row in PLACE].index("retreat"),
        is_looking=True,
    )
    memory = person.step(memory, 2.0, Percept(np.zeros((4, 3)), X_WB, world.X_WO, np.zeros(4)))
    assert memory.phase == 0 and memory.attempt == 2
    np.testing.assert_allclose(memory.p_HF_start, world.hand.fingertips(memory.theta), atol=1e-3)
    assert np.abs(memory.p_HF_start - start.p_HF_start).max() > 0.005


def test_a_finger_that_has_lost_the_object_is_wanted_there_again(rng):
    """The errors of fingers that feel the object are NaN, and later ones must not stay so."""
    config = dc.replace(OperatorConfig(), **QUIET)
    world = StandInWorld(1.0, config)
    person = Person(world.hand, world.goal, GRASP, "servo", config, None, rng)
    memory = dc.replace(person.start(RigidTransform()), phase=3, is_looking=True)
    for t, felt in ((0.0, 0.0), (0.01, 1.0), (0.02, 0.0)):
        contact = np.array([felt, 0.0, 0.0, 0.0])
        memory = person.step(memory, t, Percept(np.zeros((4, 3)), world.X_WB, world.X_WO, contact))
        assert np.isnan(memory.error[0]).all() == (felt > 0)


def test_each_finger_presses_until_it_has_its_part_of_the_grip(rng):
    """One that presses harder than the other would push the object out between them."""
    world = StandInWorld(1.0, OperatorConfig())
    force = OperatorConfig().grip_force
    contact = np.array([0.9, 0.1, 0.8, 0.0]) * force
    seen = Percept(world.X_WB.multiply(world.goal.p_BF_open.T).T, world.X_WB, world.X_WO, contact)
    m = moment(world, "squeeze", seen, rng, pressed=np.zeros((4, 3)), contact=contact)
    speed = np.linalg.norm(squeeze(m), axis=1)
    assert speed[1] > 0.01 and speed[0] == pytest.approx(speed[1]) and speed[2] == speed[3] == 0


def test_a_thumb_that_bears_the_whole_grip_rests_while_the_fingers_press(rng):
    """What stands fast feels the thumb's force alone, and would be turned by it."""
    world = StandInWorld(1.0, OperatorConfig())
    contact = np.array([1.1, 0.1, 0.1, 0.0]) * OperatorConfig().grip_force
    seen = Percept(world.X_WB.multiply(world.goal.p_BF_open.T).T, world.X_WB, world.X_WO, contact)
    m = moment(world, "squeeze", seen, rng, pressed=np.zeros((4, 3)), contact=contact)
    speed = np.linalg.norm(squeeze(m), axis=1)
    assert speed[0] == speed[3] == 0 and (speed[1:3] > 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["adaptive", "servo"])
def test_a_map_with_a_gap_in_the_pinch_cannot_hold_what_is_thinner(kind, monkeypatch):
    """A gap of 30 mm, an object of 10 mm: the own thumb and finger meet before the robot's touch.

    A person whose fingers pass through one another would hold it.
    """
    config, solid = dc.replace(OperatorConfig(), **QUIET), SolidHand(HumanHand.anatomical())
    closed, gapped = (act_in(PinchWorld(gap, config), kind=kind, duration=12.0) for gap in (0.0, 0.03))
    assert closed.phases == STRAIGHT and closed.raised > 0.1
    assert "hold" not in gapped.phases and gapped.raised == 0.0
    for session in (closed, gapped):
        depths = solid.depths(session.theta)
        assert depths.max() < MAX_INTERPENETRATION + 1e-6
        assert depths[:, 0].max() > 0.0  # thumb and index finger meet
    monkeypatch.setattr(SolidHand, "depths", lambda self, theta: np.full((*np.shape(theta)[:-1], 10), -1.0))
    monkeypatch.setattr(SolidHand, "move", lambda self, theta, wanted: (wanted, np.zeros(5, bool)))
    assert act_in(PinchWorld(0.03, config), kind=kind, duration=12.0).raised > 0.1


STRAIGHT = ["reach", "approach", "surround", "close", "squeeze", "lift", "hold"]


@pytest.mark.parametrize("gain", [pytest.param(0.5, marks=pytest.mark.slow), 1.5, 3.0])
def test_the_person_grasps_through_maps_of_different_gain(gain):
    """Reach, approach, surround, close, squeeze, lift, hold: without knowing the gain, at first try.

    Joints keep the hand's limits and bend together, and no fingertip outruns a person's.
    """
    session, config, hand = act(gain), OperatorConfig(), HumanHand.anatomical()
    assert session.phases == STRAIGHT
    assert session.attempts == 1
    assert session.raised == pytest.approx(config.lift_height, abs=0.03)
    assert (session.theta >= hand.lower - 1e-9).all() and (session.theta <= hand.upper + 1e-9).all()
    bends = session.theta.reshape(-1, 5, 4)
    # Digits that meet at a joint limit bend their outer joints a little apart.
    np.testing.assert_allclose(bends[..., 3], COUPLING * bends[..., 2], atol=0.02)
    speed = np.linalg.norm(np.diff(hand.fingertips(session.theta), axis=0), axis=-1) / config.period
    # Motor noise adds to the wanted speed.
    assert speed.max() < config.max_fingertip_speed * (1 + 6 * config.motor_noise)
    wrist_speed = np.linalg.norm(np.diff(session.wrist, axis=0), axis=-1) / config.period
    assert wrist_speed.max() < config.peak_wrist_speed * (1 + 6 * config.motor_noise)


def test_the_person_tries_again_when_the_object_stays_behind():
    """An object lost in the lift is noticed; the hand opens, goes back and the second attempt holds."""
    session = act(1.5, slips=1)
    lost = session.phases.index("release")
    assert session.phases[:lost] in (STRAIGHT, STRAIGHT[:-1])
    assert session.phases[lost + 1 :] == STRAIGHT[1:]
    assert session.attempts == 2
    assert session.raised > 0.1


def test_the_grasp_also_holds_without_touch():
    """Fingers close until they come no further."""
    session = act(1.5, touch=False)
    assert session.phases == STRAIGHT and session.raised > 0.1


@pytest.mark.slow
def test_the_grasp_also_holds_in_a_noisier_scene():
    """Four times as much."""
    noisy = {name: 4 * getattr(OperatorConfig(), name) for name in QUIET}
    session = act(1.5, **noisy)
    assert session.phases == STRAIGHT and session.attempts == 1


def test_one_seed_gives_one_session_and_another_gives_another():
    """All noise comes from the generator, and all chance is noise."""
    first, again, other = (act(1.2, seed=seed, duration=2.0) for seed in (5, 5, 6))
    quiet, silent = (act(1.2, seed=seed, duration=2.0, **QUIET) for seed in (5, 6))
    np.testing.assert_array_equal(quiet.theta, silent.theta)
    np.testing.assert_array_equal(first.theta, again.theta)
    np.testing.assert_array_equal(first.wrist, again.wrist)
    count = min(len(first.theta), len(other.theta))
    assert np.abs(first.theta[:count] - other.theta[:count]).max() > 1e-3


@pytest.mark.parametrize("symmetry", [0.0, np.pi / 2, np.pi])
def test_the_object_frame_is_upright_and_takes_the_nearest_of_equivalent_yaws(symmetry, rng):
    """The wrist never turns further than half the object's symmetry; a leaning object is grasped upright."""
    goal = dc.replace(StandInWorld(1.0, OperatorConfig()).goal, yaw_symmetry=symmetry)
    for yaw in rng.uniform(-np.pi, np.pi, 100):
        R_WO = RotationMatrix.MakeZRotation(yaw) @ RotationMatrix.MakeYRotation(0.2)
        X_WO = goal.object_frame(RigidTransform(R_WO, [1, 2, 3]))
        roll, pitch, turn = RollPitchYaw(X_WO.rotation()).vector()
        np.testing.assert_allclose([roll, pitch], 0.0, atol=1e-12)
        assert abs(turn) <= symmetry / 2 + 1e-12
        if symmetry:
            steps = (yaw - turn) / symmetry
            assert steps == pytest.approx(round(steps), abs=1e-9)
        np.testing.assert_array_equal(X_WO.translation(), [1, 2, 3])


def test_a_cube_that_has_tumbled_keeps_the_yaw_of_its_sides(rng):
    """Whichever axis is up, and however little it leans: the grasp's axes are normal to two of its sides."""
    goal = dc.replace(StandInWorld(1.0, OperatorConfig()).goal, yaw_symmetry=np.pi / 2)
    for roll, pitch in ((0, 0), (np.pi / 2, 0), (0, np.pi / 2), (np.pi, 0), (0, -np.pi / 2)):
        yaw = rng.uniform(-0.7, 0.7)
        lean = RollPitchYaw(rng.normal(0, 0.02, 3)).ToRotationMatrix()
        R_WO = RotationMatrix.MakeZRotation(yaw) @ lean @ RollPitchYaw(roll, pitch, 0).ToRotationMatrix()
        X_WO = goal.object_frame(RigidTransform(R_WO, [0, 0, 0]))
        assert RollPitchYaw(X_WO.rotation()).yaw_angle() == pytest.approx(yaw, abs=0.1)
