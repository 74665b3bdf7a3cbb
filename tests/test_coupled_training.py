"""`geort_coupled` on a small hand whose right answer is known, and its map in NumPy."""

import dataclasses

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics, toy_samples

from geort_drake.errors import CheckpointError, TrainingError
from geort_drake.retargeting.checkpoint import save_checkpoint
from geort_drake.retargeting.methods.coupled import training as coupled_training
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.retargeter import CoupledRetargeter
from geort_drake.retargeting.methods.coupled.training import CoupledConfig, train_coupled
from geort_drake.retargeting.methods.geort import TrainingConfig
from geort_drake.retargeting.retargeter import load_retargeter
from geort_drake.retargeting.training.background import Beside
from geort_drake.retargeting.training.collision_geometry import CollisionShapes
from geort_drake.retargeting.training.kinematics import FingerChain, HandKinematics

KEYPOINTS = [4, 8, 12]
QUICK = CoupledConfig(
    steps=200,
    points=16,
    targets=32,
    pinches=16,
    frames=32,
    hidden=32,
    residual_hidden=32,
    context_targets=16,
    collisions=32,
)


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics()


@pytest.fixture(scope="module")
def human(hand):
    return toy_human(hand)


def quick(hand, human, seed=0, **settings):
    return train_coupled(human, hand, toy_samples(hand), dataclasses.replace(QUICK, **settings), seed)


def network_of(hand, seed=0) -> CoupledNetwork:
    """A network with random weights everywhere, the residual's last layer included."""
    generator = torch.Generator().manual_seed(seed)
    mean = 0.05 * torch.rand(len(hand.fingers), 3, generator=generator)
    scale = 0.02 + 0.03 * torch.rand(len(hand.fingers), 3, generator=generator)
    network = CoupledNetwork(hand, mean, scale, 32, 24, generator)
    with torch.no_grad():
        network.residual.weights[-1].uniform_(-0.3, 0.3, generator=generator)
        network.residual.biases[-1].uniform_(-0.3, 0.3, generator=generator)
    return network


def retargeter_of(hand, network) -> CoupledRetargeter:
    names = (hand.finger_names, hand.joint_names)
    return CoupledRetargeter(network.arrays(), *names, KEYPOINTS, hand.lower, hand.upper)


def shuffled(hand) -> HandKinematics:
    """The same hand with its joints in reverse order in q."""
    names = hand.joint_names[::-1]
    fingers = []
    for f in hand.fingers:
        indices = tuple(names.index(joint) for joint in f.joint_names)
        fingers.append(FingerChain(f.name, f.joint_names, indices, f.X_PJ, f.axes, f.p_tip))
    lower, upper = hand.lower[::-1].copy(), hand.upper[::-1].copy()
    return HandKinematics(tuple(fingers), names, lower, upper, hand.tip_radius)


@pytest.mark.parametrize("order", ["given", "reversed"])
def test_numpy_equals_torch_one_at_a_time_and_in_batches(hand, order, rng):
    """Folding the normalisation changes nothing, and whole hands are accepted."""
    hand = hand if order == "given" else shuffled(hand)
    network = network_of(hand)
    retarget = retargeter_of(hand, network)
    hands = rng.normal(0.03, 0.05, (50, 21, 3))
    tips = hands[:, KEYPOINTS]
    with torch.no_grad():
        wanted = network(torch.tensor(tips).float()).numpy()
    np.testing.assert_allclose(retarget(tips), wanted, atol=1e-4)
    np.testing.assert_allclose(retarget(hands), retarget(tips), atol=1e-12)
    np.testing.assert_allclose([retarget(tip) for tip in tips], retarget(tips), atol=1e-12)


def test_the_jacobian_equals_finite_differences_and_is_full(hand, rng):
    """Central differences of the call, for a hand whose joints are not in the order of its fingers."""
    hand = shuffled(hand)
    retarget = retargeter_of(hand, network_of(hand))
    p = rng.normal(0.03, 0.03, (3, 3))
    J = retarget.jacobian(p)
    for finger in range(3):
        for axis in range(3):
            d = np.zeros((3, 3))
            d[finger, axis] = 1e-6
            slope = (retarget(p + d) - retarget(p - d)) / 2e-6
            np.testing.assert_allclose(J[:, finger, axis], slope, atol=1e-5)
    assert (np.abs(J) > 1e-9).all()


def test_fingers_start_independent(hand):
    """Before training the residual is zero, so no finger sees another."""
    network = CoupledNetwork(
        hand, torch.zeros(3, 3), torch.ones(3, 3), 16, 16, torch.Generator().manual_seed(0)
    )
    p = torch.randn(1, 3, 3, generator=torch.Generator().manual_seed(1))
    moved = p.clone()
    moved[0, 0] += 1.0
    with torch.no_grad():
        difference = (network(moved) - network(p))[0]
    assert (difference[3:] == 0).all()
    assert (difference[:3] != 0).all()


def test_training_lowers_every_loss_it_starts_with(hand, human):
    """A short run follows the person's steps, closes pinches and covers the robot's space."""
    result = quick(hand, human)
    first, last = result.history[0], result.history[-1]
    assert np.mean([row["direction"] for row in result.history[-10:]]) < -0.85
    assert np.mean([row["track"] for row in result.history[-10:]]) < -0.85
    assert last["coverage"] < 0.7 * first["coverage"]
    assert last["pinch"] < 0.5 * first["pinch"]
    with torch.no_grad():
        tips = hand.fingertips(result.network(torch.tensor(human).float())).numpy()
    planted = (human - [0.0, 0.0, 0.05]) / 0.8
    assert np.median(np.linalg.norm(tips - planted, axis=-1)) < 0.02


def test_the_seed_alone_decides_the_weights(hand, human):
    """Whatever the global generators were left at."""
    runs = []
    for seed, elsewhere in ((3, 0), (3, 1), (4, 0)):
        torch.manual_seed(elsewhere)
        np.random.seed(elsewhere)  # noqa: NPY002
        runs.append(quick(hand, human, seed=seed, steps=30).network.arrays())
    for name in runs[0]:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    assert np.abs(runs[0]["residual_weight0"] - runs[2]["residual_weight0"]).max() > 1e-3


def test_a_process_that_prepares_batches_changes_no_weight(hand, human, monkeypatch):
    """With a second core or without, to the last bit; only longer trainings start one."""
    started = []

    class Watched(Beside):
        def __init__(self, functions, process):
            started.append(process)
            super().__init__(functions, process)

    monkeypatch.setattr(coupled_training, "Beside", Watched)
    networks = []
    for cores in (1, 2):
        monkeypatch.setattr(coupled_training, "usable_cores", lambda cores=cores: cores)
        networks.append(quick(hand, human, steps=coupled_training.WORTH_A_PROCESS).network.state_dict())
    for name, weights in networks[0].items():
        torch.testing.assert_close(weights, networks[1][name], atol=0, rtol=0)
    quick(hand, human, steps=2)
    assert started == [False, True, False]


def test_a_checkpoint_gives_back_the_same_map(hand, human, tmp_path):
    """Saved under its method's name and loaded by it; a missing array is named."""
    network = network_of(hand)
    facts = {
        "name": "toy", "finger_names": list(hand.finger_names), "joint_names": list(hand.joint_names),
        "lower": hand.lower.tolist(), "upper": hand.upper.tolist(), "model_sha256": "abc",
    }  # fmt: skip
    path = save_checkpoint(
        tmp_path / "map", network.arrays(), method="geort_coupled", hand=facts, human_keypoints=KEYPOINTS,
        training={}, provenance={}, history=[],
    )  # fmt: skip
    loaded = load_retargeter(path)
    assert isinstance(loaded, CoupledRetargeter)
    np.testing.assert_array_equal(loaded(human[:20]), retargeter_of(hand, network)(human[:20]))
    arrays = network.arrays()
    del arrays["residual_bias1"]
    with pytest.raises(CheckpointError, match="'residual_bias1' is missing"):
        names = (hand.finger_names, hand.joint_names)
        CoupledRetargeter(arrays, *names, KEYPOINTS, hand.lower, hand.upper)


def test_a_finger_that_never_pinches_is_named_and_training_goes_on(hand, human):
    """The middle finger is taken away from the thumb; the others keep pinching."""
    apart = human.copy()
    apart[:, 2, 1] += 0.2
    with pytest.warns(RuntimeWarning, match="no pinch of the thumb with: middle"):
        result = quick(hand, apart, steps=5)
    assert result.pinch_frames > 0


def test_a_loss_that_stops_being_finite_keeps_the_last_good_weights(hand, human):
    """An absurd learning rate ends in a warning and finite weights."""
    with pytest.warns(RuntimeWarning, match="stopped being finite"):
        result = quick(hand, human, learning_rate=1e38)
    assert result.stopped_at is not None
    assert all(np.isfinite(array).all() for array in result.network.arrays().values())


def test_what_is_wanted_of_cross_talk_changes_the_map(hand, human):
    """Less cross-talk comes of wanting less, with the same weights."""
    runs = [quick(hand, human, steps=1200, cross_talk_wanted=wanted) for wanted in (0.001, 10.0)]
    little, much = (sum(row["cross_talk"] for row in run.history[-20:]) for run in runs)
    assert little < 0.95 * much


def test_settings_of_another_method_are_refused(hand, human):
    """The wrong config, neural kinematics and negative weights."""
    with pytest.raises(TrainingError, match="takes a CoupledConfig"):
        train_coupled(human, hand, toy_samples(hand), TrainingConfig())
    with pytest.raises(TrainingError, match="exact kinematics only"):
        quick(hand, human, fk="neural")
    with pytest.raises(TrainingError, match="not with resampled fingers"):
        quick(hand, human, resampling="independent")
    with pytest.raises(TrainingError, match="coverage_weight must be zero or positive"):
        quick(hand, human, coverage_weight=-1.0)
    with pytest.raises(TrainingError, match="far_coverage_wanted must be below 1, it is 1"):
        quick(hand, human, far_coverage_wanted=1.0)
    with pytest.raises(TrainingError, match=r"must not exceed 1 together, they are 1\.1"):
        quick(hand, human, strange_hand_share=0.4, recorded_hand_share=0.7)
    with pytest.raises(TrainingError, match="cross_talk_wanted must be positive, it is 0"):
        quick(hand, human, cross_talk_wanted=0.0)


def test_training_avoids_collisions_of_the_given_shapes(hand, human):
    """Spheres on the fingertips that may not touch keep apart; without shapes they are not computed."""
    X = np.tile(np.eye(4), (2, 1, 1))
    X[:, 2, 3] = 0.04
    # Index and middle fingertips, as the thumb is to pinch.
    shapes = CollisionShapes(
        np.array([5, 8]), X, np.zeros((2, 3)), np.array([0.012, 0.012]), np.array([[0, 1]])
    )
    config = dataclasses.replace(QUICK, steps=150, collision_weight=2.0)

    def share(given) -> float:
        result = train_coupled(human, hand, toy_samples(hand), config, shapes=given)
        with torch.no_grad():
            tips = hand.fingertips(result.network(torch.tensor(human).float())).numpy()
        return float((np.linalg.norm(tips[:, 1] - tips[:, 2], axis=-1) < 0.022).mean())

    without, having = share(None), share(shapes)
    assert without > 0.02
    assert having < 0.3 * without


def test_a_margin_within_a_chain_is_its_own(hand, human):
    """Two spheres 3 mm apart, on the palm and the index: too near by one margin, not by the other."""
    X = np.tile(np.eye(4), (2, 1, 1))
    X[1, :3, 3] = hand.fingers[1].X_PJ[0][:3, 3] - [0.0, 0.0, 0.013]
    shapes = CollisionShapes(np.array([3, -1]), X, np.zeros((2, 3)), np.full(2, 0.005), np.array([[0, 1]]))

    def collision(chain_margin: float) -> float:
        config = dataclasses.replace(QUICK, steps=40, collision_margin=0.005, chain_margin=chain_margin)
        result = train_coupled(human, hand, toy_samples(hand), config, shapes=shapes)
        return max(row["collision"] for row in result.history)

    assert collision(0.005) > 0.1
    assert collision(0.001) == 0.0


def test_context_coverage_is_optional(hand, human):
    """Its weight at zero leaves it out."""
    assert quick(hand, human, steps=30, context_weight=0.0).history[-1]["context"] == 0.0
    assert quick(hand, human, steps=30).history[-1]["context"] > 0.0


def uneven(hand) -> HandKinematics:
    """The same hand, its index finger without the first joint."""
    thumb, index, middle = hand.fingers
    names = [name for name in hand.joint_names if name != index.joint_names[0]]
    kept = [hand.joint_names.index(name) for name in names]
    fingers = []
    for f, first in ((thumb, 0), (index, 1), (middle, 0)):
        joints = f.joint_names[first:]
        indices = tuple(names.index(joint) for joint in joints)
        fingers.append(FingerChain(f.name, joints, indices, f.X_PJ[first:], f.axes[first:], f.p_tip))
    return HandKinematics(tuple(fingers), tuple(names), hand.lower[kept], hand.upper[kept], hand.tip_radius)


@pytest.mark.parametrize("change", [lambda hand: hand, shuffled, uneven])
def test_angles_apart_move_a_finger_as_the_whole_map_does(hand, change, rng):
    """For joints in any order, and for fingers of different lengths; for all fingers and for one."""
    hand = change(hand)
    network = network_of(hand)
    whole, own = (torch.tensor(rng.normal(0.03, 0.05, shape)).float() for shape in ((7, 3, 3), (3, 20, 3, 3)))
    with torch.no_grad():
        angles = network.angles_apart(whole, own)
        torch.testing.assert_close(network.in_order(angles[:, :7]), network(whole))
        tips = hand.fingertips_apart(angles)
        assert tips.shape == (3, 27, 3)
        torch.testing.assert_close(tips[:, :7], hand.fingertips(network(whole)).transpose(0, 1))
        for number in range(3):
            wanted = hand.fingertips(network(own[number]))[:, number]
            torch.testing.assert_close(tips[number, 7:], wanted)
            some = slice(number, number + 1)
            alone = network.angles_apart(whole, own[some], some)
            finger = dataclasses.replace(hand, fingers=(hand.fingers[number],))
            torch.testing.assert_close(finger.fingertips_apart(alone)[0], tips[number])
