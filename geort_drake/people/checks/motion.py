"""Checks of the motion in a recording: enough frames, moving signals, pinches, wide motions."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, Severity, error, warning
from geort_drake.people.coverage import narrow_motions, pinch_distances
from geort_drake.people.keypoints import FINGER_KEYPOINTS, TIP_KEYPOINT
from geort_drake.people.recording import PINCH_M, Recording

_TRAINING_FRAMES = 300
_STILL_M = 1e-3
_STUCK_DEG = 0.05


def check_frozen(recording: Recording) -> Iterator[Finding]:
    """Every fingertip moves, and every joint of a finger bends."""
    p_HK = recording.p_HK[recording.valid].astype(float)
    if len(p_HK) < _TRAINING_FRAMES:
        return
    duration = f"in {recording.duration_s:.1f} s"
    travel = np.linalg.norm(p_HK.std(axis=0), axis=-1)
    if still := [finger for finger, tip in TIP_KEYPOINT.items() if travel[tip] < _STILL_M]:
        what = f"frozen signal: the tip of {', '.join(still)} moves by less than {1e3 * _STILL_M:.0f} mm "
        what, where = what + duration, f"p_HK[:, {TIP_KEYPOINT[still[0]]}]"
        yield error("constant signal", what, where, "check the glove's sensor for that finger")
        return
    for finger, chain in FINGER_KEYPOINTS.items():
        bones = np.diff(p_HK[:, chain], axis=1)
        bones /= np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-12)
        bend = np.degrees(np.arccos(np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)))
        for joint in np.flatnonzero(bend.std(axis=0) < _STUCK_DEG):
            keypoint = chain[joint + 1]
            what = f"the {finger} does not bend at keypoint {keypoint} {duration}"
            yield warning(
                "constant signal", what, f"p_HK[:, {keypoint}]", "check the glove's sensor for that joint"
            )


def check_frames(recording: Recording) -> Iterator[Finding]:
    """As many frames as training needs."""
    valid = int(recording.valid.sum())
    if valid < _TRAINING_FRAMES:
        what = f"{valid} valid frames, training needs at least {_TRAINING_FRAMES}"
        yield Finding("length", Severity.UNFIT, what, "valid", "record five minutes")


def check_pinches(recording: Recording) -> Iterator[Finding]:
    """The thumb's tip meets those of the other fingers."""
    least = {finger: float(d.min()) for finger, d in pinch_distances(recording).items()}
    never = [f"{finger} ({1e3 * d:.0f} mm)" for finger, d in least.items() if d >= PINCH_M]
    near = f"within {1e3 * PINCH_M:.0f} mm of"
    if len(never) == len(least):
        what = f"no pinch: the thumb tip never comes {near} another fingertip; closest: {', '.join(never)}"
        advice = "pinch each finger a few times while recording"
        yield Finding("pinches", Severity.UNFIT, what, "p_HK", advice)
    elif never:
        what = f"the thumb never comes {near}: {', '.join(never)}"
        yield warning("pinches", what, "p_HK", "pinch that finger too")


def check_range(recording: Recording) -> Iterator[Finding]:
    """Each finger moves far enough to learn from."""
    for sentence in narrow_motions(recording.p_HK[recording.valid], list(TIP_KEYPOINT.values())):
        what, _, advice = sentence.rpartition(": ")
        yield Finding("narrow motion", Severity.ADVICE, what, "p_HK", advice)
