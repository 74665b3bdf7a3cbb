"""Identifies the order of 21 keypoints among the orders of known data sets.

Orders are judged by ratios of distances, which do not depend on frame, unit or mirroring.
"""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.keypoints import BONES
from geort_drake.people.keypoints import FINGER_KEYPOINTS as _F

# Orders of published data sets: the keypoint at each of the 21 positions in a file.
MANO_ORDER = (0, 5, 6, 7, 9, 10, 11, 17, 18, 19, 13, 14, 15, 1, 2, 3, 4, 8, 12, 16, 20)
EXPECTED = "wrist, then thumb to little finger, base to tip (MediaPipe)"
_TIPS_FIRST = tuple(k for chain in _F.values() for k in chain[::-1])
ORDERS: dict[str, tuple[int, ...]] = {
    EXPECTED: tuple(range(21)),
    "MANO's joints, then the tips (HO-3D)": MANO_ORDER,
    "wrist, then each finger from tip to base (RHD)": (0, *_TIPS_FIRST),
    "each finger from tip to base, then the wrist (InterHand2.6M)": (*_TIPS_FIRST, 0),
}
_JITTER = 5e-4  # of a glove's bone lengths, as a fraction of the palm's length


def fitting_order(p: np.ndarray) -> tuple[str | None, str]:
    """Finds the order of `ORDERS` in which keypoints p (T, 21, 3), in any frame and unit, form a hand.

    The expected order is preferred if it fits nearly as well as another. If no order fits, the first value is
    None and the second describes what contradicts the expected order; otherwise it is empty.
    """
    p = p[np.linspace(0, len(p) - 1, min(len(p), 200)).astype(int)].astype(float)
    distances = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)
    middle = np.median(distances, axis=0)
    spread = np.median(np.abs(distances - middle), axis=0)
    parents, children = np.array(BONES).T
    fits: dict[str, float] = {}
    for name, order in ORDERS.items():
        grid = np.ix_(np.argsort(order), np.argsort(order))
        if not any(_contradictions(middle[grid])):
            fits[name] = float(spread[grid][parents, children].mean() / middle[grid][0, 9])
    if not fits:
        return None, next(_contradictions(middle))
    best = min(fits, key=lambda name: fits[name])
    return EXPECTED if fits.get(EXPECTED, np.inf) <= 2 * fits[best] + _JITTER else best, ""


def _contradictions(distance: np.ndarray) -> Iterator[str]:
    """Yields what in the median distances (21, 21) of keypoints contradicts the expected order."""
    knuckles = distance[0, [5, 9, 13, 17]]
    if distance[0, 1] > 0.75 * knuckles.min():
        yield "keypoint 1, the thumb's base, is not nearer to the wrist than the knuckles are"
    if knuckles.min() < 0.7 * knuckles.max():
        yield "the knuckles 5, 9, 13 and 17 are not about equally far from the wrist"
    from_index = distance[5, 9] < distance[5, 13] < distance[5, 17]
    from_little = distance[17, 13] < distance[17, 9] < distance[17, 5]
    if not (from_index and from_little):
        yield "the knuckles 5, 9, 13 and 17 do not follow each other across the palm"
    if distance[2, 5] > distance[2, 17]:
        yield "keypoint 2, of the thumb, is nearer to 17, the little finger, than to 5, the index finger"
    longest = max((bone for bone in BONES if bone[0] != 0), key=lambda bone: distance[bone])
    if distance[longest] > 0.75 * distance[0, 9]:
        yield f"{longest[0]} and {longest[1]}, the ends of a finger's bone, are nearly a palm apart"
    # Even in a fist, a joint is slightly farther from the joint after the next than from the next.
    for finger, chain in _F.items():
        for a, b, c in zip(chain, chain[1:], chain[2:], strict=False):
            if distance[a, c] < 0.9 * distance[a, b]:
                yield f"keypoint {c}, of the {finger}, is nearer to {a} than {b}, which lies between them"
