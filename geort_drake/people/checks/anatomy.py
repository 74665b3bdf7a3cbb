"""Checks that keypoints form a hand: order, unit, side, bones and frame."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import MAX_LOST, Finding, error, lost_frames, warning
from geort_drake.people.keypoints import (
    BONES,
    FINGER_KEYPOINTS,
    MIDDLE_MCP,
    WRIST,
    bone_lengths,
    mirrored,
    to_wrist_frame,
)
from geort_drake.people.recording import SIDES, Recording

# Orders of published data sets: the keypoint at each of the 21 positions in a file.
MANO_ORDER = (0, 5, 6, 7, 9, 10, 11, 17, 18, 19, 13, 14, 15, 1, 2, 3, 4, 8, 12, 16, 20)
EXPECTED = "wrist, then thumb to little finger, base to tip (MediaPipe)"
_TIPS_FIRST = tuple(k for chain in FINGER_KEYPOINTS.values() for k in chain[::-1])
ORDERS: dict[str, tuple[int, ...]] = {
    EXPECTED: tuple(range(21)),
    "MANO's joints, then the tips (HO-3D)": MANO_ORDER,
    "wrist, then each finger from tip to base (RHD)": (0, *_TIPS_FIRST),
    "each finger from tip to base, then the wrist (InterHand2.6M)": (*_TIPS_FIRST, 0),
}
UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}

_PALM_M = (0.060, 0.110)  # wrist to middle knuckle, from a child of ten to a large adult
_JITTER = 5e-4  # of a glove's bone lengths, as a fraction of the palm's length
_MIN_BEND_SINE = 0.02  # mean over the fingers; below it, the side cannot be determined
_FRAME_TOLERANCE_M = 0.005  # between a keypoint and its position by the definition of H
# Largest deviation of a bone from its median length, relative plus absolute; cameras vary by 4 to 16 %.
_BONE_DEVIATION, _BONE_DEVIATION_M = 0.75, 0.01
_NOISY_SPREAD, _UNUSABLE_SPREAD = 0.03, 0.25  # of a bone: standard deviation over mean


def check_order(recording: Recording) -> Iterator[Finding]:
    """Checks that the 21 keypoints come in the expected order."""
    order, contradiction = fitting_order(_valid(recording))
    if order != EXPECTED:
        given = f"a hand in this order: {order}" if order else f"no hand in any known order: {contradiction}"
        what = f"wrong joint order: keypoints must be {EXPECTED}, but are {given}"
        yield error("joint order", what, "p_HK", "reorder them before importing")


def check_unit(recording: Recording) -> Iterator[Finding]:
    """Checks that the hand has a person's size, in metres."""
    p_HK = _valid(recording)
    palm = float(np.median(np.linalg.norm(p_HK[:, MIDDLE_MCP] - p_HK[:, WRIST], axis=-1)))
    low, high = _PALM_M
    if not low <= palm <= high:
        # The unit in which the file was read; geort-drake's own files are in metres and state none.
        unit = recording.metadata.get("unit")
        number = palm / UNITS_M.get(unit or "m", 1.0)
        fits = [other for other, size in UNITS_M.items() if low <= number * size <= high]
        what = f"wrist to middle knuckle must be {1e3 * low:.0f} to {1e3 * high:.0f} mm, but is {palm:.4g} m"
        what += f"; it would be right if lengths were in {fits[0]}" if fits else ""
        advice = f"convert it with --unit {fits[0]}" if fits and unit else "give keypoints in metres"
        yield error("unit", what, "p_HK", advice)


def check_side(recording: Recording) -> Iterator[Finding]:
    """Checks that the hand is of the requested side and its axes are not mirrored."""
    side, bending = recording.side, _mean_bending(_valid(recording))
    if bending < -_MIN_BEND_SINE:
        other = SIDES[1 - SIDES.index(side)]
        what = f"the fingers bend backwards (mean sine {bending:.2f}), so this is a {other} hand or a "
        what += f"{side} one in mirrored axes (such as Unity's, which are left-handed)"
        advice = f"read it with --side {other}, or to get a {side} hand, also if the axes are mirrored, "
        advice += f"convert it with --side {other} --mirror"
        yield error("handedness", what, "p_HK", advice)
    elif bending < _MIN_BEND_SINE:
        what = "the fingers hardly bend, so the side of the hand cannot be checked"
        yield warning("handedness", what, "p_HK", "make a fist while recording")


def _mean_bending(p_HK: np.ndarray) -> float:
    """Computes the mean sine of the angle from the fingers' first to their last bones; p_HK is (T, 21, 3).

    Fingers bend towards +x in every pose of the hand, so the first bone turns to the last one about +y. In a
    mirror image y and z stay the same and x = y × z changes sign, so the sine is negative.
    """
    first, last = (
        np.stack([p_HK[:, k[i + 1]] - p_HK[:, k[i]] for k in list(FINGER_KEYPOINTS.values())[1:]], axis=1)
        for i in (0, 2)
    )
    size = np.linalg.norm(first, axis=-1) * np.linalg.norm(last, axis=-1)
    return float((np.cross(first, last)[..., 1] / np.maximum(size, 1e-12)).mean())


def bent_side(p_WK: np.ndarray, side: str) -> str:
    """Finds the side of keypoints p_WK (T, 21, 3) in any frame from how the fingers bend.

    Returns `side`, as stated by the file, if the fingers hardly bend or no frame is complete.
    """
    p_HK = to_wrist_frame(mirrored(p_WK) if side == "left" else p_WK)
    p_HK = p_HK[np.isfinite(p_HK).all(axis=(1, 2))]
    backwards = len(p_HK) > 0 and _mean_bending(p_HK) < -_MIN_BEND_SINE
    return SIDES[1 - SIDES.index(side)] if backwards else side


def check_bones(recording: Recording) -> Iterator[Finding]:
    """Checks that bones keep their lengths and keypoints are distinct; outlier frames become invalid."""
    length = bone_lengths(_valid(recording))
    median = np.median(length, axis=0)
    if median.min() < 1e-3:
        parent, child = BONES[int(np.argmin(median))]
        what = f"keypoints {parent} and {child} coincide; 21 distinct ones are needed"
        yield error("bone lengths", what, f"p_HK[:, {child}]")
        return
    outlier = (np.abs(length - median) > _BONE_DEVIATION * median + _BONE_DEVIATION_M).any(axis=1)
    if outlier.mean() <= MAX_LOST:  # else the spread below reports it
        yield from _lost(recording, outlier, "have bones of another length")
        length = length[~outlier]
    spread = length.std(axis=0) / length.mean(axis=0)
    worst = int(np.argmax(spread))
    parent, child = BONES[worst]
    if spread[worst] >= _NOISY_SPREAD:
        kind = error if spread[worst] > _UNUSABLE_SPREAD else warning
        what = f"bone {parent}–{child} changes its length by {spread[worst]:.0%} (deviation over mean); "
        what += f"a glove's change by less than {_NOISY_SPREAD:.0%}; over {_UNUSABLE_SPREAD:.0%} is unusable"
        yield kind("bone lengths", what, f"p_HK[:, {child}]", "check that these are 3-D keypoints in m")


def check_frame(recording: Recording) -> Iterator[Finding]:
    """Checks that keypoints are given in the wrist frame H: its origin and axes."""
    p_HK = _valid(recording)
    off = np.linalg.norm(to_wrist_frame(p_HK) - p_HK, axis=-1).max(axis=1)
    if np.nanmedian(off) < _FRAME_TOLERANCE_M:
        yield from _lost(recording, ~(off < _FRAME_TOLERANCE_M), "are not in the wrist frame H")
        return
    what = "keypoints must be given in the wrist frame H (origin at the wrist, z to the middle knuckle, y to "
    what += f"the index side), but are off by {1e3 * np.nanmedian(off):.0f} mm"
    advice = "save other frames as (T, 21, 3) .npy, which is transformed to H when it is read"
    yield error("axes", what, "p_HK", advice)


def _lost(recording: Recording, bad: np.ndarray, what: str) -> Iterator[Finding]:
    """Yields a finding about the `bad` frames, a mask (N,) over the N valid ones, if there are any."""
    if bad.any():
        yield lost_frames(np.flatnonzero(recording.valid)[bad].tolist(), len(recording), what)


def _valid(recording: Recording) -> np.ndarray:
    return recording.p_HK[recording.valid].astype(float)


def fitting_order(p: np.ndarray) -> tuple[str | None, str]:
    """Finds the order of `ORDERS` in which keypoints p (T, 21, 3), in any frame and unit, form a hand.

    Orders are judged by ratios of distances, which do not depend on frame, unit or mirroring. The expected
    order is preferred if it fits nearly as well as another. If no order fits, the first value is
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
    for finger, chain in FINGER_KEYPOINTS.items():
        for a, b, c in zip(chain, chain[1:], chain[2:], strict=False):
            if distance[a, c] < 0.9 * distance[a, b]:
                yield f"keypoint {c}, of the {finger}, is nearer to {a} than {b}, which lies between them"
