"""Whether 21 keypoints come in the order that is meant, and which other known order they come in.

All is judged by distances, which neither the frame, the unit's size nor a mirror image changes.
"""

from collections.abc import Iterator

import numpy as np

from geort_drake.gloves.keypoints import BONES
from geort_drake.gloves.keypoints import FINGER_KEYPOINTS as _F

# Which keypoint stands at each of the 21 places of a file, in the orders that data sets use.
MANO_ORDER = (0, 5, 6, 7, 9, 10, 11, 17, 18, 19, 13, 14, 15, 1, 2, 3, 4, 8, 12, 16, 20)
ORDERS: dict[str, tuple[int, ...]] = {
    "wrist, then thumb to little finger, base to tip (MediaPipe)": tuple(range(21)),
    "MANO's joints, then the tips (HO-3D)": MANO_ORDER,
    "wrist, index to little finger, then the thumb": (0, *range(5, 21), *_F["thumb"]),
    "wrist, then little finger to thumb": (0, *(k for name in reversed(_F) for k in _F[name])),
    "wrist, thumb, then little to index finger": (
        0, *_F["thumb"], *(k for name in ("little", "ring", "middle", "index") for k in _F[name])
    ),
    "wrist, then each finger from tip to base (RHD)": (0, *(k for f in _F.values() for k in f[::-1])),
    "each finger from tip to base, then the wrist (InterHand2.6M)": (
        *(k for f in _F.values() for k in f[::-1]), 0
    ),
    "thumb to little finger, then the wrist": (*range(1, 21), 0),
    "wrist, the knuckles, then joint by joint to the tips": (
        0, *(finger[joint] for joint in range(4) for finger in _F.values())
    ),
}  # fmt: skip
_RIGHT = next(iter(ORDERS))


def fitting_order(p: np.ndarray) -> str | None:
    """The order of `ORDERS` in which keypoints p (T, 21, 3) of any frame and unit are a hand.

    The order that is meant, the first, is preferred where it fits nearly as well as another. None
    where no order makes a hand of them.
    """
    p = p[np.linspace(0, len(p) - 1, min(len(p), 200)).astype(int)].astype(float)
    distances = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)
    middle = np.median(distances, axis=0)
    spread = np.median(np.abs(distances - middle), axis=0)
    fits: dict[str, float] = {}
    for name, order in ORDERS.items():
        places = np.argsort(order)
        grid = np.ix_(places, places)
        if not any(oddities(middle[grid])):
            fits[name] = _bone_spread(middle[grid], spread[grid])
    if not fits:
        return None
    best = min(fits, key=lambda name: fits[name])
    return _RIGHT if fits.get(_RIGHT, np.inf) <= 2 * fits[best] + 0.02 else best


def is_right(order: str | None) -> bool:
    """Whether `fitting_order` found the order that is meant."""
    return order == _RIGHT


def oddities(distance: np.ndarray) -> Iterator[str]:
    """What is unlike a hand in the median distances (21, 21) between its keypoints, if they are in order."""
    knuckles = distance[0, [5, 9, 13, 17]]
    palm = distance[0, 9]
    if distance[0, 1] > 0.75 * knuckles.min():
        yield "keypoint 1, the thumb's base, is not nearer to the wrist than the knuckles are"
    if knuckles.min() < 0.7 * knuckles.max():
        yield "the knuckles 5, 9, 13 and 17 are not about equally far from the wrist"
    row = distance[5, 9] < distance[5, 13] < distance[5, 17] and distance[17, 13] < distance[17, 9]
    if not row:
        yield "the knuckles 5, 9, 13 and 17 do not follow each other across the palm"
    if distance[2, 5] > distance[2, 17]:
        yield "keypoint 2, of the thumb, is nearer to 17, the little finger, than to 5, the index finger"
    inner = [(a, b) for a, b in BONES if a != 0]
    longest = max(inner, key=lambda bone: distance[bone])
    if distance[longest] > 0.75 * palm:
        yield f"{longest[0]} and {longest[1]}, the ends of a finger's bone, are nearly a palm apart"


def _bone_spread(middle: np.ndarray, spread: np.ndarray) -> float:
    parents, children = np.array(BONES).T
    return float(spread[parents, children].mean() / middle[0, 9])
