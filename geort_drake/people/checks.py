"""Checks that a recording shows a hand: order of the keypoints, unit, side, lost frames, bones.

A check returns sentences about what is suspicious; it raises RecordingError for what leaves the meaning open.
"""

import dataclasses
from collections.abc import Iterator
from itertools import pairwise, permutations

import numpy as np

from geort_drake.errors import MismatchError, RecordingError, naming
from geort_drake.people.keypoints import (
    BONES,
    FINGER_KEYPOINTS,
    KEYPOINT_COUNT,
    MIDDLE_MCP,
    WRIST,
    bone_lengths,
    mirrored,
    to_wrist_frame,
)
from geort_drake.people.recording import OTHER_SIDE, Recording

UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254, "dm": 0.1}
# Orders of published data sets: the keypoint at each of the 21 positions in a file.
KEYPOINT_ORDER = "wrist, then thumb to little finger, base to tip (MediaPipe)"
_TIPS_FIRST = tuple(k for chain in FINGER_KEYPOINTS.values() for k in chain[::-1])
ORDERS: dict[str, tuple[int, ...]] = {
    KEYPOINT_ORDER: tuple(range(21)),
    "MANO's joints, then the tips (HO-3D)": (
        0, 5, 6, 7, 9, 10, 11, 17, 18, 19, 13, 14, 15, 1, 2, 3, 4, 8, 12, 16, 20,
    ),
    "wrist, then each finger from tip to base (RHD)": (0, *_TIPS_FIRST),
    "each finger from tip to base, then the wrist (InterHand2.6M)": (*_TIPS_FIRST, 0),
}  # fmt: skip
NORM_TOLERANCE = 1e-2  # accepted deviation of a quaternion's norm from 1
MAX_LOST = 0.1  # a recording with a larger fraction of lost or untimed frames is refused

_LARGEST = 1e6  # coordinate, in any unit, of a hand
_KNUCKLES = (5, 9, 13, 17)  # of index to little finger
_PALM_M = (0.060, 0.110)  # wrist to middle knuckle, from a child of ten to a large adult
_JITTER = 5e-4  # of a glove's bone lengths, as a fraction of the palm's length
_MIN_BEND_SINE = 0.02  # mean over the fingers; below it, the side cannot be determined
_FRAME_TOLERANCE_M = 0.005  # between a keypoint and its position by the definition of H
# Largest deviation of a bone from its median length, relative plus absolute; cameras vary by 4 to 16 %.
_BONE_DEVIATION, _BONE_DEVIATION_M = 0.75, 0.01
_NOISY_SPREAD, _UNUSABLE_SPREAD = 0.03, 0.25  # of a bone: standard deviation over mean
# The side of a hand: how far the thumb's MCP joint is before the palm, m, and the mean sine by which fingers
# bend, each over its unit. Frames of 150 synthetic people as devices see them give a sum over −0.2, all but
# one in a thousand over 0.2.
_THUMB_MCP, _BEFORE_PALM_M, _BEND_SINE, _LEAST_SIDE = 2, 0.02, 0.3, -0.25
# In a spike, a keypoint moves by more than this and returns in the next frame: ten times a glove's jitter.
_SPIKE_M = 0.02
_GAP_S, _MISSING_FRACTION = 0.2, 0.05  # a glove at 118 Hz over radio loses 4 % of its frames
_RATE_HZ = (2.0, 2000.0)  # plausible range


def examine(recording: Recording) -> Recording:
    """Runs all checks on a recording in frame H.

    Returns:
        The recording, with unusable frames marked invalid and all sentences in `metadata["warnings"]`.

    Raises:
        RecordingError: the meaning of the recording is open, or too little of it is usable.
    """
    check_clock(recording)
    p_HK = _finite(recording)
    check_order(p_HK)
    check_unit(p_HK, recording.metadata.get("unit"))
    sentences = check_side(p_HK, recording.side)
    recording, lost = mark_lost_frames(recording)
    sentences += [*lost, *check_bones(_finite(recording))]
    warnings = dict.fromkeys([*recording.metadata.get("warnings", []), *sentences])
    return dataclasses.replace(recording, metadata={**recording.metadata, "warnings": list(warnings)})


def require_wrist_frame_hand(p_HK: np.ndarray, name: str = "human points") -> None:
    """Refuses keypoints that are not a person's hand in metres in the wrist frame H.

    Args:
        p_HK: (21, 3) or (T, 21, 3) keypoints, m; frames that are not finite are ignored, and so
            are other bad ones, if they are fewer than half.
        name: what the keypoints are, for messages.

    Raises:
        RecordingError: another shape, no finite frame, another unit or order, or points that are not in H.
            The message names what would be right.
        MismatchError: a hand of the other side.
    """
    p = np.asarray(p_HK, dtype=float)
    if p.ndim not in (2, 3) or p.shape[-2:] != (KEYPOINT_COUNT, 3):
        raise RecordingError(f"{name}: must have the shape (21, 3) or (T, 21, 3), not {p.shape}")
    p = p.reshape(-1, KEYPOINT_COUNT, 3)
    p = p[(np.abs(p) < _LARGEST).all(axis=(1, 2))]
    if not len(p):
        raise RecordingError(f"{name}: no frame has finite keypoints below {_LARGEST:g}")
    with naming(name, RecordingError):
        check_order(p)
        check_unit(p)
        off = float(np.median(_off_frame(p)))
        if not off < _FRAME_TOLERANCE_M:
            raise RecordingError(
                "keypoints must be given in the wrist frame H (origin at the wrist, z to the middle knuckle, "
                f"y to the index side), but are off by {1e3 * off:.0f} mm; transform them with "
                "geort_drake.people.keypoints.to_wrist_frame"
            )
        if 2 * (good := int(good_frames(p).sum())) < len(p):
            raise RecordingError(f"only {good} of {len(p)} frames are in H and of a person's size in metres")
    # Either cue alone fails: straight fingers bend backwards, and a flat hand's thumb lies behind the palm.
    thumb_x, bend = float(np.median(p[:, _THUMB_MCP, 0])), _mean_bending(p)
    if thumb_x / _BEFORE_PALM_M + bend / _BEND_SINE < _LEAST_SIDE:
        raise MismatchError(
            f"{name}: the thumb is {-1e3 * thumb_x:.0f} mm behind the palm and the fingers bend by a "
            f"mean sine of {bend:.2f}: this is a hand of the other side, or one in mirrored axes"
        )


def require_hand(recording: Recording, side: str | None = None) -> None:
    """Refuses a recording that was made from arrays which are no person's hand in H, m, or of another side.

    Args:
        recording: frames that were not read from a file, which would have been checked.
        side: the expected side; None for any.

    Raises:
        RecordingError, MismatchError: see `require_wrist_frame_hand`; or another side.
    """
    if side is not None and recording.side != side:
        raise RecordingError(f"the recording is of a {recording.side} hand, the robot's is a {side} hand")
    p_HK = recording.p_HK[recording.valid]
    require_wrist_frame_hand(p_HK[:: len(p_HK) // 1000 + 1], "the recording")


def good_frames(p_HK: np.ndarray) -> np.ndarray:
    """Returns which frames (T,) of keypoints p_HK (T, 21, 3), m, are finite, of a person's size, and in H."""
    good = (np.abs(p_HK) < _LARGEST).all(axis=(1, 2))
    p = p_HK[good].astype(float)
    low, high = _PALM_M
    palm = np.linalg.norm(p[:, MIDDLE_MCP] - p[:, WRIST], axis=-1)
    # A camera's scale varies by 5 %.
    good[good] = (palm > 0.8 * low) & (palm < 1.2 * high) & (_off_frame(p) < _FRAME_TOLERANCE_M)
    return good


def check_clock(recording: Recording) -> None:
    """Refuses fewer than two frames, times that do not increase, and implausible rates."""
    t = recording.t
    if len(t) < 2:
        raise RecordingError(f"at least 2 frames are needed, {len(t)} given (t)")
    bad = ~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0)
    if bad.any():
        frame = int(np.argmax(bad))
        raise RecordingError(f"times must be finite and increase, but frame {frame} has {t[frame]:.6f} s (t)")
    low, high = _RATE_HZ
    if not low <= recording.rate_hz <= high:
        factors = (10.0**power for power in (-9, -6, -3, 3, 6, 9))
        fit = next((factor for factor in factors if 10 <= recording.rate_hz / factor <= 1000), None)
        raise RecordingError(
            f"times must give {low:g} to {high:g} frames in a second, but give {recording.rate_hz:.3g} (t)"
            + (f"; it would be right if times were multiplied by {fit:g}: check their unit" if fit else "")
        )


def check_order(p_HK: np.ndarray) -> None:
    """Refuses keypoints (T, 21, 3) that are in another order than the expected one."""
    order, contradiction = fitting_order(p_HK)
    if order != KEYPOINT_ORDER:
        actual = f"a hand in this order: {order}" if order else f"no hand in any known order: {contradiction}"
        raise RecordingError(
            f"wrong joint order: keypoints must be {KEYPOINT_ORDER}, but are {actual} (p_HK)"
        )


def check_unit(p_HK: np.ndarray, unit: str | None = None) -> None:
    """Refuses keypoints (T, 21, 3), m, of a hand that has no person's size; `unit` is that of their file."""
    palm = float(np.median(np.linalg.norm(p_HK[:, MIDDLE_MCP] - p_HK[:, WRIST], axis=-1)))
    low, high = _PALM_M
    if low <= palm <= high:
        return
    # geort-drake's own files are in metres and state no unit.
    number = palm / UNITS_M[unit or "m"]
    fits = [other for other, size in UNITS_M.items() if low <= number * size <= high]
    message = f"wrist to middle knuckle must be {1e3 * low:.0f} to {1e3 * high:.0f} mm, but is {palm:.4g} m"
    message += f"; it would be right if lengths were in {fits[0]}" if fits else ""
    if fits and unit:
        message += f": geort-drake recording convert FILE --unit {fits[0]} --output NEW.npz"
    elif fits:
        message += f": multiply them by {UNITS_M[fits[0]]:g}"
    raise RecordingError(message)


def check_side(p_HK: np.ndarray, side: str) -> list[str]:
    """Refuses a hand of the other side, and mirrored axes, by how the fingers bend; p_HK is (T, 21, 3), m."""
    bending, other = _mean_bending(p_HK), OTHER_SIDE[side]
    if bending < -_MIN_BEND_SINE:
        raise RecordingError(
            f"the fingers bend backwards (mean sine {bending:.2f}), so this is a {other} hand or a {side} "
            f"one in mirrored axes (such as Unity's, which are left-handed); read it with --side {other}, "
            f"or to get a {side} hand, also if the axes are mirrored: geort-drake recording convert FILE "
            f"--side {other} --mirror --output NEW.npz"
        )
    if bending < _MIN_BEND_SINE:
        return [
            "the fingers hardly bend, so the side of the hand cannot be checked; make a fist while recording"
        ]
    return []


def mark_lost_frames(recording: Recording) -> tuple[Recording, list[str]]:
    """Marks unusable frames as invalid, and refuses a recording in which they are more than one in ten.

    Unusable are frames that are not finite, not in H, have bones of another length or no unit quaternion of
    the wrist, or in which a keypoint jumps away and back.
    """
    known = np.isfinite(recording.p_HK).all(axis=2)
    never = np.flatnonzero(~known.any(axis=0)).tolist()
    if 0 < len(never) < KEYPOINT_COUNT:
        raise RecordingError(
            f"keypoints {', '.join(map(str, never))} are lost in all {len(recording)} frames (p_HK); check "
            "that finger's sensor"
        )
    valid, count = recording.valid.copy(), len(recording)
    sentences = list(_gaps(recording))
    for what, unusable in (
        ("are not finite numbers", _not_finite(recording)),
        ("are not in the wrist frame H", ~(_off_frame(recording.p_HK.astype(float)) < _FRAME_TOLERANCE_M)),
        ("have bones of another length", _other_bones(recording)),
        ("have a keypoint that jumps away and back", _spikes(recording)),
    ):
        bad = unusable & valid
        if bad.any():
            valid &= ~bad
            first = int(np.argmax(bad))
            sentences.append(f"{bad.sum()} of {count} frames {what}, the first is frame {first}: invalid")
    lost = count - int(valid.sum())
    newly = lost - int((~recording.valid).sum())
    if valid.sum() < 2 or newly > MAX_LOST * count:
        reasons = "; ".join(sentences) or "none is valid"
        raise RecordingError(f"{lost} of {count} frames are unusable, at most one in ten may be: {reasons}")
    return dataclasses.replace(recording, valid=valid), sentences


def check_bones(p_HK: np.ndarray) -> list[str]:
    """Refuses keypoints (T, 21, 3), m, that coincide, and bones whose lengths change as in 2-D landmarks."""
    length = bone_lengths(p_HK)
    median = np.median(length, axis=0)
    if median.min() < 1e-3:
        parent, child = BONES[int(np.argmin(median))]
        raise RecordingError(f"keypoints {parent} and {child} coincide (p_HK); 21 distinct ones are needed")
    spread = length.std(axis=0) / length.mean(axis=0)
    parent, child = BONES[int(np.argmax(spread))]
    if spread.max() < _NOISY_SPREAD:
        return []
    what = f"bone {parent}–{child} changes its length by {spread.max():.0%} (deviation over mean)"
    if spread.max() > _UNUSABLE_SPREAD:
        raise RecordingError(f"{what}; over {_UNUSABLE_SPREAD:.0%} is unusable: give 3-D keypoints in m")
    return [f"{what}; a glove's change by less than {_NOISY_SPREAD:.0%}"]


def bent_side(p_WK: np.ndarray, side: str) -> str:
    """Finds the side of keypoints p_WK (T, 21, 3) in any frame from how the fingers bend.

    Returns `side`, as stated by the file, if the fingers hardly bend or no frame is complete.
    """
    p_HK = to_wrist_frame(mirrored(p_WK) if side == "left" else p_WK)
    p_HK = p_HK[np.isfinite(p_HK).all(axis=(1, 2))]
    backwards = len(p_HK) > 0 and _mean_bending(p_HK) < -_MIN_BEND_SINE
    return OTHER_SIDE[side] if backwards else side


def fitting_order(p: np.ndarray) -> tuple[str | None, str]:
    """Finds the order of `ORDERS` in which keypoints p (T, 21, 3), in any frame and unit, form a hand.

    Orders are judged by ratios of distances, which do not depend on frame, unit or mirroring. The expected
    order is preferred if it fits nearly as well as another. If no order fits, the first value is None and the
    second describes what contradicts the expected order; otherwise it is empty.
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
            fits[name] = float(spread[grid][parents, children].mean() / max(middle[grid][0, 9], 1e-12))
    if not fits:
        return None, next(_contradictions(middle))
    best = min(fits, key=lambda name: fits[name])
    return KEYPOINT_ORDER if fits.get(KEYPOINT_ORDER, np.inf) <= 2 * fits[best] + _JITTER else best, ""


def _contradictions(distance: np.ndarray) -> Iterator[str]:
    """Yields what in the median distances (21, 21) of keypoints contradicts the expected order.

    Of 300 synthetic people as devices see them, in any posture, no 30 frames contradict it, and two single
    frames do. All of their wrong orders in `tests/test_people_checks.py` do.
    """
    knuckles = distance[0, _KNUCKLES]
    if distance[0, 1] > min(0.9 * knuckles.min(), distance[0, 2]):
        yield "keypoint 1, the thumb's base, is not nearer to the wrist than keypoint 2 and the knuckles are"
    if knuckles.min() < 0.65 * knuckles.max():
        yield "the knuckles 5, 9, 13 and 17 are not about equally far from the wrist"
    paths = {order: sum(distance[a, b] for a, b in pairwise(order)) for order in permutations(_KNUCKLES)}
    if min(paths.values()) < 0.96 * paths[_KNUCKLES]:
        yield "the knuckles 5, 9, 13 and 17 do not follow each other across the palm"
    if distance[2, 5] > 1.3 * distance[2, 17]:
        yield "keypoint 2, of the thumb, is nearer to 17, the little finger, than to 5, the index finger"
    longest = max((bone for bone in BONES if bone[0] != 0), key=lambda bone: distance[bone])
    if distance[longest] > 0.95 * distance[0, 9]:
        yield f"{longest[0]} and {longest[1]}, the ends of a finger's bone, are nearly a palm apart"
    for finger, chain in FINGER_KEYPOINTS.items():
        if finger != "thumb" and distance[chain[0], chain[1]] < 0.75 * distance[chain[2], chain[3]]:
            yield f"the bone {chain[0]}–{chain[1]} at the {finger}'s base is shorter than that at its tip"
        # Even in a fist, a joint is slightly farther from the joint after the next than from the next.
        for a, b, c in zip(chain, chain[1:], chain[2:], strict=False):
            if distance[a, c] < 0.94 * distance[a, b]:
                yield f"keypoint {c}, of the {finger}, is nearer to {a} than {b}, which lies between them"


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


def _finite(recording: Recording) -> np.ndarray:
    p = recording.p_HK[recording.valid].astype(float)
    p = p[np.isfinite(p).all(axis=(1, 2))]
    if not len(p):
        raise RecordingError("no frame is valid and has finite keypoints (p_HK)")
    return p


def _gaps(recording: Recording) -> Iterator[str]:
    step = np.diff(recording.t)
    missing = int((np.round(step / np.median(step)) - 1).clip(0).sum())
    if step.max() > _GAP_S or missing > _MISSING_FRACTION * (len(step) + missing):
        frame = int(np.argmax(step)) + 1
        yield (
            f"{missing} frames are missing, the longest gap is {step.max():.2f} s before frame {frame}; "
            "check the radio link and the recorder's load"
        )
    # Rounding errors when the wrist moves are smaller; a glove's jitter is 0.05 mm.
    same: np.ndarray = np.abs(np.diff(recording.p_HK, axis=0)).max(axis=(1, 2)) < 2e-7
    if same.mean() > 0.5:
        raise RecordingError(
            f"{same.sum()} of {len(recording)} frames repeat the one before (p_HK): a frozen signal"
        )
    if same.mean() > 0.02:
        yield f"{same.sum()} of {len(recording)} frames repeat the one before; training ignores them"


def _not_finite(recording: Recording) -> np.ndarray:
    bad = ~np.isfinite(recording.p_HK).all(axis=(1, 2))
    if recording.X_WH is not None:
        norm = np.linalg.norm(recording.X_WH[:, :4], axis=1)
        bad |= ~np.isfinite(recording.X_WH).all(axis=1) | (np.abs(norm - 1.0) > NORM_TOLERANCE)
    return bad


def _off_frame(p_HK: np.ndarray) -> np.ndarray:
    """Returns the largest distance (T,), m, of keypoints p_HK (T, 21, 3) from their places in H; or inf."""
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.linalg.norm(to_wrist_frame(p_HK) - p_HK, axis=-1).max(axis=1)
    return np.where(np.isfinite(off), off, np.inf)


def _other_bones(recording: Recording) -> np.ndarray:
    length = bone_lengths(recording.p_HK)
    median = np.median(bone_lengths(_finite(recording)), axis=0)
    outlier = ~(np.abs(length - median) <= _BONE_DEVIATION * median + _BONE_DEVIATION_M).all(axis=1)
    # Where bones vary as much as this in many frames, their spread tells more.
    return outlier if outlier[recording.valid].mean() <= MAX_LOST else np.zeros_like(outlier)


def _spikes(recording: Recording) -> np.ndarray:
    p = recording.p_HK.astype(float)
    off = np.linalg.norm(p[1:-1] - 0.5 * (p[:-2] + p[2:]), axis=-1)
    across = np.linalg.norm(p[2:] - p[:-2], axis=-1)
    usable = recording.valid[1:-1] & recording.valid[:-2] & recording.valid[2:]
    highest = np.where((off > _SPIKE_M) & (across < 0.5 * off) & usable[:, None], off, 0.0).max(
        axis=1, initial=0
    )
    # The frames next to a spike deviate as well, by half as much.
    beside = np.maximum(np.append(highest[1:], 0.0), np.append(0.0, highest[:-1]))[: len(highest)]
    spikes = np.zeros(len(p), bool)
    spikes[1:-1] = (highest > 0.0) & (highest >= beside)
    return spikes
