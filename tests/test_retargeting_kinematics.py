"""Exact kinematics against an independent composition of transforms."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from geort_drake.retargeting.training.kinematics import FingerChain, HandKinematics


def random_hand(rng, lengths=(4, 4, 3, 5)) -> HandKinematics:
    """Fingers of unequal length whose joints do not come finger by finger in q."""
    n = sum(lengths)
    names = [f"j{k}" for k in range(n)]
    shuffled = list(rng.permutation(n))
    fingers = []
    for number, k in enumerate(lengths):
        X = np.tile(np.eye(4), (k, 1, 1))
        X[:, :3, :3] = Rotation.random(k, random_state=number).as_matrix()
        X[:, :3, 3] = rng.normal(scale=0.03, size=(k, 3))
        axes = rng.normal(size=(k, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        indices = [int(shuffled.pop()) for _ in range(k)]
        joint_names = tuple(names[i] for i in indices)
        fingers.append(
            FingerChain(
                f"finger{number}", joint_names, tuple(indices), X, axes, rng.normal(scale=0.03, size=3)
            )
        )
    return HandKinematics(tuple(fingers), tuple(names), -np.ones(n), np.ones(n), 0.012)


def composed(hand: HandKinematics, q: np.ndarray) -> np.ndarray:
    """Fingertips (F, 3) by multiplying 4×4 transforms from the base to the tip."""
    tips = []
    for finger in hand.fingers:
        T = np.eye(4)
        for X, axis, index in zip(finger.X_PJ, finger.axes, finger.joint_indices, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(axis * q[index]).as_matrix()
            T = T @ X @ turn
        tips.append((T @ np.append(finger.p_tip, 1.0))[:3])
    return np.array(tips)


def test_fingertips_equal_the_composition_of_transforms(rng):
    """Point propagation from the tip and frame composition from the base agree to rounding."""
    hand = random_hand(rng)
    q = rng.uniform(-3, 3, (20, len(hand.joint_names)))
    expected = np.stack([composed(hand, row) for row in q])
    np.testing.assert_allclose(hand.fingertips(torch.tensor(q)).numpy(), expected, atol=1e-14)


def test_the_mirror_image_has_its_fingertips_at_negative_y(rng):
    """Same q, reflected points: what a left hand is to a right one."""
    hand = random_hand(rng)
    q = torch.tensor(rng.uniform(-1, 1, (20, len(hand.joint_names))))
    expected = hand.fingertips(q) * torch.tensor([1.0, -1.0, 1.0])
    torch.testing.assert_close(hand.mirrored().fingertips(q), expected, atol=1e-14, rtol=0)
    torch.testing.assert_close(hand.mirrored().mirrored().fingertips(q), hand.fingertips(q))
