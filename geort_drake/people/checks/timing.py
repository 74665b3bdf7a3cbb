"""Checks of the frames' times and of the motion between frames: clock, gaps, repeats and jumps."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, error, lost_frames, warning
from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.people.recording import Recording

TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
_TIME_UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "µs": "microseconds", "ns": "nanoseconds"}
_RATE_HZ = (2.0, 2000.0)
_GAP_S = 0.2
_MISSING_SHARE = 0.05  # a glove at 118 Hz over radio loses 4 %
_FROZEN_S = 0.5
_REPEATED_SHARE = 0.02
_SAME_M = 2e-7  # what rounding leaves of a still hand when the wrist moves; a glove's jitter is 0.05 mm
# In a spike, a keypoint leaves by more than this and is back in the next frame. It is ten times a glove's
# jitter; two people's free play at 30 and 118 Hz holds no such frame.
_SPIKE_M = 0.02
_JUMP_M = 0.05
_JUMP_RATIO = 5.0  # of a jump to the steps before and after it, which separates it from fast motion
_WRIST_M_S = 10.0  # an arm throws at that speed


def check_length(recording: Recording) -> Iterator[Finding]:
    """At least two frames."""
    if len(recording) < 2:
        yield error("length", f"at least 2 frames are needed, {len(recording)} given", "t")


def check_clock(recording: Recording) -> Iterator[Finding]:
    """Times are finite, increase, and are in the unit of the format."""
    t = recording.t
    bad = ~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0)
    if bad.any():
        frame = int(np.argmax(bad))
        what = f"t must increase, but frame {frame} has {t[frame]:.6f} s"
        what += f" after {t[frame - 1]:.6f} s" if frame else ""
        yield error("clock", what, f"t[{frame}]", "give every frame its own time, in order")
        return
    rate = 1.0 / float(np.median(np.diff(t)))
    if not _RATE_HZ[0] <= rate <= _RATE_HZ[1]:
        # A file that was just read states field and unit; in our own, t is in seconds.
        field, unit = recording.metadata.get("time_field", "t"), recording.metadata.get("time_unit", "s")
        if unit not in TIME_UNITS_S:
            field, unit = "t", "s"
        expected = f"{field} must be in {_TIME_UNIT_NAMES[unit]}"
        rates = {other: rate * TIME_UNITS_S[unit] / TIME_UNITS_S[other] for other in TIME_UNITS_S}
        fits = [other for other in rates if other != unit and 10 <= rates[other] <= 1000]
        what = f"{expected}, with {_RATE_HZ[0]:g} to {_RATE_HZ[1]:g} frames per second, but gives {rate:.3g}"
        what += f"; it would be right if the numbers were {_TIME_UNIT_NAMES[fits[0]]}" if fits else ""
        yield error("clock", what, field, f"give {field} in {_TIME_UNIT_NAMES[unit]}")


def check_lost(recording: Recording) -> Iterator[Finding]:
    """Frames that are not finite numbers become invalid; some frames must be left."""
    known = np.isfinite(recording.p_HK).all(axis=2)
    never = np.flatnonzero(~known.any(axis=0))
    if 0 < len(never) < known.shape[1]:
        named = ", ".join(_named(int(keypoint)) for keypoint in never)
        what = (
            f"{named} {'is' if len(never) == 1 else 'are'} lost in all {len(recording)} frames; every frame "
        )
        advice = "check that finger's sensor, and what the recorder leaves out"
        yield error("lost frames", f"{what}needs all 21 keypoints", "p_HK", advice)
        return
    bad, field = recording.valid & ~known.all(axis=1), "p_HK"
    if recording.X_WH is not None:
        poses = recording.valid & ~np.isfinite(recording.X_WH).all(axis=1)
        field = "X_WH" if poses.any() and not bad.any() else field
        bad = bad | poses
    lost = np.flatnonzero(bad)
    valid = int((recording.valid & ~bad).sum())
    if len(lost):
        yield lost_frames(lost.tolist(), len(bad), "are not finite numbers", where=f"{field}[{lost[0]}]")
    elif valid < 2:
        yield error("lost frames", f"only {valid} of {len(recording)} frames are valid", "valid")


def check_dropped(recording: Recording) -> Iterator[Finding]:
    """Frames that are missing between others, by the median period."""
    step = np.diff(recording.t)
    missing = int((np.round(step / np.median(step)) - 1).clip(0).sum())
    count = len(step) + missing
    gaps, frame = int((step > _GAP_S).sum()), int(np.argmax(step)) + 1
    longest = f"the longest {step.max():.2f} s before frame {frame}"
    if gaps:
        what, advice = f"{gaps} gaps in time, {longest}", "a replay interpolates across them"
    elif missing > _MISSING_SHARE * count:
        what = f"{missing} frames are missing in {count + 1} ({100 * missing / count:.0f} %), {longest}"
        advice = "check the radio link and the recorder's load"
    else:
        return
    yield warning("dropped frames", what, f"t[{frame}]", advice)


def check_repeats(recording: Recording) -> Iterator[Finding]:
    """Frames that repeat the one before: a stalled sensor, or a recorder faster than the glove."""
    same: np.ndarray = np.abs(np.diff(recording.p_HK, axis=0)).max(axis=(1, 2)) < _SAME_M
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    held = recording.t[ends] - recording.t[starts]
    frozen = held[held > _FROZEN_S].sum()
    if frozen:
        longest = int(np.argmax(held))
        what = f"frozen signal: frames repeat for {held[longest]:.1f} s from frame {starts[longest]}, "
        what += f"{frozen:.1f} s of {recording.duration_s:.1f} s in all"
        kind = error if frozen > 0.5 * recording.duration_s else warning
        yield kind("constant signal", what, f"p_HK[{starts[longest]}]", "check that the glove was connected")
    elif same.sum() > _REPEATED_SHARE * len(same):
        first = int(np.argmax(same)) + 1
        what = (
            f"{int(same.sum())} of {len(recording)} frames repeat the one before exactly, the first is frame "
        )
        advice = "training ignores them; record at the glove's own rate"
        yield warning("duplicated frames", f"{what}{first}", f"p_HK[{first}]", advice)


def check_spikes(recording: Recording) -> Iterator[Finding]:
    """Single frames in which a keypoint is somewhere else become invalid."""
    p = recording.p_HK.astype(float)
    off = np.linalg.norm(p[1:-1] - 0.5 * (p[:-2] + p[2:]), axis=-1)
    across = np.linalg.norm(p[2:] - p[:-2], axis=-1)
    usable = recording.valid[1:-1] & recording.valid[:-2] & recording.valid[2:]
    height = np.where((off > _SPIKE_M) & (across < 0.5 * off) & usable[:, None], off, 0.0)
    highest = height.max(axis=1, initial=0.0)
    # The frames beside a spike differ from their neighbours as well, by half as much.
    beside = np.maximum(np.append(highest[1:], 0.0), np.append(0.0, highest[:-1]))
    frames = np.flatnonzero((highest > 0.0) & (highest >= beside)) + 1
    if len(frames):
        worst = int(frames[np.argmax(highest[frames - 1])])
        keypoint = int(np.argmax(height[worst - 1]))
        what = f"in {len(frames)} single frames a keypoint jumps away and back, the farthest by "
        what += f"{1e3 * highest[worst - 1]:.0f} mm: {_named(keypoint)} in frame {worst}"
        yield warning("jumps", what, f"p_HK[{worst}, {keypoint}]", "marked invalid", frames.tolist())


def check_jumps(recording: Recording) -> Iterator[Finding]:
    """Steps that no finger makes, as where two recordings were joined, and wrists that fly."""
    both = recording.valid[1:] & recording.valid[:-1]
    step = np.linalg.norm(np.diff(recording.p_HK.astype(float), axis=0), axis=-1)
    beside = np.maximum(step[:-2], step[2:])
    jump = (step[1:-1] > _JUMP_M) & (step[1:-1] > _JUMP_RATIO * beside)
    jump &= (both[1:-1] & both[:-2] & both[2:])[:, None]
    frames = np.flatnonzero(jump.any(axis=1)) + 2
    if len(frames):
        size = np.where(jump, step[1:-1], 0.0)[frames[0] - 2]
        keypoint = int(np.argmax(size))
        what = f"{len(frames)} jumps in otherwise smooth motion, the first by "
        what += f"{1e3 * size[keypoint]:.0f} mm before frame {frames[0]}: {_named(keypoint)}"
        advice = "check for lost frames or joined recordings there"
        yield warning("jumps", what, f"p_HK[{frames[0]}, {keypoint}]", advice)
    if recording.X_WH is None:
        return
    speed = np.linalg.norm(np.diff(recording.X_WH[:, 4:], axis=0), axis=-1) / np.diff(recording.t)
    fast = np.flatnonzero((speed > _WRIST_M_S) & both) + 1
    if len(fast):
        what = f"the wrist jumps {len(fast)} times, the first before frame {fast[0]}, at "
        what += f"{speed[fast[0] - 1]:.0f} m/s"
        advice = "check whether the tracker lost its base stations or restarted"
        yield warning("jumps", what, f"X_WH[{fast[0]}]", advice)


def _named(keypoint: int) -> str:
    finger = next((name for name, chain in FINGER_KEYPOINTS.items() if keypoint in chain), "wrist")
    return f"keypoint {keypoint} ({finger})"
