"""Hands in motion, seen in the world, of which `glove_files` makes recordings in every format."""

import functools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.people.human_hand import HumanHand

FRAMES, RATE_HZ = 400, 60.0
FINGERS = ("index", "middle", "ring", "little")
KEYPOINTS = ("wrist", *(f"thumb_{j}" for j in ("cmc", "mcp", "ip", "tip"))) + tuple(
    f"{finger}_{j}" for finger in FINGERS for j in ("mcp", "pip", "dip", "tip")
)


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand in motion: keypoints p_HK (T, 21, 3) as a right hand's, times, and its wrist in the world."""

    p_HK: np.ndarray
    t: np.ndarray
    R_WH: np.ndarray
    p_WH: np.ndarray
    side: str = "right"

    @property
    def seen(self) -> np.ndarray:
        """The keypoints of the real hand, which is the mirror image of a left one's description."""
        return self.p_HK * [1, -1, 1] if self.side == "left" else self.p_HK

    def part(self, frames) -> "Hand":
        """Only those frames, with the times they had."""
        return Hand(self.p_HK[frames], self.t[frames], self.R_WH[frames], self.p_WH[frames], self.side)

    def joints(self, world: bool = True) -> dict[str, np.ndarray]:
        """Positions (T, 3) by name, in the world or from the wrist, with what lies beside the keypoints."""
        p = self.seen
        if world:
            p = np.einsum("tij,tkj->tki", self.R_WH, p) + self.p_WH[:, None]
        named = {name: p[:, i] for i, name in enumerate(KEYPOINTS)}
        for finger in FINGERS:
            named[f"{finger}_base"] = 0.7 * named["wrist"] + 0.3 * named[f"{finger}_mcp"]
        named["palm"] = 0.5 * (named["middle_base"] + named["middle_mcp"])
        named["elbow"] = named["wrist"] + 3.0 * (named["wrist"] - named["middle_mcp"])
        return named


@functools.cache
def moving(pinch: bool = True, held: tuple[tuple[str, float], ...] = ()) -> Hand:
    """Every joint swings at its own pace, the thumb meets each finger once, and the wrist turns and travels.

    Args:
        pinch: whether the thumb meets the fingers; otherwise it stays away from them.
        held: joints that do not move, and the angle they keep, deg.
    """
    hand, t = HumanHand.anatomical(), np.arange(FRAMES) / RATE_HZ
    phase = 2 * np.pi * t[:, None] * (0.5 + 0.03 * np.arange(20))
    theta = 0.5 * (hand.lower + hand.upper) + 0.42 * (hand.upper - hand.lower) * np.sin(phase)
    for finger in range(1, 5) if pinch else ():
        pose = np.deg2rad([30, 20, 20, 40, *[0, 20, 20, 15] * 4]).reshape(5, 4)
        pose[finger] = np.deg2rad([0, 40, 50, 35])
        pose = pose.reshape(20)
        for _ in range(8):
            tips = hand.fingertips(pose)
            tips[[0, finger]] = tips[[0, finger]].mean(axis=0)
            pose = hand.solve_fingertips(tips, pose)
        near = 0.5 * (1 + np.cos(np.pi * np.clip((np.arange(FRAMES) - 80 * finger) / 32, -1, 1)))[:, None]
        theta = theta + near * (pose - theta)
    if not pinch:
        theta[:, :4] = np.deg2rad([45, -15, 0, 10] + [14, 14, 8, 12] * np.sin(phase[:, :4]))
    for joint, degrees in held:
        theta[:, hand.joint_names.index(joint)] = np.deg2rad(degrees)
    s = t / t[-1]
    turn = Rotation.from_euler("xyz", np.column_stack([7 * s, 0.8 * np.sin(9 * s), 1 - 3 * s]))
    path = np.column_stack([0.4 * s, 0.1 * np.cos(s), 1.0 + 0.1 * np.sin(5 * s)])
    return Hand(hand.keypoints(theta), t, turn.as_matrix(), path)


def random_hand(seed: int, side: str) -> Hand:
    """Unrelated poses of a hand of random size in a world of random directions."""
    rng = np.random.default_rng(seed)
    hand = HumanHand.anatomical(rng.uniform(0.16, 0.21), rng.uniform(0.075, 0.095))
    p_HK = hand.keypoints(rng.uniform(hand.lower, hand.upper, (40, 20)))
    R_WH = Rotation.random(40, rng=rng).as_matrix()
    t = np.cumsum(rng.uniform(0.005, 0.03, 40))
    return Hand(p_HK, t - t[0], R_WH, rng.normal(0.0, 0.5, (40, 3)), side)
