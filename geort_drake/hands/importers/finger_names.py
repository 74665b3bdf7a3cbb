"""Identifies a hand's fingers and side by the names in its model, or by the fingers' positions."""

import re
from collections.abc import Sequence

import numpy as np

from geort_drake.people.keypoints import FINGER_NAMES

# Names of fingers in models; Shadow and others use two-letter names.
_WORDS = {
    "thumb": r"thumb|pollex|(?<![a-z])th(?![a-z])|(?<![a-z])thj",
    "index": r"index|fore|point(?!_)|(?<![a-z])ff|(?<![a-z])if(?![a-z])",
    "middle": r"middle|medium|long|(?<![a-z])mf",
    "ring": r"(?<![a-z])ring|(?<![a-z])rf",
    "little": r"little|pinky|pinkie|small|(?<![a-z])lf",
}
_SIDES = {
    "right": r"right|(?<![a-z0-9])(rh|r)(?![a-z0-9])",
    "left": r"left|(?<![a-z0-9])(lh|l)(?![a-z0-9])",
}


def fingers_by_name(names: Sequence[Sequence[str]]) -> list[str] | None:
    """Identifies the finger of each chain by names; returns None if these are ambiguous.

    Args:
        names: names of each chain's joints and links.
    """
    found = []
    for group in names:
        counts = {
            finger: sum(bool(re.search(word, name.lower())) for name in group)
            for finger, word in _WORDS.items()
        }
        # "Middle" may also mean a phalanx.
        best = max(counts, key=lambda finger: (counts[finger], finger != "middle"))
        found.append(best if counts[best] else "")
    return found if "" not in found and len(set(found)) == len(found) else None


def thumb_by_position(p_base: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> int:
    """Returns the number of the finger that differs most in position and direction; of two, the shorter.

    Args:
        p_base: (F, 3) positions of the fingers' first joints, m.
        directions: (F, 3) unit vectors along the stretched fingers.
        reach: (F,) lengths of the stretched fingers, m.
    """
    count = len(p_base)
    if count == 2:
        return int(np.argmin(reach))
    scale = max(float(np.ptp(p_base, axis=0).max()), 1e-6)
    apart = []
    for number in range(count):
        others = np.delete(np.arange(count), number)
        mean = directions[others].mean(axis=0)
        turned = 1.0 - directions[number] @ mean / max(float(np.linalg.norm(mean)), 1e-9)
        apart.append(turned + np.linalg.norm(p_base[number] - p_base[others].mean(axis=0)) / scale)
    return int(np.argmax(apart))


def side_by_name(texts: Sequence[str]) -> str | None:
    """Returns the side that most of the texts name; None for a tie."""
    counts = {
        side: sum(bool(re.search(word, text.lower())) for text in texts) for side, word in _SIDES.items()
    }
    if counts["right"] == counts["left"]:
        return None
    return max(counts, key=lambda side: counts[side])


def fingers_by_position(count: int, thumb: int, sideways: np.ndarray) -> list[str]:
    """Names fingers by their distance from the thumb, beginning with the index finger.

    Args:
        count: F, the number of fingers.
        thumb: number of the thumb.
        sideways: (F,) coordinates of the fingers' first joints towards the thumb's side, m.
    """
    names = [""] * count
    names[thumb] = FINGER_NAMES[0]
    others = [number for number in np.argsort(-np.asarray(sideways)) if number != thumb]
    for name, number in zip(FINGER_NAMES[1:], others, strict=False):
        names[number] = name
    return names
