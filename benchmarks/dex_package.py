"""Retargeters of the dex-retargeting package with the settings of our online baselines."""

import runpy
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.hands.hand import Hand
from geort_drake.retargeting import online

EXAMPLE = Path(__file__).parents[1] / "examples" / "dex_retargeting_method.py"
# Name of our method → type of the package's optimiser.
TYPES = {"anyteleop": "vector", "dexpilot": "dexpilot"}


def make_dex_retargeter(name: str, hand: Hand, huber_delta: float) -> Any:
    """Returns the package's counterpart of our method `name`, for the same hand.

    Raises:
        ImportError: the package is not installed: pip install dex-retargeting six
    """
    from dex_retargeting.retargeting_config import RetargetingConfig

    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "hand.urdf"
        urdf.write_text(runpy.run_path(str(EXAMPLE))["hand_urdf"](hand), encoding="utf-8")
        settings = _settings(TYPES[name], urdf, hand.description, huber_delta)
        return RetargetingConfig.from_dict(settings).build()


def _settings(kind: str, urdf: Path, description, huber_delta: float) -> dict:
    """Returns dex-retargeting's settings with our names and values."""
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
