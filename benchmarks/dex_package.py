"""Retargeters of the dex-retargeting package, set up as our online baselines are."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.hands.model import HandModel
from geort_drake.retargeting.methods import online

# Name of our method → the package's type of optimiser.
TYPES = {"vector_online": "vector", "dexpilot_online": "dexpilot"}


def make_dex_retargeter(name: str, hand: HandModel, huber_delta: float) -> Any:
    """The package's counterpart of our method of that name, for the same hand.

    Raises:
        ImportError: the package is missing: pip install dex-retargeting six
    """
    from dex_retargeting.retargeting_config import RetargetingConfig

    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "hand.urdf"
        urdf.write_text(_urdf(hand.kinematics()), encoding="utf-8")
        settings = _settings(TYPES[name], urdf, hand.description, huber_delta)
        return RetargetingConfig.from_dict(settings).build()


def _settings(kind: str, urdf: Path, description, huber_delta: float) -> dict:
    """dex-retargeting's settings with the names and numbers of ours."""
    tips = [f"{finger.name}_tip" for finger in description.fingers]
    settings = {"type": kind, "urdf_path": str(urdf), "scaling_factor": online.SCALE, "low_pass_alpha": 1.0}
    if kind == "vector":
        keypoints = description.human_keypoints
        return settings | {
            "target_origin_link_names": ["wrist"] * len(tips),
            "target_task_link_names": tips,
            "target_link_human_indices": np.array([[0] * len(tips), keypoints]),
            "huber_delta": huber_delta,
            "normal_delta": online.NORM_DELTA,
        }
    return settings | {
        "wrist_link_name": "wrist",
        "finger_tip_link_names": tips,
        "project_dist": online.PROJECT,
        "escape_dist": online.ESCAPE,
    }


def _urdf(kinematics) -> str:
    """The hand as a URDF of frames: base, wrist, one link per joint and one per fingertip."""

    def fixed(name: str, parent: str, p: Sequence[float]) -> str:
        return (
            f'<link name="{name}"/><joint name="{name}_joint" type="fixed"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{_numbers(p)}" rpy="0 0 0"/></joint>'
        )

    parts = ['<link name="base"/>', fixed("wrist", "base", kinematics.p_BW)]
    for finger in kinematics.fingers:
        parent = "base"
        for k, joint in enumerate(finger.joint_names):
            X, i = finger.X_PJ[k], finger.joint_indices[k]
            rpy = Rotation.from_matrix(X[:3, :3]).as_euler("xyz")
            link = f"{joint}_link"
            parts.append(
                f'<link name="{link}"/><joint name="{joint}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="{_numbers(X[:3, 3])}" rpy="{_numbers(rpy)}"/>'
                f'<axis xyz="{_numbers(finger.axes[k])}"/><limit lower="{float(kinematics.lower[i])!r}" '
                f'upper="{float(kinematics.upper[i])!r}" effort="1" velocity="1"/></joint>'
            )
            parent = link
        parts.append(fixed(f"{finger.name}_tip", parent, finger.p_tip))
    return '<?xml version="1.0"?><robot name="hand">' + "\n".join(parts) + "</robot>\n"


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
