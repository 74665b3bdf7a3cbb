"""The simulated person by itself: what is decided on what is seen."""

import dataclasses as dc
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from grasp_setup import reach_goal
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from geort_drake import synthesize_play
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.simulation.operators.behavior import GraspingPerson
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.finger_motion import FingerMotion
from geort_drake.simulation.operators.intention import IntentionConfig
from geort_drake.simulation.operators.perception import FreePlay, Seen
from geort_drake.simulation.operators.placing import PlacingPerson
from geort_drake.simulation.operators.state import Phase

QUIET = dict.fromkeys(
    ("visual_noise", "visual_depth_noise", "visual_turn_noise", "contact_noise", "motor_noise"), 0.0
)
# Fingers bend their last joint by two thirds of the one before; the thumb bends both alike.
COUPLING = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 2 / 3])


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
        X_OB = RigidTransform(-centre)
        usual = reach_goal()  # of thumb, index and middle fingers
        n_OF = np.where(usual.touches[:, None], inwards, 0.0)
        self.goal = dc.replace(
            usual,
            X_OB=X_OB,
            X_OB_before=X_OB @ RigidTransform([-0.08, 0, 0]),
            p_BF_open=rest - 0.02 * n_OF,
            p_OF_touch=rest + 0.02 * inwards - centre,
            n_OF=n_OF,
        )
        self.X_WO = RigidTransform([0.5, 0.02, 0.15])
        self.X_WB_start = RigidTransform([0.3, 0.1, 0.2])
        self.X_WB = self.X_WB_start
        self._p_BO_held: np.ndarray | None = None
        self._past: deque[Seen] = deque(maxlen=round(config.visual_delay / config.period))

    def robot_tips(self, p_HF: np.ndarray) -> np.ndarray:
        """(..., 4, 3) in B for own fingertips, m."""
        return self._rest + self._gain * (p_HF - self._rest)

    def advance(self, theta: np.ndarray, X_WH: RigidTransform, lifting: bool) -> Seen:
        """What the person sees after the robot has followed hand and wrist."""
        self.X_WB = RigidTransform(X_WH.rotation(), self.X_WB_start.translation() + X_WH.translation())
        p_BF = self.robot_tips(self.hand.fingertips(theta)[:4])
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
        self._past.append(Seen(p_WF, self.X_WB, self.X_WO, contact, RigidTransform([0.5, 0.2, 0.15])))
        return self._past[0]


def act(
    gain: float, seed: int = 3, slips: int = 0, kind: str | None = None, look: float = 0.25, **changes: float
) -> SimpleNamespace:
    """Lets a person grasp to one second into the hold, or a kind of one grasp and lift, in that world."""
    config = dc.replace(OperatorConfig(), **changes)
    world = StandInWorld(gain, config, slips)
    rng = np.random.default_rng(seed)
    person = GraspingPerson(world.hand, world.goal, config, rng)
    if kind is not None:
        own = synthesize_play(0, duration_s=30, rate_hz=30, hand=world.hand).fingertips([4, 8, 12, 16])
        goal = dc.replace(world.goal, play=FreePlay(own, world.robot_tips(own)))
        intention = IntentionConfig(attention_time=look)
        person = PlacingPerson(world.hand, goal, config, rng, kind, intention, hover=0.02, upright=False)
    state = person.start(RigidTransform())
    p_WO = world.X_WO.translation()
    phases, theta, tips, wrist, squeeze = [state.phase], [state.theta], [], [], []
    for step in range(round(30.0 / config.period)):
        seen = world.advance(state.theta, state.X_WH, state.phase in (Phase.LIFT, Phase.HOLD))
        before = state
        state = person.step(state, step * config.period, seen)
        theta.append(state.theta)
        wrist.append(state.X_WH.translation())
        if state.phase != before.phase:
            phases.append(state.phase)
            tips.append(world.robot_tips(world.hand.fingertips(state.theta)[:4]))
        if state.phase == Phase.SQUEEZE:
            moved = world.hand.fingertips(state.theta) - state.p_HF_start
            squeeze.append((moved[:3] * world.goal.n_OF[:3]).sum(axis=1))
        is_held = state.phase == Phase.HOLD and step * config.period > state.phase_start + 1.0
        if is_held or state.phase == Phase.CARRY:
            break
    return SimpleNamespace(
        phases=phases,
        theta=np.array(theta),
        opened=np.linalg.norm(tips[0] - world.goal.p_BF_open, axis=1),
        wrist=np.array(wrist),
        attempts=state.attempt,
        raised=float(world.X_WO.translation()[2] - p_WO[2]),
        squeeze=float(np.mean(squeeze[-1])) if squeeze else 0.0,
    )


@pytest.mark.parametrize("gain", [1.5, 2.0])
def test_kinds_of_people_pinch_as_they_move_a_robot_finger(gain):
    """All at first try; a mimic squeezes as deep as intended, the others by the gain that they learned."""
    for kind, expected in (("servo", 1 / gain), ("mimicry", 1.0), ("adaptive", 1 / gain)):
        session = act(gain, kind=kind)
        assert session.phases == [*STRAIGHT[:-1], Phase.CARRY], kind
        assert session.squeeze == pytest.approx(expected * OperatorConfig().squeeze, rel=0.2), kind


def test_a_finger_is_corrected_while_it_is_looked_at():
    """The middle finger in turn with the index finger; here all robot fingers first move too far."""
    in_turn, never = (act(1.5, kind="mimicry", look=time).opened for time in (0.25, 1e9))
    assert in_turn[2] < 0.75 * never[2] and never[1] < in_turn[1]


@pytest.mark.parametrize("upright", [True, False])
def test_a_person_turns_a_tilted_object_upright_or_leaves_that_to_gravity(upright, rng):
    """On the way to its place."""
    config = dc.replace(OperatorConfig(), **QUIET)
    world = StandInWorld(1.0, config)
    known = world.hand, dc.replace(world.goal, yaw_symmetry=0.0), config, rng, "servo", IntentionConfig()
    person = PlacingPerson(*known, hover=0.02, upright=upright)
    X_WB, X_WO = world.X_WB, RigidTransform(RollPitchYaw(0.2, -0.1, 0.5), [0.5, 0, 0.3])
    X_BO = X_WB.inverse() @ X_WO
    held = {"p_BO": X_BO.translation(), "p_BO_start": X_BO.translation()}
    state = dc.replace(person.start(RigidTransform()), phase=Phase.CARRY, **held)
    seen = Seen(np.zeros((4, 3)), X_WB, X_WO, np.ones(4), RigidTransform([0.5, 0.2, 0.15]))
    end = person.step(state, 1.0, seen).movement.X_end  # of the wrist, from the identity
    X_WB = RigidTransform(end.rotation() @ X_WB.rotation(), X_WB.translation() + end.translation())
    np.testing.assert_allclose((X_WB @ X_BO).translation(), [0.5, 0.2, 0.17], atol=1e-9)
    up = (X_WB @ X_BO).rotation().matrix()[2, 2]
    assert up == pytest.approx(1.0 if upright else X_WO.rotation().matrix()[2, 2])


STRAIGHT = [Phase.REACH, Phase.APPROACH, Phase.SURROUND, Phase.CLOSE, Phase.SQUEEZE, Phase.LIFT, Phase.HOLD]


@pytest.mark.parametrize("gain", [0.5, 0.7, 1.5, 2.5, 3.0])
def test_the_person_grasps_through_maps_of_different_gain(gain):
    """Reach, approach, surround, close, squeeze, lift, hold: without knowing the gain, at first try.

    Joints keep the hand's limits and bend together, and no fingertip outruns a person's.
    """
    session, config, hand = act(gain), OperatorConfig(), HumanHand.anatomical()
    assert session.phases == STRAIGHT
    assert session.attempts == 1
    assert session.raised == pytest.approx(config.lift_height, abs=0.03)
    # The squeeze asks the robot's fingertips for what the configuration says, by the gain that was sensed:
    # within half of it, as part of every motion is still under way when it is looked at, and errors of sight
    # look like motion.
    assert session.squeeze * gain == pytest.approx(config.squeeze, rel=0.5)
    assert (session.theta >= hand.lower - 1e-9).all() and (session.theta <= hand.upper + 1e-9).all()
    bends = session.theta.reshape(-1, 5, 4)
    np.testing.assert_allclose(bends[..., 3], COUPLING * bends[..., 2], atol=1e-12)
    speed = np.linalg.norm(np.diff(hand.fingertips(session.theta), axis=0), axis=-1) / config.period
    # Motor noise adds to the wanted speed.
    assert speed.max() < config.max_fingertip_speed * (1 + 6 * config.motor_noise)
    wrist_speed = np.linalg.norm(np.diff(session.wrist, axis=0), axis=-1) / config.period
    assert wrist_speed.max() < config.peak_wrist_speed * (1 + 6 * config.motor_noise)


def test_the_person_tries_again_when_the_object_stays_behind():
    """An object lost in the lift is noticed; the hand opens, goes back and the second attempt holds."""
    session = act(1.5, slips=1)
    lost = session.phases.index(Phase.RELEASE)
    assert session.phases[:lost] in (STRAIGHT, STRAIGHT[:-1])
    assert session.phases[lost + 1 :] == STRAIGHT[1:]
    assert session.attempts == 2
    assert session.raised > 0.1


def test_the_grasp_also_holds_without_touch_and_in_a_noisier_scene():
    """Without touch, fingers close until they come no further. The noise is four times as large."""
    session = act(1.5, touch=False)
    assert session.phases == STRAIGHT and session.raised > 0.1
    noisy = {name: 4 * getattr(OperatorConfig(), name) for name in QUIET}
    session = act(1.5, **noisy)
    assert session.phases == STRAIGHT and session.attempts == 1
    assert session.squeeze * 1.5 == pytest.approx(OperatorConfig().squeeze, rel=0.4)


def test_one_seed_gives_one_session_and_another_gives_another():
    """All noise comes from the generator, and all chance is noise."""
    first, again, other = act(1.2, seed=5), act(1.2, seed=5), act(1.2, seed=6)
    np.testing.assert_array_equal(act(1.2, seed=5, **QUIET).theta, act(1.2, seed=6, **QUIET).theta)
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
