"""Training geort_coupled on a hand whose right answer is known, and a universal map."""

import dataclasses
import warnings

import numpy as np
import pytest
import torch
from retargeting_toy import HAND, HUMAN, PLANTED, answers, toy_data, toy_kinematics, uneven_kinematics
from scipy.spatial.transform import Rotation

from geort_drake import HandModel, Retargeter
from geort_drake.errors import TrainingError
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.people.keypoints import TIP_KEYPOINT
from geort_drake.people.population import sample_population
from geort_drake.retargeting.methods.coupled import CoupledConfig, CoupledRetargeter, Start, train_coupled
from geort_drake.retargeting.methods.coupled.losses import RobotTips, constraint_terms
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.people import TrainingPeople
from geort_drake.retargeting.methods.coupled.population import code_people, likely_plays
from geort_drake.retargeting.methods.coupled.training import train_universal
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes
from geort_drake.retargeting.training.human_data import pinch_pairs
from geort_drake.retargeting.training.kinematics import HandKinematics
from geort_drake.retargeting.training.networks import RetargetingNetwork

KEYPOINTS = [4, 8, 12]
QUICK = CoupledConfig(steps=120)


def quick(seed=0, shapes=None, **settings):
    data = toy_data(HAND, HUMAN, shapes=shapes and (lambda: shapes))
    return train_coupled(data, dataclasses.replace(QUICK, **settings), seed)


def mean_of_last(history: list[dict[str, float]]) -> dict[str, float]:
    """The losses at the end, averaged over ten rows of the history."""
    return {name: float(np.mean([row[name] for row in history[-10:]])) for name in history[-1]}


def network_of(hand, kind=CoupledNetwork, hidden=(), seed=0) -> torch.nn.Module:
    """A network with random weights everywhere, the residual's last layer included."""
    generator = torch.Generator().manual_seed(seed)
    mean = 0.05 * torch.rand(len(hand.fingers), 3, generator=generator)
    scale = 0.02 + 0.03 * torch.rand(len(hand.fingers), 3, generator=generator)
    network = kind(hand, mean, scale, *hidden, generator)
    with torch.no_grad():
        for parameter in (network.residual.weights[-1], network.residual.biases[-1]) if not hidden else ():
            parameter.uniform_(-0.3, 0.3, generator=generator)
    return network


@pytest.mark.parametrize("hand", [toy_kinematics(), uneven_kinematics()], ids=["even", "uneven"])
def test_numpy_equals_torch(hand, rng):
    """For any order and number of joints, each finger by itself or all together, with a full Jacobian."""
    tips, names = rng.normal(0.03, 0.05, (300, 3, 3)), (hand.finger_names, hand.joint_names)
    for kind, network in (
        (Retargeter, network_of(hand, RetargetingNetwork, (128,))),
        (CoupledRetargeter, network_of(hand)),
    ):
        retarget = kind(network.arrays(), *names, KEYPOINTS, hand.lower, hand.upper)
        expected = network.double()(torch.tensor(tips)).detach().numpy()
        np.testing.assert_allclose(retarget(tips), expected, atol=1e-6)
        np.testing.assert_allclose([retarget(tip) for tip in tips], retarget(tips), atol=1e-12)
    assert (np.abs(retarget.jacobian(tips[0])) > 1e-9).all()


@pytest.mark.training
def test_training_finds_the_planted_map(training_seed, reaches):
    """A short run follows the person's steps, closes pinches and covers the robot's space."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the loss need not fall where its multipliers rise
        result = quick(training_seed)
    first, last = result.history[0], mean_of_last(result.history)
    reaches("direction", last["direction"], 0.15)
    reaches("track", last["track"], 0.15)
    reaches("coverage", last["coverage"] / first["coverage"], 0.7)
    reaches("open pinches", last["open_pinch"] / first["open_pinch"], 0.5)
    reaches("error, m", np.median(np.linalg.norm(answers(result.network) - PLANTED, axis=-1)), 0.03)


@pytest.mark.training
def test_a_pinch_out_of_the_robots_reach_does_not_spoil_the_map(training_seed, reaches):
    """The index finger is half a metre away; the other pinches close, and steps are followed."""
    thumb, index, middle = HAND.fingers
    X_PJ = index.X_PJ.copy()
    X_PJ[0, 1, 3] = 0.5
    hand = dataclasses.replace(HAND, fingers=(thumb, dataclasses.replace(index, X_PJ=X_PJ), middle))
    config = dataclasses.replace(QUICK, steps=150)
    history = train_coupled(toy_data(hand, HUMAN), config, training_seed).history
    last = mean_of_last(history)
    reaches("direction", last["direction"], 0.4)
    reaches("track", last["track"], 0.4)
    reaches("open pinches", last["open_pinch"], 0.5)
    reaches("coverage", last["coverage"] / history[0]["coverage"], 0.5)


@pytest.mark.training
def test_fingers_with_one_motor_follow_the_person(training_seed, reaches):
    """On its curve, a fingertip follows motions in all directions by a mean cosine of 0.5 at most."""
    fingers = [
        dataclasses.replace(
            chain, joint_names=chain.joint_names[1:2], joint_indices=(i,), coupling=np.array([[0], [1], [1]])
        )
        for i, chain in enumerate(HAND.fingers)
    ]
    names = [chain.joint_names[0] for chain in fingers]
    hand = HandKinematics(tuple(fingers), tuple(names), np.full(3, -0.2), np.full(3, 1.2), HAND.tip_radius)
    last = mean_of_last(train_coupled(toy_data(hand, HUMAN), QUICK, training_seed).history)
    reaches("direction above the least", last["direction"] - 0.5, 0.1)
    reaches("track", last["track"], 0.8)
    reaches("uneven", last["uneven"], 0.1)


def universal(seed: int) -> dict[str, np.ndarray]:
    """A small map of the Allegro hand for several people."""
    hand, config = HandModel("allegro_right"), CoupledConfig(steps=4)
    return train_universal(hand.kinematics(), collision_shapes(hand), config, 4, seed).arrays


@pytest.mark.parametrize("trained", [lambda seed: quick(seed, steps=10).network.arrays(), universal])
def test_the_seed_alone_decides_the_weights(trained):
    """To the last bit, for one person and for all: global generators change nothing, other seeds do."""
    runs = []
    for seed, elsewhere in ((3, 0), (3, 1), (4, 0)):
        torch.manual_seed(elsewhere)
        np.random.seed(elsewhere)  # noqa: NPY002
        runs.append(trained(seed))
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    assert np.abs(runs[0]["weight0"] - runs[2]["weight0"]).max() > 1e-3


def test_a_training_starts_from_given_weights():
    """A first step hardly changes them; those of another hand are refused."""
    network = network_of(HAND)
    start = Start(network.arrays(), HUMAN[None, :100])
    still = train_coupled(toy_data(HAND, HUMAN), CoupledConfig(steps=1), start=start)
    p = torch.tensor(HUMAN[:20]).float()
    with torch.no_grad():
        change = (still.network(p) - network(p)).abs()
    assert 0 < change.mean() < 0.1
    with pytest.raises(TrainingError, match=r"columns must be of shape \(6,\), it is \(9,\)"):
        train_coupled(toy_data(toy_kinematics(("thumb", "index"))), CoupledConfig(steps=1), start=start)


def test_a_training_uses_the_likely_plays_of_its_start():
    """Other plays give other weights, and draws follow the weights of the people."""
    arrays = network_of(HAND).arrays()
    weights = [
        train_coupled(
            toy_data(HAND, HUMAN), CoupledConfig(steps=2), start=Start(arrays, play)
        ).network.arrays()
        for play in (HUMAN[None], HUMAN[None] + 0.01)
    ]
    assert np.abs(weights[0]["weight0"] - weights[1]["weight0"]).max() > 1e-4
    codes, reach, cpu = torch.zeros(2, 1, 0), torch.ones(2, 3), torch.device("cpu")
    p_HF, generator = np.tile(HUMAN[:300].astype(np.float32), (2, 1, 1, 1)), torch.Generator().manual_seed(0)
    rng, pairs = np.random.default_rng(0), [(0, 1), (0, 2)]
    people = TrainingPeople(p_HF, pairs, generator, rng, codes, reach, 0.01, [3, 1], cpu)
    assert float((people.draw_people(4000) == 0).float().mean()) == pytest.approx(0.75, abs=0.03)


AT_TIPS = np.tile(np.eye(4), (2, 1, 1))
AT_TIPS[:, 2, 3] = 0.04
RADII = np.array([0.012, 0.011])
SPHERES = CollisionShapes(np.array([5, 8]), AT_TIPS, np.zeros((2, 3)), RADII, np.array([[0, 1]]))


@pytest.mark.training
def test_training_avoids_collisions_of_the_given_shapes(training_seed, reaches):
    """Spheres on the index and middle fingertips keep apart; without shapes they do not."""

    def depth(shapes) -> float:
        """The mean depth of the spheres in each other, m, which a hand or two does not decide."""
        tips = answers(quick(training_seed, shapes, steps=120).network)
        return float(np.maximum(0.022 - np.linalg.norm(tips[:, 1] - tips[:, 2], axis=-1), 0.0).mean())

    reaches("depth", depth(SPHERES) / depth(None), 0.5)


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_gaps_agree_with_drake(name):
    """The sign of the least gap is Drake's answer, except where a cylinder's rim decides."""
    hand = HandModel(name)
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (1500, 16))
    shapes = collision_shapes(hand)
    gaps = CollisionGaps(hand.kinematics(), shapes)
    before = len(gaps.pairs)
    least = gaps.least(torch.tensor(q).float(), 0.002).numpy()
    label = hand.collides_beyond_tips(q)
    assert ((least < 0) == label).mean() > 0.99
    gaps.keep_pairs_that_meet(torch.tensor(q).float(), 0.001)
    assert len(gaps.pairs) < before
    after = gaps.least(torch.tensor(q).float(), 0.002).numpy()
    np.testing.assert_array_equal(after < 0, least < 0)


FINGERS = ("thumb", "index", "middle", "ring")


def test_a_perfect_map_violates_nothing():
    """The robot's fingertips move as the person's, over a distance where touching tips overlap by the aim."""
    p_HK = sample_population(4, seed=0, duration_s=20.0)
    rng, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    coded = code_people(p_HK, FINGERS, rng)
    p_HF = p_HK[:, :, [TIP_KEYPOINT[name] for name in FINGERS]]
    pairs, cpu = pinch_pairs(FINGERS), torch.device("cpu")
    people = TrainingPeople(p_HF, pairs, generator, rng, coded.codes, coded.reach, 0.005, [1] * 4, cpu)
    hands = people.draw(4)
    d = torch.nn.functional.one_hot(hands.finger, 4)[..., None] * hands.d[:, :, None]
    tips = RobotTips(hands.moved, hands.moved + d, hands.moved - d, hands.before, hands.after, hands.pinching)
    allegro = HandModel("allegro_right").kinematics()

    def figures_of(tips: RobotTips, hand: HandKinematics) -> dict[str, float]:
        return {
            name: float(figure) for name, (_, figure) in constraint_terms(hands, tips, people, hand).items()
        }

    figures = figures_of(tips, allegro)
    for name in ("direction", "track", "cross_talk", "curvature", "uneven", "open_pinch", "false_pinch"):
        assert figures[name] < 1e-3, name
    still = figures_of(RobotTips(*(torch.zeros_like(part) for part in vars(tips).values())), allegro)
    assert still["direction"] == pytest.approx(1.0)
    assert still["deep_pinch"] == 1.0 and still["false_pinch"] == 1.0


def test_likely_plays_are_those_of_the_persons_hand():
    """For a person of the population itself, seen in another frame and scale, they are that person's play."""
    (play,) = sample_population(1, seed=5, duration_s=10.0).astype(float)
    R = Rotation.from_euler("xyz", [10, -20, 15], degrees=True).as_matrix()
    seen = 1.2 * play @ R.T + [0.01, 0.0, -0.02]
    (likely,) = likely_plays(seen, FINGERS, seed=5, people=1, duration_s=10.0)
    np.testing.assert_allclose(likely, seen[:, [TIP_KEYPOINT[name] for name in FINGERS]], atol=1e-4)


def test_unusable_settings_and_hands_are_refused():
    with pytest.raises(TrainingError, match="steps must be positive, it is 0"):
        CoupledConfig(steps=0).validate()
    with pytest.raises(TrainingError, match="needs a thumb and another finger, it has index, middle"):
        train_universal(toy_kinematics(("index", "middle")), None)
