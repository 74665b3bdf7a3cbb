"""A method of the dex-retargeting package: AnyTeleop's vectors from wrist to fingertips."""

import tempfile

import numpy as np
from dex_retargeting.retargeting_config import RetargetingConfig

from geort_drake.hands.urdf import hand_urdf


def make(hand):
    """Returns a function from keypoints (21, 3), m, to joint angles (n,), rad."""
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
