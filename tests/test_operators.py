"""The simulated person by itself: what is decided on what is seen."""

import ast
import dataclasses as dc
import inspect
from collections import deque

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.people.human_hand import HumanHand
from geort_drake.simulation.operators import behavior, perception
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import FingerMotion
from geort_drake.simulation.operators.perception import Seen, SensedGain, averaged, perceive
from geort_drake.simulation.operators.state import Phase
from geort_drake.simulation.tasks.grasp.goal import GraspGoal

QUIET = dict.fromkeys(("visual_noise", "visual_turn_noise", "contact_noise", "motor_noise"), 0.0)
ROBOT_FINGERS = ("thumb", "index", "middle", "ring")


class StandInWorld:
    """A robot without physics: its tips move with the human tips at a known gain, and are seen late.

    A finger touches where its tip is at the wanted surface point or beyond, in the inward direction. From
    the moment all grasping fingers touch and the hand is raised, the object comes along, but not on the
    first `slips` lifts.
    """

    def __init__(self, gain: float, config: OperatorConfig, slips: int = 0):
        self.hand = HumanHand.anatomical()
        self.config = config
        self._gain, self._slips = gain, slips
        theta = FingerMotion(self.hand).rest
        self._rest = rest = self.hand.fingertips(theta)[:4]
        centre = rest[:3].mean(axis=0)
        # Inwards is where a finger goes that bends at its base.
        bent = theta + 0.01 * np.tile([0.0, 1.0, 0.0, 0.0], 5)
        inwards = self.hand.fingertips(bent)[:4] - rest
        inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
        X_BO = RigidTransform(centre)
        touches = np.array([True, True, True, False])
        self.goal = GraspGoal(
            finger_names=ROBOT_FINGERS,
            touches=touches,
            X_OB=X_BO.inverse(),
            X_OB_before=X_BO.inverse() @ RigidTransform([-0.08, 0, 0]),
            p_BF_open=rest - 0.02 * np.where(touches[:, None], inwards, 0.0),
            p_OF_touch=rest + 0.02 * inwards - centre,
            n_OF=np.where(touches[:, None], inwards, 0.0),
            yaw_symmetry=0.0,
        )
        self.X_WO = RigidTransform([0.5, 0.02, 0.15])
        self.X_WB_start = RigidTransform([0.3, 0.1, 0.2])
        self.X_WB = self.X_WB_start
        self._p_BO_held: np.ndarray | None = None
        self._past: deque[Seen] = deque(maxlen=round(config.visual_delay / config.period))

    def advance(self, theta: np.ndarray, X_WH: RigidTransform, lifting: bool) -> Seen:
        """What the person sees after the robot has followed hand and wrist."""
        self.X_WB = RigidTransform(X_WH.rotation(), self.X_WB_start.translation() + X_WH.translation())
        p_BF = self._rest + self._gain * (self.hand.fingertips(theta)[:4] - self._rest)
        p_WF = self.X_WB.multiply(p_BF.T).T
        depth = ((p_WF - self.X_WO.translation() - self.goal.p_OF_touch) * self.goal.n_OF).sum(axis=1)
        contact = np.where(self.goal.touches, np.maximum(100.0 * (depth + 1e-4), 0.0), 0.0)
        if lifting and self._p_BO_held is None and contact[self.goal.touches].all():
            self._p_BO_held = (self.X_WB.inverse() @ self.X_WO).translation()
        if not lifting and self._p_BO_held is not None:
            self._p_BO_held = None
            self._slips -= 1
        if self._p_BO_held is not None and self._slips <= 0:
            self.X_WO = RigidTransform(self.X_WB @ self._p_BO_held)
        self._past.append(Seen(p_WF=p_WF, X_WB=self.X_WB, X_WO=self.X_WO, contact=contact))
        return self._past[0]


@dc.dataclass
class Session:
    phases: list[Phase]
    theta: np.ndarray
    wrist: np.ndarray
    attempts: int
    raised: float
    squeeze: float
    duration: float


def act(gain: float, seed: int = 3, slips: int = 0, until: float = 20.0, **changes: float) -> Session:
    """Lets a person grasp in the stand-in world; ends one second into the hold."""
    config = dc.replace(OperatorConfig(), **changes)
    world = StandInWorld(gain, config, slips)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(seed))
    state = person.start(RigidTransform())
    p_WO = world.X_WO.translation()
    phases, theta, wrist, squeeze = [state.phase], [state.theta], [], []
    for step in range(round(until / config.period)):
        seen = world.advance(state.theta, state.X_WH, state.phase in (Phase.LIFT, Phase.HOLD))
        before = state
        state = person.step(state, step * config.period, seen)
        theta.append(state.theta)
        wrist.append(state.X_WH.translation())
        if state.phase != before.phase:
            phases.append(state.phase)
        if state.phase == Phase.SQUEEZE:
            moved = world.hand.fingertips(state.theta) - state.p_HF_start
            squeeze.append((moved[:3] * world.goal.n_OF[:3]).sum(axis=1))
        if state.phase == Phase.HOLD and step * config.period > state.phase_start + 1.0:
            break
    return Session(
        phases=phases,
        theta=np.array(theta),
        wrist=np.array(wrist),
        attempts=state.attempt,
        raised=float(world.X_WO.translation()[2] - p_WO[2]),
        squeeze=float(np.mean(squeeze[-1])) if squeeze else 0.0,
        duration=step * config.period,
    )


STRAIGHT = [
    Phase.REACH,
    Phase.APPROACH,
    Phase.SURROUND,
    Phase.CLOSE,
    Phase.SQUEEZE,
    Phase.LIFT,
    Phase.HOLD,
]


@pytest.mark.parametrize("gain", [0.7, 1.0, 1.5, 2.5])
def test_the_person_grasps_through_maps_of_different_gain(gain):
    """Reach, approach, surround, close, squeeze, lift, hold: without knowing the gain, at first try."""
    session = act(gain)
    assert session.phases == STRAIGHT
    assert session.attempts == 1
    assert session.raised == pytest.approx(OperatorConfig().lift_height, abs=0.03)
    # The squeeze asks the robot's fingertips for what the configuration says, by the gain that was sensed:
    # within 0.4 of it, as part of every motion is still under way when it is looked at.
    assert session.squeeze * gain == pytest.approx(OperatorConfig().squeeze, rel=0.4)


def test_the_sensed_gain_is_the_ratio_of_the_motions():
    """Looks a quarter second apart at motions twice as large give two; touching fingers do not count."""
    rng = np.random.default_rng(0)
    sensed, own = SensedGain(), np.zeros((4, 3))
    for look in range(20):
        own = own + rng.normal(0, 0.03, (4, 3))
        robot = 2.0 * own
        robot[3] = 0.0
        sensed = sensed.look(0.25 * look, own, robot, np.array([True, True, True, False]))
    assert sensed.ratio == pytest.approx(2.0, rel=0.02)
    again = sensed.look(4.8, own + 1.0, robot, np.ones(4, bool))
    assert again is sensed  # too soon for another look
    assert SensedGain().ratio == 1.0


def test_the_person_tries_again_when_the_object_stays_behind():
    """An object lost in the lift is noticed; the hand opens, goes back and the second attempt holds."""
    session = act(1.5, slips=1, until=30.0)
    lost = session.phases.index(Phase.RELEASE)
    assert session.phases[:lost] in (STRAIGHT, STRAIGHT[:-1])
    assert session.phases[lost + 1 :] == STRAIGHT[1:]
    assert session.attempts == 2
    assert session.raised > 0.1


def looks(config: OperatorConfig, count: int = 2000) -> tuple[Seen, list[Seen]]:
    """A scene in which two fingers touch, and what a person sees of it in so many looks."""
    world = StandInWorld(1.0, config)
    turned = RotationMatrix(RollPitchYaw(0.4, -1.0, 2.0))
    scene = dc.replace(
        world.advance(FingerMotion(world.hand).rest, RigidTransform(), lifting=False),
        X_WB=RigidTransform(turned, [0.3, 0.1, 0.2]),
        X_WO=RigidTransform(turned.inverse(), [0.5, 0.0, 0.1]),
        contact=np.array([2.0, 0.5, 0.0, 0.0]),
    )
    rng = np.random.default_rng(0)
    return scene, [perceive(scene, config, rng) for _ in range(count)]


def test_the_person_sees_tips_hand_and_object_with_noise():
    """Every seen coordinate scatters by `visual_noise`, by its own draw."""
    scene, seen = looks(OperatorConfig(visual_noise=0.002))
    points = np.array([[*one.p_WF, one.X_WB.translation(), one.X_WO.translation()] for one in seen])
    np.testing.assert_allclose(points.std(axis=0), 0.002, rtol=0.1)
    expected = [*scene.p_WF, scene.X_WB.translation(), scene.X_WO.translation()]
    np.testing.assert_allclose(points.mean(axis=0), expected, atol=2e-4)
    correlation = np.corrcoef(points.reshape(len(seen), -1).T)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 0.12


def test_the_person_sees_hand_and_object_turned_by_noise():
    """Both rotations scatter about every axis by `visual_turn_noise`, by draws of their own."""
    scene, seen = looks(OperatorConfig(visual_turn_noise=0.03))
    turns = np.array(
        [
            [
                Rotation.from_matrix((of(one) @ of(scene).inverse()).matrix()).as_rotvec()
                for of in (lambda x: x.X_WB.rotation(), lambda x: x.X_WO.rotation())
            ]
            for one in seen
        ]
    )
    np.testing.assert_allclose(turns.std(axis=0), 0.03, rtol=0.1)
    np.testing.assert_allclose(turns.mean(axis=0), 0.0, atol=0.003)
    correlation = np.corrcoef(turns.reshape(len(seen), -1).T)
    assert np.abs(correlation - np.eye(6)).max() < 0.12


def test_the_person_feels_forces_by_a_share():
    """Weber's law: felt forces scatter by `contact_noise` of the force; where none is, none is felt."""
    scene, seen = looks(OperatorConfig(contact_noise=0.2))
    felt = np.array([one.contact for one in seen])
    np.testing.assert_allclose(felt.std(axis=0), 0.2 * scene.contact, rtol=0.1)
    np.testing.assert_allclose(felt.mean(axis=0), scene.contact, rtol=0.02)
    assert abs(np.corrcoef(felt[:, :2].T)[0, 1]) < 0.12
    _, wild = looks(OperatorConfig(contact_noise=2.0), 100)
    assert min(one.contact.min() for one in wild) == 0.0


def test_a_noisier_scene_makes_the_person_slower_but_lose_nothing():
    """With four times the noise single looks are off by more than the tolerances; the grasp still holds."""
    noisy = {name: 4 * getattr(OperatorConfig(), name) for name in QUIET}
    session = act(1.5, until=30.0, **noisy)
    assert session.phases == STRAIGHT and session.attempts == 1
    assert session.squeeze * 1.5 == pytest.approx(OperatorConfig().squeeze, rel=0.4)


def test_what_is_judged_scatters_less_than_a_look_and_follows_a_change():
    """An average over `judging_time`: a fourth of the noise, and no bias once that time has passed."""
    config, rng = OperatorConfig(), np.random.default_rng(0)
    value, values = None, []
    for _ in range(3000):
        value = averaged(value, rng.normal(1.0, 1.0, 3), config)
        values.append(value)
    assert np.std(values[100:]) == pytest.approx(0.23, rel=0.1)
    value = averaged(None, np.zeros(3), config)
    np.testing.assert_array_equal(value, 0)
    for _ in range(round(5 * config.judging_time / config.period)):
        value = averaged(value, np.ones(3), config)
    np.testing.assert_allclose(value, 1.0, atol=0.01)


def test_a_wrist_movement_misses_by_a_share_of_its_length():
    """Signal-dependent noise: the end scatters around the wanted place by `motor_noise` of the distance."""
    config = OperatorConfig()
    world = StandInWorld(1.0, config)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(0))
    for length in (0.05, 0.2):
        shift = np.array([0.0, length, 0.0])
        ends = np.array(
            [
                person._plan_movement(RigidTransform(), shift, RotationMatrix(), 0.0).X_end.translation()
                for _ in range(1000)
            ]
        )
        np.testing.assert_allclose(ends.mean(axis=0), shift, atol=0.01 * length)
        missed = np.sqrt(((ends - shift) ** 2).sum(axis=1).mean())
        assert missed == pytest.approx(config.motor_noise * length, rel=0.1)


def test_a_closing_finger_stops_at_the_object_and_does_not_run_ahead():
    """Touching fingers rest, one that leads the slowest by twice the lead waits, the slowest goes on."""
    config = OperatorConfig()
    world = StandInWorld(1.0, config)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(0))
    scene = world.advance(FingerMotion(world.hand).rest, RigidTransform(), lifting=False)
    remaining = np.array([0.02, 0.02 - 2.1 * config.closing_lead, 0.02 - 0.5 * config.closing_lead, 0.0])
    error = remaining[:, None] * [1.0, 0.0, 0.0]
    free = person._closing_share(error, dc.replace(scene, contact=np.zeros(4)))
    np.testing.assert_allclose(free[:3], [1, 0, 1], atol=1e-9)
    touching = person._closing_share(error, dc.replace(scene, contact=np.array([1.0, 0, 0, 0])))
    # With the slowest arrived, the next slowest sets the pace.
    np.testing.assert_allclose(touching[:3], [0, 0.4, 1], atol=1e-9)


def test_the_hand_shifts_to_the_middle_of_what_the_fingers_lack():
    """Halfway between the extremes of the errors to the surface; a finger that touches lacks nothing."""
    config = OperatorConfig()
    world = StandInWorld(1.0, config)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(0))
    scene = world.advance(FingerMotion(world.hand).rest, RigidTransform(), lifting=False)
    X_WB = RigidTransform(world.X_WO @ world.goal.X_OB)
    rest = (world.X_WO @ world.goal.X_OB).multiply(world.goal.p_BF_open.T).T
    state = dc.replace(person.start(RigidTransform()), phase=Phase.CLOSE)
    # At the goal's hand pose every fingertip is 40 mm off the surface along its own way inwards.
    lacking = 0.04 * world.goal.n_OF[:3]
    for contact in ([0.0, 0, 0, 0], [1.0, 0, 0, 0]):
        seen = dc.replace(scene, p_WF=rest, X_WB=X_WB, contact=np.array(contact))
        left = np.where(np.array(contact)[:3, None] > 0, 0.0, lacking)
        wanted = 0.5 * (left.min(axis=0) + left.max(axis=0))
        state.shape_error = person._fingertip_errors(state, seen)
        shift = person._hand_shift(state, seen)
        assert shift is not None
        np.testing.assert_allclose(shift, wanted, atol=1e-9)


@pytest.mark.parametrize("phase", [Phase.SURROUND, Phase.CLOSE])
def test_a_finger_that_touches_has_arrived(phase):
    """While the hand gathers around an object as when it closes: its finger moves the hand no further."""
    config = OperatorConfig()
    world = StandInWorld(1.0, config)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(0))
    scene = world.advance(FingerMotion(world.hand).rest, RigidTransform(), lifting=False)
    X_WB = RigidTransform(world.X_WO @ world.goal.X_OB)
    rest = X_WB.multiply(world.goal.p_BF_open.T).T
    state = dc.replace(person.start(RigidTransform()), phase=phase)

    def shift(*touching: int) -> np.ndarray | None:
        contact = np.isin(np.arange(4), touching) * 1.0
        seen = dc.replace(scene, p_WF=rest, X_WB=X_WB, contact=contact)
        state.shape_error = person._fingertip_errors(state, seen)
        return person._hand_shift(state, seen)

    some, all_others = shift(), shift(0, 1)
    assert some is not None and all_others is not None
    assert np.linalg.norm(some - all_others) > 1e-3  # the third finger alone pulls, and by half of its way
    assert shift(0, 1, 2) is None
    # A finger that has no part in the grasp goes on opening.
    seen = dc.replace(scene, p_WF=rest + 0.01, X_WB=X_WB, contact=np.array([0.0, 0, 0, 1]))
    assert np.linalg.norm(person._fingertip_errors(state, seen)[3]) > 0.01


def test_the_person_does_not_repeat_what_is_done_but_not_yet_seen():
    """Own motion of the last delay counts as done: an error that it will mend moves no finger further."""
    config = OperatorConfig(**QUIET)
    world = StandInWorld(1.0, config)
    motion = FingerMotion(world.hand)
    rest = world.hand.fingertips(motion.rest)
    moved = motion.follow(motion.rest, rest + [0.004, 0.0, -0.004])
    done = world.hand.fingertips(moved) - rest
    assert np.linalg.norm(done, axis=1).min() > 1e-3
    seen = world.advance(motion.rest, RigidTransform(), lifting=False)

    def step_towards(p_BF_wanted: np.ndarray) -> np.ndarray:
        goal = dc.replace(world.goal, p_BF_open=p_BF_wanted)
        person = GraspingPerson(world.hand, goal, config, np.random.default_rng(0))
        state = dc.replace(person.start(RigidTransform()), theta=moved)
        return (world.hand.fingertips(person.step(state, 0.0, seen).theta) - rest - done)[:4]

    # The robot is seen at rest still; wanted is where the own motion will have taken it.
    np.testing.assert_allclose(step_towards(rest[:4] + done[:4]), 0, atol=1e-9)
    # Wanted where it was, it is led back.
    assert ((step_towards(rest[:4]) * done[:4]).sum(axis=1) < 0).all()


def test_the_persons_joints_and_speeds_stay_human():
    """At every decision the joints are inside the hand's limits, and no fingertip outruns a person's."""
    config = OperatorConfig()
    hand = HumanHand.anatomical()
    for gain in (0.5, 3.0):
        session = act(gain)
        assert (session.theta >= hand.lower - 1e-9).all() and (session.theta <= hand.upper + 1e-9).all()
        tips = hand.fingertips(session.theta)
        speed = np.linalg.norm(np.diff(tips, axis=0), axis=-1) / config.period
        # Motor noise adds to the wanted speed.
        assert speed.max() < config.max_fingertip_speed * (1 + 6 * config.motor_noise)
        wrist_speed = np.linalg.norm(np.diff(session.wrist, axis=0), axis=-1) / config.period
        assert wrist_speed.max() < config.peak_wrist_speed * (1 + 6 * config.motor_noise)


def test_one_seed_gives_one_session_and_another_gives_another():
    """All noise comes from the generator."""
    first, again, other = act(1.2, seed=5), act(1.2, seed=5), act(1.2, seed=6)
    np.testing.assert_array_equal(first.theta, again.theta)
    np.testing.assert_array_equal(first.wrist, again.wrist)
    count = min(len(first.theta), len(other.theta))
    assert np.abs(first.theta[:count] - other.theta[:count]).max() > 1e-3


def test_a_decision_leaves_the_earlier_state_alone():
    """A state can be kept and gone back to, as a simulation context is."""
    config = OperatorConfig()
    world = StandInWorld(1.0, config)
    person = GraspingPerson(world.hand, world.goal, config, np.random.default_rng(0))
    state = person.start(RigidTransform())
    for step in range(300):
        kept = (state.theta.copy(), state.phase, state.X_WH.GetAsMatrix4().copy(), state.attempt)
        after = person.step(
            state, step * config.period, world.advance(state.theta, state.X_WH, lifting=False)
        )
        np.testing.assert_array_equal(state.theta, kept[0])
        np.testing.assert_array_equal(state.X_WH.GetAsMatrix4(), kept[2])
        assert (state.phase, state.attempt) == (kept[1], kept[3])
        state = after


def test_the_person_without_noise_draws_nothing_from_chance():
    """With all noise off, two seeds give the same session: there is no other use of chance."""
    np.testing.assert_array_equal(act(1.2, seed=1, **QUIET).theta, act(1.2, seed=2, **QUIET).theta)


def test_the_person_cannot_know_the_map():
    """The person's module imports nothing that maps hands, and is given only what can be seen."""
    trees = [ast.walk(ast.parse(inspect.getsource(module))) for module in (behavior, perception)]
    nodes = [node for tree in trees for node in tree]
    imported = {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    imported |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    forbidden = ("retargeting", "affine_map", "geort_drake.hands", "geort_drake.evaluation")
    assert not [name for name in imported for part in forbidden if part in name]
    assert list(inspect.signature(GraspingPerson).parameters) == ["hand", "goal", "config", "rng"]
    assert {field.name for field in dc.fields(Seen)} == {"p_WF", "X_WB", "X_WO", "contact"}
