"""Valid inputs for fault injection: a recording, a retargeter for it, and its file."""

from pathlib import Path

import numpy as np
from grasp_setup import allegro
from shared import synthesized

from geort_drake import Recording
from geort_drake.retargeting.clouds import trained_points
from geort_drake.retargeting.mlp import MlpRetargeter

TIPS = (4, 8, 12, 16)
FINGERS = ("thumb", "index", "middle", "ring")
JOINTS = tuple(f"{finger}_{number}" for finger in FINGERS for number in range(4))
LOWER, UPPER = np.full(16, -0.4), np.full(16, 1.6)


def play() -> Recording:
    """Twelve seconds at 100 Hz, shared: do not change them."""
    return synthesized(4, 12.0, 100.0)


def smooth_arrays(gain: float = 1.0) -> dict[str, np.ndarray]:
    """Random networks; for `play` the joints reach 4.2 rad/s times `gain`."""
    rng = np.random.default_rng(2)
    centre = play().p_HK[:, list(TIPS)].mean(axis=0)[:, None]
    weight0 = gain * rng.normal(0, 2.4, (4, 3, 8))
    return {
        "weight0": weight0,
        "bias0": -centre @ weight0,
        "weight1": rng.normal(0, 0.4, (4, 8, 8)),
        "bias1": np.zeros((4, 1, 8)),
        "weight2": rng.normal(0, 0.5, (4, 8, 4)),
        "bias2": np.zeros((4, 1, 4)),
        "columns": np.arange(16),
    }


def smooth_retargeter(gain: float = 1.0, tips: tuple = TIPS) -> MlpRetargeter:
    """The map of `smooth_arrays`, for a hand of `JOINTS`."""
    return MlpRetargeter(FINGERS, JOINTS, tips, LOWER, UPPER, smooth_arrays(gain))


def map_file(folder: Path, name: str = "map.safetensors", **info) -> Path:
    """Writes that map for the Allegro hand with its trained points; `info` changes what is stored with it."""
    hand = allegro()
    names = hand.finger_names, hand.joint_names
    retargeter = MlpRetargeter(*names, TIPS, hand.lower, hand.upper, smooth_arrays())
    retargeter.robot_hands = (hand.description.name,)
    retargeter.trained_points = trained_points(play().p_HK[:, list(TIPS)].astype(float))
    retargeter.info = {
        "method": "geort",
        "config": {},
        "provenance": {"hands": {hand.description.name: hand.digest}, "warnings": []},
        "history": [{"step": 0, "total": 1.0}],
    } | info
    retargeter.save(folder / name)
    return folder / name
