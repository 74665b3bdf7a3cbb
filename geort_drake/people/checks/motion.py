"""Checks of how a hand moves in a recording: jumps, frozen joints, and what training needs."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, Severity, error, warning
from geort_drake.people.coverage import pinch_distances
from geort_drake.people.keypoints import FINGER_KEYPOINTS, WRIST
from geort_drake.people.recording import PINCH_M, Recording

_TRAINING_FRAMES = 300
_STUCK_DEG = 0.05  # standard deviation of a joint's angle, below which it counts as stuck
# In a spike, a keypoint moves by more than this and returns in the next frame. This is ten times a glove's
# jitter; two people's free play at 30 and 118 Hz contains no such frame.
_SPIKE_M = 0.02
_JUMP_M = 0.05
_JUMP_RATIO = 5.0  # of a jump to the steps before and after it; fast motion has a smaller one
_MAX_WRIST_M_S = 10.0  # an arm reaches this speed in a throw


def check_spikes(recording: Recording) -> Iterator[Finding]:
    """Finds single frames in which a keypoint jumps away and back; they become invalid."""
    p = recording.p_HK.astype(float)
    off = np.linalg.norm(p[1:-1] - 0.5 * (p[:-2] + p[2:]), axis=-1)
    across = np.linalg.norm(p[2:] - p[:-2], axis=-1)
    usable = recording.valid[1:-1] & recording.valid[:-2] & recording.valid[2:]
    height = np.where((off > _SPIKE_M) & (across < 0.5 * off) & usable[:, None], off, 0.0)
    highest = height.max(axis=1, initial=0.0)
    # The frames next to a spike deviate as well, by half as much.
    adjacent = np.maximum(np.append(highest[1:], 0.0), np.append(0.0, highest[:-1]))
    frames = np.flatnonzero((highest > 0.0) & (highest >= adjacent)) + 1
    if len(frames):
        worst = int(frames[np.argmax(highest[frames - 1])])
        what = f"in {len(frames)} single frames a keypoint jumps away and back, the farthest by "
        what += f"{1e3 * highest[worst - 1]:.0f} mm"
        where = f"p_HK[{worst}, {int(np.argmax(height[worst - 1]))}]"
        yield warning("jumps", what, where, "marked invalid", frames.tolist())


def check_jumps(recording: Recording) -> Iterator[Finding]:
    """Finds impossible steps of fingers, as between joined recordings, and impossible speeds of the wrist."""
    both = recording.valid[1:] & recording.valid[:-1]
    step = np.linalg.norm(np.diff(recording.p_HK.astype(float), axis=0), axis=-1)
    adjacent = np.maximum(step[:-2], step[2:])
    jump = (step[1:-1] > _JUMP_M) & (step[1:-1] > _JUMP_RATIO * adjacent)
    jump &= (both[1:-1] & both[:-2] & both[2:])[:, None]
    frames = np.flatnonzero(jump.any(axis=1)) + 2
    if len(frames):
        size = 1e3 * step[frames[0] - 1].max()
        what = f"{len(frames)} jumps in otherwise smooth motion, the first by {size:.0f} mm"
        advice = "check for lost frames or joined recordings there"
        yield warning("jumps", what, f"p_HK[{frames[0]}]", advice)
    if recording.X_WH is None:
        return
    speed = np.linalg.norm(np.diff(recording.X_WH[:, 4:], axis=0), axis=-1) / np.diff(recording.t)
    fast = np.flatnonzero((speed > _MAX_WRIST_M_S) & both) + 1
    if len(fast):
        what = f"the wrist jumps {len(fast)} times, the first at {speed[fast[0] - 1]:.0f} m/s"
        advice = "check whether the tracker lost its base stations or restarted"
        yield warning("jumps", what, f"X_WH[{fast[0]}]", advice)


def check_frozen(recording: Recording) -> Iterator[Finding]:
    """Checks that every joint of every finger bends."""
    p_HK = recording.p_HK[recording.valid].astype(float)
    if len(p_HK) < _TRAINING_FRAMES:
        return
    for finger, chain in FINGER_KEYPOINTS.items():
        bones = np.diff(p_HK[:, (WRIST, *chain)], axis=1)
        bones /= np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-12)
        bend = np.degrees(np.arccos(np.clip((bones[:, 1:] * bones[:, :-1]).sum(-1), -1.0, 1.0)))
        stuck = [chain[joint] for joint in np.flatnonzero(bend.std(axis=0) < _STUCK_DEG)]
        if stuck:
            kind = error if len(stuck) == bend.shape[1] else warning
            what = f"the {finger} never bends at keypoints {', '.join(map(str, stuck))}"
            where = f"p_HK[:, {stuck[0]}]"
            yield kind("constant signal", what, where, "check the glove's sensor of that finger")


def check_training(recording: Recording) -> Iterator[Finding]:
    """Checks that there are enough frames and pinches for training."""
    valid = int(recording.valid.sum())
    if valid < _TRAINING_FRAMES:
        what = f"{valid} valid frames, training needs at least {_TRAINING_FRAMES}"
        yield Finding("length", Severity.UNFIT, what, "valid", "record five minutes")
    least = {finger: float(d.min()) for finger, d in pinch_distances(recording).items()}
    never = [f"{finger} ({1e3 * d:.0f} mm)" for finger, d in least.items() if d >= PINCH_M]
    if never:
        what = f"the thumb never comes within {1e3 * PINCH_M:.0f} mm of: {', '.join(never)}"
        severity = Severity.UNFIT if len(never) == len(least) else Severity.WARNING
        yield Finding("pinches", severity, what, "p_HK", "pinch each finger a few times while recording")
