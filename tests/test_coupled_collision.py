"""Gaps between shapes against closed forms, and against Drake."""

import numpy as np
import pytest
import torch
from retargeting_toy import toy_kinematics
from scipy.spatial.transform import Rotation

from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.training.collision_geometry import CollisionGaps, CollisionShapes, box_gap

CPU = torch.device("cpu")


def gap(R_A, R_B, p_AB, a, b) -> float:
    tensors = [torch.tensor(np.asarray(value, dtype=float))[None] for value in (R_A, R_B, p_AB, a, b)]
    return float(box_gap(*tensors)[0])


@pytest.mark.parametrize(
    ("p_AB", "expected"), [([3, 0, 0], 1.0), ([0, 1.5, 0], -0.5), ([0, 0, 2], 0.0), ([3, 3, 0], 2**0.5)]
)
def test_parallel_cubes_and_a_point(p_AB, expected):
    """Unit half edges: face to face; for a point at a corner the distance is Euclidean."""
    eye = np.eye(3)
    b = [1, 1, 1] if expected != 2**0.5 else [0, 0, 0]
    p = p_AB if expected != 2**0.5 else [2, 2, 0]
    assert gap(eye, eye, p, [1, 1, 1], b) == pytest.approx(expected, abs=1e-6)


def test_crossed_edges_are_separated_by_their_product():
    """Two cubes on edge, crossing at right angles: the gap along z is the height minus 2√2."""
    R_A, R_B = Rotation.from_euler("x", 45, True).as_matrix(), Rotation.from_euler("y", 45, True).as_matrix()
    for height in (2.5, 3.5):
        expected = height - 2 * 2**0.5
        assert gap(R_A, R_B, [0, 0, height], [1, 1, 1], [1, 1, 1]) == pytest.approx(expected, abs=1e-6)


def test_the_sign_agrees_with_points_inside_both_boxes(rng):
    """Where a dense grid of one box's points lies in the other, they overlap, and else (nearly) not."""
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, 15)], indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(100):
        R_A, R_B = Rotation.random(2, random_state=int(rng.integers(1 << 30))).as_matrix()
        a, b, p = rng.uniform(0.3, 1.0, 3), rng.uniform(0.3, 1.0, 3), rng.normal(0, 0.8, 3)
        inside = (np.abs((grid * b @ R_B.T + p) @ R_A) < a).all(axis=1).any()
        value = gap(R_A, R_B, p, a, b)
        # Overlaps finer than the grid may be missed, so only clear ones must be found.
        assert value < 0 if inside else value > -0.3


def test_gradient_of_the_loss_equals_finite_differences():
    """Two spheres on the toy hand's fingertips, pushed into each other."""
    hand = toy_kinematics(("thumb", "index"))
    X = np.tile(np.eye(4), (2, 1, 1))
    X[:, 2, 3] = 0.04
    shapes = CollisionShapes(
        np.array([2, 5]), X, np.zeros((2, 3)), np.array([0.02, 0.02]), np.array([[0, 1]])
    )
    gaps = CollisionGaps(hand, shapes)
    q = torch.tensor([[0.0, 0.3, 0.5, 0.05, 0.4, 0.5]], requires_grad=True)
    near = torch.tensor([0]), torch.tensor([0])
    loss = gaps.loss(q, *near, 0.001, 0.005)
    tips = hand.fingertips(q.detach().double())[0]
    distance = float((tips[0] - tips[1]).norm())
    assert loss.item() == pytest.approx((0.001 - (distance - 0.04)) / 0.005, rel=1e-3)
    loss.backward()
    for j in range(6):
        d = torch.zeros(1, 6)
        d[0, j] = 1e-2
        more, less = (gaps.loss(q.detach() + sign * d, *near, 0.001, 0.005) for sign in (1, -1))
        assert float(q.grad[0, j]) == pytest.approx(float(more - less) / 2e-2, abs=0.02)


def test_no_pair_near_costs_nothing():
    """A hand without pairs has no loss, and no gap below the margin."""
    hand = toy_kinematics(("thumb", "index"))
    nothing = np.zeros((0, 2), dtype=int)
    shapes = CollisionShapes(np.array([-1]), np.eye(4)[None], np.ones((1, 3)), np.zeros(1), nothing)
    gaps = CollisionGaps(hand, shapes)
    q = torch.zeros(3, 6)
    row, pair, _ = gaps.near(q, 0.005)
    assert float(gaps.loss(q, row, pair, 0.001, 0.005)) == 0.0
    assert (gaps.least(q, 0.002) == 0.002).all()


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_gaps_agree_with_drake(name):
    """The sign of the least gap is Drake's answer, except where a cylinder's rim decides."""
    hand = HandModel(load_hand(name))
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


def test_parts_of_one_chain_are_allowed_to_be_nearer(leap):
    """Links of one finger, and of a finger and the palm, count as 4 mm further apart; fingertips do not."""
    q = torch.tensor(np.random.default_rng(2).uniform(leap.lower, leap.upper, (20, 16))).float()
    shapes, kinematics = collision_shapes(leap), leap.kinematics()
    row, pair, gap = CollisionGaps(kinematics, shapes).near(q, 0.05)
    again, same_pair, allowed = CollisionGaps(kinematics, shapes, allowance=0.004).near(q, 0.05)
    assert row.equal(again) and pair.equal(same_pair)
    finger_of = {j: (name, j == joints[-1]) for name, joints in finger_joints(leap).items() for j in joints}
    seen = set()
    for number, more in zip(pair.tolist(), (allowed - gap).tolist(), strict=True):
        a, b = (finger_of.get(int(shapes.joint[side]), ("palm", False)) for side in shapes.pairs[number])
        one_chain = a[0] == b[0] or "palm" in (a[0], b[0])
        tip = a[1] or b[1]
        seen.add((one_chain, tip))
        assert more == pytest.approx(0.004 if one_chain and not tip else 0.0, abs=1e-6), (a, b)
    assert len(seen) == 4


def finger_joints(hand: HandModel) -> dict[str, list[int]]:
    """Numbers of each finger's joints, base to tip."""
    return {
        finger.name: [hand.joint_names.index(joint) for joint in finger.joints]
        for finger in hand.description.fingers
    }


def test_shapes_mirror_with_the_kinematics(allegro):
    """The mirrored hand is as far from touching itself at the same q."""
    q = torch.tensor(np.random.default_rng(1).uniform(allegro.lower, allegro.upper, (100, 16))).float()
    shapes, kinematics = collision_shapes(allegro), allegro.kinematics()
    a = CollisionGaps(kinematics, shapes).least(q, 0.01)
    b = CollisionGaps(kinematics.mirrored(), shapes.mirrored()).least(q, 0.01)
    torch.testing.assert_close(a, b, atol=1e-5, rtol=0)
