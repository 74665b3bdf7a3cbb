"""Checks of what a hand does in a recording: enough frames, moving signals, pinches, wide motions."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.keypoints import FINGER_KEYPOINTS, FINGER_NAMES, TIP_KEYPOINT
from geort_drake.people.range_of_motion import narrow_motions
from geort_drake.people.recording import PINCH_M, Recording
from geort_drake.people.summary import pinch_distances

_TRAINING_FRAMES = 300
_STILL_M = 1e-3
_STUCK_DEG = 0.05


def check_frozen(recording: Recording) -> Iterator[Finding]:
    """Every fingertip moves, and every joint of a finger bends."""
    p_HF = recording.fingertips()
    if len(p_HF) < _TRAINING_FRAMES:
        return
    travel = np.linalg.norm(p_HF.std(axis=0), axis=-1)
    still = [finger for finger, value in zip(FINGER_NAMES, travel, strict=True) if value < _STILL_M]
    if still:
        yield Finding(
            "constant signal",
            Severity.ERROR,
            f"frozen signal: the tip of {', '.join(still)} moves by less than {1e3 * _STILL_M:.0f} mm in "
            f"{recording.duration_s:.1f} s",
            f"p_HK[:, {TIP_KEYPOINT[still[0]]}]",
            "look at the glove's sensor of that finger",
        )
        return
    for finger, chain in FINGER_KEYPOINTS.items():
        p = recording.p_HK[recording.valid][:, chain].astype(float)
        bones = np.diff(p, axis=1)
        bones /= np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-12)
        bend = np.degrees(np.arccos(np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)))
        for joint in np.flatnonzero(bend.std(axis=0) < _STUCK_DEG):
            yield Finding(
                "constant signal",
                Severity.WARNING,
                f"the {finger} does not bend at keypoint {chain[joint + 1]} in {recording.duration_s:.1f} s",
                f"p_HK[:, {chain[joint + 1]}]",
                "look at the glove's sensor of that joint",
            )


def check_frames(recording: Recording) -> Iterator[Finding]:
    """As many frames as training needs."""
    valid = int(recording.valid.sum())
    if valid < _TRAINING_FRAMES:
        yield Finding(
            "length",
            Severity.UNFIT,
            f"{valid} valid frames, training needs at least {_TRAINING_FRAMES}",
            "valid",
            "record five minutes",
        )


def check_pinches(recording: Recording) -> Iterator[Finding]:
    """The thumb's tip meets those of the other fingers."""
    distance = pinch_distances(recording)
    never = {finger: float(d.min()) for finger, d in distance.items() if d.min() >= PINCH_M}
    nearest = ", ".join(f"{finger} ({1e3 * d:.0f} mm)" for finger, d in never.items())
    if len(never) == len(distance):
        yield Finding(
            "pinches",
            Severity.UNFIT,
            f"no pinch: the thumb tip never comes within {1e3 * PINCH_M:.0f} mm of another fingertip; "
            f"nearest: {nearest}",
            "p_HK",
            "pinch each finger a few times while recording",
        )
    elif never:
        yield Finding(
            "pinches",
            Severity.WARNING,
            f"the thumb never comes within {1e3 * PINCH_M:.0f} mm of: {nearest}",
            "p_HK",
            "pinch that finger too",
        )


def check_range(recording: Recording) -> Iterator[Finding]:
    """Each finger moves far enough to learn from."""
    for sentence in narrow_motions(recording.p_HK[recording.valid], list(TIP_KEYPOINT.values())):
        what, _, advice = sentence.rpartition(": ")
        yield Finding("narrow motion", Severity.ADVICE, what, "p_HK", advice)
