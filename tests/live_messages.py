"""What gloves and pages of the live web server send, made from known hands."""

import json

import numpy as np
from shared import synthesized

from geort_drake.live.glove_stream import HANDSHAKE_FRAMES
from geort_drake.live.messages import GloveFrame, encode_frame
from geort_drake.live.web.hands import _VIEW_RAD
from geort_drake.live.web.operator_station import OperatorStation, RobotInfo
from geort_drake.people.formats import KEYPOINTS_OF_25
from geort_drake.people.keypoints import mirrored


class Inbox:
    """A socket into which a test puts messages."""

    def __init__(self, *messages: bytes):
        self.messages = list(messages)

    def drain(self) -> list[bytes]:
        messages, self.messages = self.messages, []
        return messages


class Clock:
    """A clock that a test sets, s."""

    def __init__(self, now: float = 100.0):
        self.now = now

    def __call__(self) -> float:
        return self.now


def station(robot: str = "simulation", side: str = "right") -> OperatorStation:
    """A station of the page for such a robot, on a clock that stands."""
    tasks = {"grasp": ["cube", "cylinder", "sphere"], "keys": ["keys"]}
    return OperatorStation(RobotInfo(side, f"allegro_{side}", robot, tasks, "universal map"), Clock())


def known(operated: OperatorStation, person: int = 1) -> OperatorStation:
    """The station with an operator whose first hands were checked."""
    operated.join(person)
    operated.take(person, hello())
    for number in range(HANDSHAKE_FRAMES):
        operated.take(person, headset(number))
    return operated


def own_fields(hand: np.ndarray, **changes) -> dict:
    """The fields of a good message of ours, with some changed; those given as ... are left out."""
    fields = json.loads(
        encode_frame(GloveFrame("right", 12.5, hand, np.array([1.0, 0, 0, 0, 0.1, 0.2, 0.3])))
    )
    return {name: value for name, value in {**fields, **changes}.items() if value is not ...}


def nodes_of(p_HK: np.ndarray, side: str = "right") -> np.ndarray:
    """MANUS' 25 nodes p_WN of a hand, m, in a frame W that is turned and moved against H."""
    p = np.empty((25, 3))
    p[list(KEYPOINTS_OF_25)] = p_HK
    p[[5, 10, 15, 20]] = 0.3 * np.asarray(p_HK)[[5, 9, 13, 17]]
    if side == "left":
        p = mirrored(p)
    return p @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [0.3, -0.1, 1.2]


def manus_words(glove_id: str, p_WN: np.ndarray) -> list[str]:
    """One glove of the text form."""
    return [glove_id, *(repr(float(x)) for p in p_WN for x in (*p, 0.0, 0.0, 0.0, 1.0))]


def manus_glove(p_WN: np.ndarray, side: str = "Right", glove_id: int = 7) -> dict:
    """The fields of a ManusGlove, its nodes in no order."""
    nodes = [
        {
            "node_id": number,
            "parent_node_id": 0,
            "joint_type": "",
            "chain_type": "",
            "pose": {"position": dict(zip("xyz", p.tolist(), strict=True)), "orientation": {"w": 1.0}},
        }
        for number, p in enumerate(p_WN)
    ]
    return {"glove_id": glove_id, "side": side, "raw_node_count": 25, "raw_nodes": nodes[::-1]}


PLAY = synthesized(4, 6.0, 60.0)
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
