"""A method of the dex-retargeting package: AnyTeleop's vectors from wrist to fingertips."""

import tempfile

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.retargeting.base import kinematics_of


def make(hand):
    """Returns a function from keypoints (21, 3), m, to joint angles (n,), rad."""
    from dex_retargeting.retargeting_config import RetargetingConfig

    tips = [f"{name}_tip" for name in hand.finger_names]
    human = np.array([[0] * len(tips), hand.description.human_keypoints])
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(hand_urdf(hand))
        file.flush()
        vectors = RetargetingConfig.from_dict({
            "type": "vector", "urdf_path": file.name, "scaling_factor": 1.6, "low_pass_alpha": 1.0,
            "target_origin_link_names": ["wrist"] * len(tips), "target_task_link_names": tips,
            "target_link_human_indices": human,
        }).build()  # fmt: skip
    order = [vectors.joint_names.index(name) for name in hand.joint_names]
    return lambda p_HK: vectors.retarget(p_HK[human[1]] - p_HK[human[0]])[order]


def hand_urdf(hand) -> str:
    """Returns the fingers of a hand as URDF text; as for all retargeters, a left hand is mirrored.

    The links are `base` (B), `wrist`, `JOINT_link` for each joint and `FINGER_tip` for each fingertip point.
    Joints have the hand's names and limits. Links have neither shapes nor inertia.
    """
    kinematics = kinematics_of(hand)
    parts = ['<link name="base"/>', _fixed("wrist", "base", kinematics.p_BW)]
    for finger in kinematics.fingers:
        parent = "base"
        for k, joint in enumerate(finger.all_joint_names):
            X, link, (leader,) = finger.X_PJ[k], f"{joint}_link", np.flatnonzero(finger.coupling[k])
            i, mimic = finger.joint_indices[leader], ""
            if joint not in finger.joint_names:
                ratio = float(finger.coupling[k, leader])
                mimic = f'<mimic joint="{finger.joint_names[leader]}" multiplier="{ratio!r}"/>'
            rpy = Rotation.from_matrix(X[:3, :3]).as_euler("xyz")
            parts.append(
                f'<link name="{link}"/><joint name="{joint}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="{_numbers(X[:3, 3])}" rpy="{_numbers(rpy)}"/>'
                f'<axis xyz="{_numbers(finger.axes[k])}"/><limit lower="{float(kinematics.lower[i])!r}" '
                f'upper="{float(kinematics.upper[i])!r}" effort="1" velocity="1"/>{mimic}</joint>'
            )
            parent = link
        parts.append(_fixed(f"{finger.name}_tip", parent, finger.p_tip))
    return '<?xml version="1.0"?><robot name="hand">' + "\n".join(parts) + "</robot>\n"


def _fixed(name: str, parent: str, p: np.ndarray) -> str:
    return (
        f'<link name="{name}"/><joint name="{name}_joint" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{_numbers(p)}" rpy="0 0 0"/></joint>'
    )


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
