"""The baselines: kinematics, the optimiser, projection, state, and what each must get right."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics

from geort_drake.errors import GeortError, HandError, UnknownNameError
from geort_drake.hands.kinematics import HandKinematics
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.affine_ik import AffineIK
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.retargeting.online import AnyTeleop, DexPilot
from geort_drake.retargeting.telekinesis import SCALE, TelekinesisConfig
from geort_drake.retargeting.train import training_config

P_BW = np.array([0.0, 0.0, -0.095])  # of the Allegro: the palm's foot, as dex-retargeting has it


@pytest.fixture(scope="module")
def kinematics(allegro) -> HandKinematics:
    return allegro.kinematics()


def interior(kinematics, count: int, seed: int = 0) -> np.ndarray:
    """Joint angles (count, n) at least a tenth of the range away from the limits."""
    width = kinematics.upper - kinematics.lower
    rng = np.random.default_rng(seed)
    return rng.uniform(kinematics.lower + 0.1 * width, kinematics.upper - 0.1 * width, (count, len(width)))


def reachable(kinematics, q: np.ndarray, scale: float = 1.6) -> np.ndarray:
    """Human fingertips whose scaled vectors from the wrist are those of the robot at q."""
    return (NumpyKinematics(kinematics).fingertips(q) - P_BW) / scale


def walk(kinematics, frames: int = 60, seed: int = 0) -> np.ndarray:
    """Smooth human fingertips (frames, F, 3) that are mostly within the robot's reach."""
    ends = interior(kinematics, 2, seed)
    s = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, frames))[:, None]
    return reachable(kinematics, ends[0] + s * (ends[1] - ends[0]))


def test_a_reachable_hand_is_reproduced(kinematics):
    """Held still, human tips that are the robot's over α put the robot's tips there."""
    q = interior(kinematics, 20, 10)
    p_HF = reachable(kinematics, q)
    online = AnyTeleop(kinematics)
    rest = online.settled_map(p_HF)(p_HF)
    hand = online.kinematics
    error = np.linalg.norm(hand.fingertips(rest) - hand.fingertips(q), axis=-1)
    assert error.max() < 1e-3
    # The same through the sequential call, whose regulariser lets go as the pose is held.
    for _ in range(60):
        answer = online(p_HF[0])
    assert np.linalg.norm(hand.fingertips(answer[None]) - hand.fingertips(q[:1]), axis=-1).max() < 1e-3


def test_a_projected_pinch_brings_the_tips_together(kinematics):
    """With the thumb 25 mm from the index DexPilot closes the pinch, and vectors alone leave it open.

    Projection is on under 30 mm, off over 50 mm, and in between as it was.
    """
    p_HF = reachable(kinematics, np.full((1, 16), 0.4))
    p_HF[0, 0] = p_HF[0, 1] + [0.0, 0.0, -0.025]
    tips = {}
    for method in (AnyTeleop, DexPilot):
        online = method(kinematics)
        tips[method] = online.kinematics.fingertips(online.settled_map(p_HF)(p_HF))[0]
    distance = {method: np.linalg.norm(p[0] - p[1]) for method, p in tips.items()}
    assert distance[DexPilot] < 0.012
    assert distance[AnyTeleop] > 0.030
    online, states = DexPilot(kinematics), []
    for millimetres in (60, 40, 29, 40, 49, 51, 40, 31, 29):
        # The other fingers are over 6 cm away.
        p = np.array([[0.05, -0.07 * finger, 0.10] for finger in range(4)])
        p[1] = p[0] + [0.0, 0.0, 0.001 * millimetres]
        online(p)
        states.append(bool(online._projected[0]))
    assert states == [False, False, True, True, True, False, False, False, True]


@pytest.mark.parametrize("name", ["affine_ik", "anyteleop", "dexpilot", "hold"])
def test_limits_are_respected_and_every_input_shape_is_accepted(kinematics, name):
    """Wild hands stay inside the limits; fingertips and whole hands, one or many, are taken."""
    rng = np.random.default_rng(12)
    frames = rng.uniform(-0.3, 0.3, (12, 4, 3))
    retarget = METHODS[name].fit(kinematics, frames)
    q = retarget(frames)
    assert q.shape == (12, 16)
    assert (q >= kinematics.lower).all() and (q <= kinematics.upper).all()
    hands = HumanHand.measured_adult().in_wrist_frame().keypoints(np.zeros((3, 20)))
    assert retarget(hands).shape == (3, 16) and retarget(hands[0]).shape == (16,)
    assert retarget.joint_names == kinematics.joint_names
    assert retarget.finger_names == kinematics.finger_names
    with pytest.raises(ValueError, match="human points"):
        retarget(np.zeros((5, 3)))
    with pytest.raises(GeortError, match="finite"):
        retarget(np.full((4, 3), np.nan))


@pytest.mark.parametrize("method", [AnyTeleop, DexPilot])
def test_a_batch_is_a_sequence_and_reset_forgets_it(kinematics, method):
    """Frame by frame and as a batch give the same; after reset the first answer is given again."""
    frames = walk(kinematics, 15)
    online = method(kinematics)
    together = online(frames)
    online.reset()
    np.testing.assert_array_equal(together, [online(frame) for frame in frames])
    continued = online(frames[0])
    assert np.abs(continued - together[0]).max() > 1e-3
    online.reset()
    np.testing.assert_array_equal(online(frames[0]), together[0])


def test_settled_outputs_do_not_depend_on_earlier_calls(kinematics):
    """The same hand gets the same answer, in any order and company, and a held one stays."""
    frames = walk(kinematics, 20)
    online = DexPilot(kinematics)
    settled = online.settled_map(frames)
    first = settled(frames)
    np.testing.assert_allclose(settled(frames[::-1])[::-1], first, atol=1e-9)
    np.testing.assert_allclose(settled(frames[7:8])[0], first[7], atol=1e-9)
    online.reset()
    answers = online(np.concatenate([frames, np.repeat(frames[-1:], 80, axis=0)]))
    hand = online.kinematics
    assert np.abs(hand.fingertips(answers[-1:]) - hand.fingertips(first[-1:])).max() < 1e-3


def test_the_affine_map_maps_one_workspace_to_the_other(kinematics):
    """Means and spreads match; what the robot can reach it reaches, whatever it was asked before."""
    frames = walk(kinematics)
    affine = AffineIK(kinematics, frames)
    np.testing.assert_allclose(affine.targets(frames).mean(axis=0), affine.targets(frames.mean(axis=0)))
    robot = affine.targets(frames) - affine.targets(frames).mean(axis=0)
    q = np.random.default_rng(0).uniform(kinematics.lower, kinematics.upper, (4000, 16))
    tips = NumpyKinematics(kinematics).fingertips(q)
    np.testing.assert_allclose(
        np.sqrt((robot**2).sum(-1).mean(axis=0)), np.sqrt(tips.var(axis=0).sum(-1)), rtol=1e-6
    )
    wanted = NumpyKinematics(kinematics).fingertips(interior(kinematics, 20))
    answer = affine((wanted - affine.targets(np.zeros((4, 3)))) / affine.gain)
    error = np.linalg.norm(NumpyKinematics(kinematics).fingertips(answer) - wanted, axis=-1)
    assert np.median(error) < 1e-4
    np.testing.assert_allclose(affine(frames[7]), affine(frames)[7], atol=1e-12)
    with pytest.raises(GeortError, match="the thumb moves less than 1 mm"):
        AffineIK(kinematics, np.full((5, 4, 3), 0.1))


@pytest.mark.slow
@pytest.mark.training
def test_telekinesis_learns_the_scaled_hand(training_seed, reaches):
    """A person whose scaled hand the robot can have is reproduced within a few millimetres."""
    hand = replace(toy_kinematics(), p_BW=P_BW)
    robot = toy_human(hand, 1500, seed=4) / 0.8 - np.array([0.0, 0.0, 0.05]) / 0.8  # the robot's own tips
    p_HF = (robot - P_BW) / SCALE
    rows, config = [], TelekinesisConfig(steps=600, points=128, hidden=48)
    retarget = METHODS["telekinesis"].fit(
        hand, p_HF, seed=training_seed, config=config, report=lambda *row: rows.append(row)
    )
    tips = fingertips(hand, torch.tensor(retarget(p_HF))).numpy()
    reaches("error, m", float(np.linalg.norm(tips - robot, axis=-1).mean()), 0.006)
    history = retarget.info["history"]
    reaches("matching", history[-1]["matching"] / history[0]["matching"], 0.04)
    assert len(rows) == len(history)


def test_unknown_names_and_senseless_settings_are_refused(kinematics):
    with pytest.raises(UnknownNameError, match="anyteleop, dexpilot, geort"):
        training_config("mimic")
    with pytest.raises(GeortError, match="recorded frames"):
        METHODS["affine_ik"].fit(kinematics)
    with pytest.raises(HandError, match="needs a thumb"):
        DexPilot(toy_kinematics(("index", "middle")))
    with pytest.raises(UnknownNameError, match="finger 'pollex'"):
        AnyTeleop(toy_kinematics(("pollex",)))
