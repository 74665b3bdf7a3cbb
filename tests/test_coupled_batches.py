"""What each step of `geort_coupled` is asked about, on the toy hand."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch
from retargeting_toy import toy_human, toy_kinematics, toy_samples

from geort_drake.retargeting.clouds import voxel_centres
from geort_drake.retargeting.methods.coupled.batches import COLLIDE_EVERY, Batches, BatchMaker
from geort_drake.retargeting.methods.coupled.coverage import CoverageTargets
from geort_drake.retargeting.methods.coupled.hands import TrainingHands
from geort_drake.retargeting.methods.coupled.network import CoupledNetwork
from geort_drake.retargeting.methods.coupled.training import CoupledConfig
from geort_drake.retargeting.training.background import Beside
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes

CPU = torch.device("cpu")
CONFIG = CoupledConfig(
    points=6, targets=5, context_targets=4, pinches=7, frames=8, collisions=12, assign_every=4, jitter=1e-9
)


@pytest.fixture(scope="module")
def hand():
    return toy_kinematics()


def spheres(radius: float) -> CollisionShapes:
    """One on the index and one on the middle fingertip, which are a pair."""
    X = np.tile(np.eye(4), (2, 1, 1))
    X[:, 2, 3] = 0.04
    return CollisionShapes(np.array([5, 8]), X, np.zeros((2, 3)), np.full(2, radius), np.array([[0, 1]]))


def parts(hand, config=CONFIG, shapes=None, seed=0):
    """Batches of a person's hands, the network they are for, and the gaps between the shapes."""
    maker, network, gaps = maker_of(hand, config, shapes, seed)
    beside = Beside({"batches": maker}, process=False)
    return Batches(partial(beside.start, "batches"), CPU), network, gaps


def maker_of(hand, config=CONFIG, shapes=None, seed=0):
    """What prepares these batches, the network and the gaps."""
    generator = torch.Generator().manual_seed(seed)
    hands = TrainingHands(toy_human(hand), hand.finger_names, config, generator)
    with torch.no_grad():
        p_BF = hand.fingertips(torch.tensor(toy_samples(hand).q).float()).numpy()
    voxels = [voxel_centres(p_BF[:, i], config.robot_voxel) for i in range(3)]
    space = CoverageTargets(hands.frames, hand, voxels, config.human_voxel, seed)
    gaps = None if shapes is None else CollisionGaps(hand, shapes)
    network = CoupledNetwork(hand, hands.mean, hands.scale, 16, 16, generator)
    return BatchMaker(hands, space, gaps, config), network, gaps


def test_every_step_has_its_share_of_everything(hand):
    """Sizes are those of the config, in the first preparation and in the next."""
    batches, network, _ = parts(hand)
    for batch in [batches.next(network, 0.5) for _ in range(6)]:
        assert batch.moved.shape == (3, 6, 3, 3)
        assert batch.d.shape == (3, 6, 3)
        assert batch.before.shape == batch.after.shape == (8, 3, 3)
        assert batch.pinching.shape == (14, 3, 3)
        assert batch.weights.shape == (14, 2)
        assert batch.targets.shape == (3, 5, 3)
        assert batch.covering.shape == (3, 5, 3, 3)
        assert batch.context_targets.shape == (3, 4, 3)
        assert batch.contexts.shape == (3, 4, 3, 3, 3)
        assert batch.crowd is None


def test_hands_of_one_kind_are_spread_over_the_steps(hand):
    """A share of the moved hands takes its other fingers from anywhere: the same share in every step."""
    human = torch.tensor(toy_human(hand)).float()
    batches, network, _ = parts(hand, dataclasses.replace(CONFIG, strange_hand_share=0.5, spread_share=0.0))
    for batch in [batches.next(network, 0.5) for _ in range(4)]:
        hands = batch.moved.reshape(-1, 1, 9)
        recorded = (hands == human.flatten(1)).all(-1).any(1)
        assert (recorded.reshape(3, 6).sum(1) == 3).all()


def test_covering_hands_are_the_nearest_of_the_recording(hand):
    """Among all frames none comes nearer to a target, while the map stays what it is."""
    batches, network, _ = parts(hand)
    human = torch.tensor(toy_human(hand)).float()
    with torch.no_grad():
        batch = batches.next(network, 0.5)
        tips = hand.fingertips(network(human))
        for finger in range(3):
            reached = hand.fingertips(network(batch.covering[finger]))[:, finger]
            least = torch.cdist(batch.targets[finger], tips[:, finger]).amin(1)
            torch.testing.assert_close(
                (reached - batch.targets[finger]).norm(dim=1), least, atol=1e-5, rtol=0
            )


def test_a_crowd_knows_what_is_near(hand):
    """In every second step, three quarters at least of hands that nearly collide, with all their pairs."""
    batches, network, gaps = parts(hand, shapes=spheres(0.05))
    margin = CONFIG.collision_margin
    with torch.no_grad():
        for step in range(8):
            crowd = batches.next(network, 0.5).crowd
            if step % CONFIG.assign_every % COLLIDE_EVERY:
                assert crowd is None
                continue
            assert len(crowd.hands) == CONFIG.collisions
            least = gaps.least(network(crowd.hands), 3 * margin)
            assert sorted(crowd.row.tolist()) == torch.nonzero(least < 3 * margin)[:, 0].tolist()
            assert (crowd.pair == 0).all()
            assert (least < 2 * margin + 1e-6).sum() >= 9


def test_crowds_are_left_out_at_the_beginning_and_where_nothing_is_near(hand):
    """At first nothing is looked for; later a crowd without a near pair is just not near."""
    batches, network, _ = parts(hand, shapes=spheres(0.05))
    assert batches.next(network, 0.0).crowd is None
    batches, network, _ = parts(hand, shapes=spheres(1e-4))
    crowd = batches.next(network, 0.5).crowd
    assert len(crowd.hands) == CONFIG.collisions
    assert len(crowd.row) == 0


def test_batches_come_to_the_device_that_wants_them(hand):
    """They are prepared on the CPU, wherever the map is trained; so do the gaps between the shapes."""
    elsewhere = torch.device("meta")
    maker, network, gaps = maker_of(hand, shapes=spheres(0.05))
    batch = Batches(partial(Beside({"batches": maker}, process=False).start, "batches"), elsewhere).next(
        network, 0.5
    )
    tensors = [value for value in vars(batch).values() if isinstance(value, torch.Tensor)]
    tensors += [*vars(batch.crowd).values()]
    moved = [value for value in vars(gaps.to(elsewhere)).values() if isinstance(value, torch.Tensor)]
    assert {value.device for value in tensors + moved} == {elsewhere}
    assert gaps.pairs.device == CPU


def test_a_map_that_is_not_finite_gets_no_batch(hand):
    """Its nearest frames cannot be searched for."""
    batches, network, _ = parts(hand)
    with torch.no_grad():
        network.mlp.biases[0].fill_(float("nan"))
        assert batches.next(network, 0.5) is None


def test_the_seed_decides_every_batch(hand):
    """Two runs are the same to the last bit, prepared in a process beside this one or here."""
    runs = []
    for process in (False, True):
        maker, network, _ = maker_of(hand, shapes=spheres(0.05), seed=5)
        with Beside({"batches": maker}, process) as beside:
            batches = Batches(partial(beside.start, "batches"), CPU)
            runs.append([batches.next(network, 0.5) for _ in range(9)])
    for first, second in zip(*runs, strict=True):
        for field in ("moved", "after", "pinching", "covering", "contexts"):
            torch.testing.assert_close(getattr(first, field), getattr(second, field), atol=0, rtol=0)
