"""What a page of the live web server sends, made from known hands."""

import json

import numpy as np

from geort_drake.live.web.hands import _VIEW_RAD
from geort_drake.people.formats.source import KEYPOINTS_OF_25
from geort_drake.people.keypoints import mirrored
from geort_drake.people.play import synthesize_play

PLAY = synthesize_play(4, duration_s=6.0, rate_hz=60.0)
# W has x forward, y left, z up. A headset's space: x right, y up, z back. A camera that a person faces: x in
# its picture is the person's left, y down, z back.
R_SW = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
R_CW = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def in_world(number: int, side: str = "right") -> np.ndarray:
    """Keypoints (21, 3), m, of a hand that points forward."""
    p = PLAY.p_HK[number].astype(float)
    return (mirrored(p) if side == "left" else p) @ np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])


def hello(**changes) -> str:
    fields = {"version": 1, "role": "operator", "device": "scripted", "side": "right", "hand_length": None}
    return json.dumps({"type": "hello", **fields, **changes})


def joints_of(p_WK: np.ndarray) -> list[list[float]]:
    """A headset's joints at keypoints (21, 3), m; those that are no keypoints are zero."""
    joints = np.zeros((25, 3))
    joints[KEYPOINTS_OF_25,] = p_WK @ R_SW.T + [0.2, 1.2, -0.3]
    return joints.tolist()


def headset(number: int, t: float | None = None, p_WK: np.ndarray | None = None) -> str:
    """A headset's message."""
    joints = joints_of(in_world(number) if p_WK is None else p_WK)
    time = float(PLAY.t[number]) if t is None else t
    return json.dumps({"type": "headset", "t": time, "joints": joints})


def camera(number: int, p_CW: np.ndarray, aspect: float = 4 / 3) -> str:
    """MediaPipe's result for a camera whose view is as wide as the server assumes."""
    p_CK = in_world(number) @ R_CW.T + p_CW
    middle = p_CK.mean(axis=0)
    # In parts of the picture's longer side.
    uv = p_CK[:, :2] / p_CK[:, 2:] * 0.5 / np.tan(0.5 * _VIEW_RAD) * max(aspect, 1.0)
    image = uv / [aspect, 1.0] + 0.5
    fields = {"world": (p_CK - middle).tolist(), "image": image.tolist(), "aspect": aspect, "score": 0.9}
    return json.dumps({"type": "camera", "t": float(PLAY.t[number]), **fields})
