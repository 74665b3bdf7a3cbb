"""Converts the universal map of a hand to its mirror image."""

import numpy as np

from geort_drake.hands.kinematics import HandKinematics
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics
from geort_drake.retargeting.universal.person import UniversalRetargeter

MIRROR_TOLERANCE_M = 1e-3


def mirrored_map(
    retargeter: UniversalRetargeter, hand: HandKinematics, mirrored: HandKinematics
) -> UniversalRetargeter | None:
    """Converts the map of a hand to its mirror image, whose joints may have other names, senses and zeros.

    Args:
        retargeter: map of `hand`.
        hand: kinematics of the hand.
        mirrored: kinematics of the other hand, mirrored; see `HandKinematics.mirrored`.

    Returns:
        The map; None if the other hand is no mirror image within `MIRROR_TOLERANCE_M`.
    """
    if (match := match_joints(hand, mirrored)) is None:
        return None
    rows, signs = match
    columns = retargeter.arrays["columns"]
    arrays = dict(retargeter.arrays)
    outputs = np.ones(arrays["bias2"].size, dtype=np.float32)
    outputs[columns[rows]] = signs
    arrays["columns"] = columns[rows]
    for name in ("weight2", "bias2", "residual_weight2", "residual_bias2"):
        shape = (len(hand.fingers), 1, -1) if name in ("weight2", "bias2") else (-1,)
        arrays[name] = arrays[name] * outputs.reshape(shape)
    names = mirrored.finger_names, mirrored.joint_names, retargeter.human_keypoints.tolist()
    result = UniversalRetargeter(*names, mirrored.lower, mirrored.upper, arrays)
    result.info = retargeter.info
    return result


def match_joints(hand: HandKinematics, mirrored: HandKinematics) -> tuple[np.ndarray, np.ndarray] | None:
    """Matches the joints of two hands of which one is the mirror image of the other.

    Joints correspond along each finger. At corresponding fractions of their ranges, both hands must have the
    same fingertips within `MIRROR_TOLERANCE_M`, at 100 random postures.

    Args:
        hand, mirrored: as for `mirrored_map`.

    Returns:
        Numbers (n,) of the joints of `hand` for those of `mirrored`, and their senses (n,), 1 or −1; with −1,
        one joint is at its upper limit where the other is at its lower. None if the hands differ.
    """
    if mirrored.finger_names != hand.finger_names or len(mirrored.joint_names) != len(hand.joint_names):
        return None
    rows, signs = np.zeros(len(hand.joint_names), dtype=int), np.ones(len(hand.joint_names))
    axes, others = (_axes_amid_limits(each) for each in (hand, mirrored))
    for chain, other in zip(hand.fingers, mirrored.fingers, strict=True):
        joints, theirs = list(chain.joint_indices), list(other.joint_indices)
        if len(joints) != len(theirs):
            return None
        rows[theirs] = joints
        signs[theirs] = np.where((axes[joints] * others[theirs]).sum(-1) < 0, -1.0, 1.0)
    fractions = np.random.default_rng(0).uniform(size=(100, len(rows)))
    mirrored_fractions = np.where(signs > 0, fractions[:, rows], 1.0 - fractions[:, rows])
    tips, mirrored_tips = (
        NumpyKinematics(each).fingertips(each.lower + part * (each.upper - each.lower))
        for each, part in ((hand, fractions), (mirrored, mirrored_fractions))
    )
    far = np.linalg.norm(tips - mirrored_tips, axis=-1).max()
    return (rows, signs) if far <= MIRROR_TOLERANCE_M else None


def _axes_amid_limits(hand: HandKinematics) -> np.ndarray:
    """Returns the unit axes (n, 3) of the joints in B, with all joints in the middle of their ranges."""
    chains, angles = hand.uncoupled()
    X_BJ = chains.joint_poses((angles @ (0.5 * (hand.lower + hand.upper)))[None])[0]
    axes = np.zeros((len(chains.joint_names), 3))
    for finger in chains.fingers:
        for joint, axis in zip(finger.joint_indices, finger.axes, strict=True):
            axes[joint] = X_BJ[joint, :3, :3] @ axis
    return axes[: len(hand.joint_names)]
