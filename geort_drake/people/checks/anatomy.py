"""Checks that keypoints are a hand: order, unit, side, bones and frame."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import MAX_LOST, Finding, error, lost_frames, warning
from geort_drake.people.checks.order import EXPECTED, fitting_order
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

UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}

_PALM_M = (0.060, 0.110)  # wrist to middle knuckle, from a child of ten to a large adult
_BENT = 0.02  # the mean sine of the fingers' bending above which the side can be determined
_FRAME_M = 0.005  # largest distance of a keypoint from where the definition of H puts it
# Larger deviations of a bone from its median length are faults; camera trackers vary by 4 to 16 %.
_ODD_BONE, _ODD_BONE_M = 0.75, 0.01
_NOISY_BONES, _UNUSABLE_BONES = 0.03, 0.25  # standard deviation over mean


def check_order(recording: Recording) -> Iterator[Finding]:
    """The 21 keypoints come in the expected order."""
    order, oddity = fitting_order(_valid(recording))
    if order != EXPECTED:
        given = f"a hand in this order: {order}" if order else f"no hand in any known order: {oddity}"
        what = f"wrong joint order: keypoints must be {EXPECTED}, but are {given}"
        yield error("joint order", what, "p_HK", "reorder them before importing")


def check_unit(recording: Recording) -> Iterator[Finding]:
    """The hand is as large as a person's, in metres."""
    p_HK = _valid(recording)
    palm = float(np.median(np.linalg.norm(p_HK[:, MIDDLE_MCP] - p_HK[:, WRIST], axis=-1)))
    low, high = _PALM_M
    if not low <= palm <= high:
        # The unit with which a file was read; our own files are in metres and have none.
        unit = recording.metadata.get("unit")
        number = palm / UNITS_M.get(unit or "m", 1.0)
        fits = [other for other, size in UNITS_M.items() if low <= number * size <= high]
        what = f"wrist to middle knuckle must be {1e3 * low:.0f} to {1e3 * high:.0f} mm, but is {palm:.4g} m"
        what += f"; it would be right if lengths were in {fits[0]}" if fits else ""
        advice = f"import them with --unit {fits[0]}" if fits and unit else "give keypoints in metres"
        yield error("unit", what, "p_HK", advice)


def check_side(recording: Recording) -> Iterator[Finding]:
    """The hand is of the requested side, and not in mirrored coordinates."""
    side, bending = recording.side, _mean_bending(_valid(recording))
    if bending < -_BENT:
        other = SIDES[1 - SIDES.index(side)]
        what = f"the fingers bend backwards (mean sine {bending:.2f}), so this is a {other} hand or a "
        what += f"{side} one in mirrored axes (such as Unity's, which are left-handed)"
        advice = f"read it with --side {other}, or to get a {side} hand, also if the axes are mirrored, "
        advice += f"convert it with --side {other} --mirror"
        yield error("handedness", what, "p_HK", advice)
    elif bending < _BENT:
        what = "the fingers hardly bend, so the side of the hand cannot be checked"
        yield warning("handedness", what, "p_HK", "make a fist while recording")


def _mean_bending(p_HK: np.ndarray) -> float:
    """Mean sine of the angle between the fingers' first and last bones in keypoints (T, 21, 3).

    Fingers bend towards +x whichever pose the hand is in, so the turn from the first to the last bone is
    about +y. In a mirror image y and z stay as they are and x = y × z changes sign.
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
    backwards = len(p_HK) > 0 and _mean_bending(p_HK) < -_BENT
    return SIDES[1 - SIDES.index(side)] if backwards else side


def check_bones(recording: Recording) -> Iterator[Finding]:
    """Bones keep their lengths, and no two keypoints coincide. Frames of another size become invalid."""
    length = bone_lengths(_valid(recording))
    median = np.median(length, axis=0)
    if median.min() < 1e-3:
        parent, child = BONES[int(np.argmin(median))]
        what = f"keypoints {parent} and {child} coincide; 21 distinct ones are needed"
        yield error("bone lengths", what, f"p_HK[:, {child}]")
        return
    odd = (np.abs(length - median) > _ODD_BONE * median + _ODD_BONE_M).any(axis=1)
    if odd.mean() <= MAX_LOST:  # else the spread below reports it
        yield from _lost(recording, odd, "have bones of another length")
        length = length[~odd]
    spread = length.std(axis=0) / length.mean(axis=0)
    worst = int(np.argmax(spread))
    parent, child = BONES[worst]
    if spread[worst] >= _NOISY_BONES:
        kind = error if spread[worst] > _UNUSABLE_BONES else warning
        what = f"bone {parent}–{child} changes its length by {spread[worst]:.0%} (deviation over mean); "
        what += f"a glove's by less than {_NOISY_BONES:.0%}, and over {_UNUSABLE_BONES:.0%} is unusable"
        yield kind("bone lengths", what, f"p_HK[:, {child}]", "check that these are 3-D keypoints in m")


def check_frame(recording: Recording) -> Iterator[Finding]:
    """Keypoints are given in the wrist frame H: its origin, and the directions of its axes."""
    p_HK = _valid(recording)
    off = np.linalg.norm(to_wrist_frame(p_HK) - p_HK, axis=-1).max(axis=1)
    if np.nanmedian(off) < _FRAME_M:
        yield from _lost(recording, ~(off < _FRAME_M), "are not in the wrist frame H")
        return
    what = "keypoints must be given in the wrist frame H (origin at the wrist, z to the middle knuckle, y to "
    what += f"the index side), but are off by {1e3 * np.nanmedian(off):.0f} mm"
    advice = "save other frames as (T, 21, 3) .npy, which is brought to H when it is read"
    yield error("axes", what, "p_HK", advice)


def _lost(recording: Recording, bad: np.ndarray, what: str) -> Iterator[Finding]:
    """A finding about bad ones among the valid frames."""
    if bad.any():
        yield lost_frames(np.flatnonzero(recording.valid)[bad].tolist(), len(recording), what)


def _valid(recording: Recording) -> np.ndarray:
    return recording.p_HK[recording.valid].astype(float)
