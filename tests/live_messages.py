"""Gloves' messages for the tests of live use, and receivers that need no network."""

import json

import numpy as np

from geort_drake.live.messages import GloveFrame, encode_frame
from geort_drake.people.formats.source import KEYPOINTS_OF_25
from geort_drake.people.keypoints import mirrored


class Inbox:
    """A receiver into which a test puts messages."""

    def __init__(self, *messages: bytes):
        self.messages = list(messages)

    def drain(self) -> list[bytes]:
        messages, self.messages = self.messages, []
        return messages

    def close(self) -> None:
        pass


class Clock:
    """A clock that a test sets, s."""

    def __init__(self, now: float = 100.0):
        self.now = now

    def __call__(self) -> float:
        return self.now


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
