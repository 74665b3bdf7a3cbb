"""Checks of when frames were taken: clocks, gaps, repeats and jumps."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, Severity, lost_frames
from geort_drake.people.keypoints import FINGER_KEYPOINTS
from geort_drake.people.recording import Recording

# Units of times: how long they are, s, and what they are called.
TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
_TIME_UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "µs": "microseconds", "ns": "nanoseconds"}
_RATE_HZ = (2.0, 2000.0)
_GAP_S = 0.2
_MISSING_SHARE = 0.05  # a glove at 118 Hz over radio loses 4 %
_FROZEN_S = 0.5
_REPEATED_SHARE = 0.02
_SAME_M = 2e-7  # what rounding leaves of a still hand when the wrist moves; a glove's jitter is 0.05 mm
# A frame is a spike where a keypoint leaves by more than this and is back in the next frame: ten
# times the glove's jitter. Two people's free play at 30 and 118 Hz holds no such frame.
_SPIKE_M = 0.02
_JUMP_M = 0.05
_JUMP_RATIO = 5.0  # of a jump to the steps before and after it, which separates it from fast motion
_WRIST_M_S = 10.0  # an arm throws at that speed


def check_length(recording: Recording) -> Iterator[Finding]:
    """At least two frames."""
    if len(recording) < 2:
        yield Finding("length", Severity.ERROR, f"at least 2 frames are needed, {len(recording)} given", "t")


def check_clock(recording: Recording) -> Iterator[Finding]:
    """Times are finite, increase, and are in the unit that the format says."""
    t = recording.t
    if not np.isfinite(t).all():
        frame = int(np.argmin(np.isfinite(t)))
        yield Finding("clock", Severity.ERROR, f"t is not a finite number in frame {frame}", f"t[{frame}]")
        return
    step = np.diff(t)
    if step.min() <= 0:
        frame = int(np.argmax(step <= 0)) + 1
        yield Finding(
            "clock",
            Severity.ERROR,
            f"t must increase, but frame {frame} has {t[frame]:.6f} s after {t[frame - 1]:.6f} s",
            f"t[{frame}]",
            "sort the frames by time, and give every frame its own",
        )
        return
    rate = 1.0 / float(np.median(step))
    if not _RATE_HZ[0] <= rate <= _RATE_HZ[1]:
        # Of a file that was just read; in our own, t is in seconds.
        field, unit = recording.metadata.get("time_field", "t"), recording.metadata.get("time_unit", "s")
        if unit not in TIME_UNITS_S:
            field, unit = "t", "s"
        wanted = _TIME_UNIT_NAMES[unit]
        fits = [
            name
            for other, name in _TIME_UNIT_NAMES.items()
            if other != unit and 10 <= rate * TIME_UNITS_S[unit] / TIME_UNITS_S[other] <= 1000
        ]
        yield Finding(
            "clock",
            Severity.ERROR,
            f"{field} must be in {wanted}, with {_RATE_HZ[0]:g} to {_RATE_HZ[1]:g} frames in a second, but "
            f"gives {rate:.3g}" + (f"; it would be right if the numbers were {fits[0]}" if fits else ""),
            field,
            f"give {field} in {wanted}",
        )


def check_dropped(recording: Recording) -> Iterator[Finding]:
    """Frames that are missing between those that are there, by the median period."""
    step = np.diff(recording.t)
    missing = int((np.round(step / np.median(step)) - 1).clip(0).sum())
    gaps, frame = int((step > _GAP_S).sum()), int(np.argmax(step)) + 1
    longest = f"the longest {step.max():.2f} s before frame {frame}"
    if gaps:
        yield Finding(
            "dropped frames", Severity.WARNING, f"{gaps} gaps in time, {longest}", f"t[{frame}]",
            "a replay interpolates across them",
        )  # fmt: skip
    elif missing > _MISSING_SHARE * (len(step) + missing):
        yield Finding(
            "dropped frames",
            Severity.WARNING,
            f"{missing} frames are missing in {len(recording) + missing} "
            f"({100 * missing / (len(step) + missing):.0f} %), {longest}",
            f"t[{frame}]",
            "look at the radio link or the recorder's load",
        )


def check_lost(recording: Recording) -> Iterator[Finding]:
    """Frames that are not finite numbers become invalid; some frames must be left."""
    bad = recording.valid & ~np.isfinite(recording.p_HK).all(axis=(1, 2))
    field = "p_HK"
    if recording.X_WH is not None:
        poses = recording.valid & ~np.isfinite(recording.X_WH).all(axis=1)
        field = "X_WH" if poses.any() and not bad.any() else field
        bad = bad | poses
    lost = np.flatnonzero(bad)
    if missing := _missing(recording):
        yield Finding(
            "lost frames",
            Severity.ERROR,
            f"{missing} in all {len(bad)} frames; every frame needs all 21 keypoints",
            "p_HK",
            "look at that finger's sensor, or at what the recorder leaves out",
        )
    elif len(lost):
        yield lost_frames(lost.tolist(), len(bad), "are not finite numbers", where=f"{field}[{lost[0]}]")
    valid = int((recording.valid & ~bad).sum())
    if valid < 2 and not len(lost):
        what = f"only {valid} of {len(recording)} frames are valid"
        yield Finding("lost frames", Severity.ERROR, what, "valid")


def _missing(recording: Recording) -> str:
    """Which keypoints no frame has, in words; empty where there are none, or no keypoint at all."""
    known = np.isfinite(recording.p_HK).all(axis=2)
    never = np.flatnonzero(~known.any(axis=0))
    if len(never) in (0, known.shape[1]):
        return ""
    named = ", ".join(_named(int(keypoint)) for keypoint in never)
    return f"{named} {'is' if len(never) == 1 else 'are'} lost"


def check_repeats(recording: Recording) -> Iterator[Finding]:
    """Frames that repeat the one before: a stalled sensor, or a recorder faster than the glove."""
    same: np.ndarray = np.abs(np.diff(recording.p_HK, axis=0)).max(axis=(1, 2)) < _SAME_M
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    held = recording.t[ends] - recording.t[starts]
    long = held > _FROZEN_S
    if long.any():
        longest = int(np.argmax(held))
        most = held[long].sum() > 0.5 * recording.duration_s
        yield Finding(
            "constant signal",
            Severity.ERROR if most else Severity.WARNING,
            f"frozen signal: frames repeat for {held[longest]:.1f} s from frame {starts[longest]}, "
            f"{held[long].sum():.1f} s of {recording.duration_s:.1f} s in all",
            f"p_HK[{starts[longest]}]",
            "look whether the glove was connected",
        )
    elif same.sum() > _REPEATED_SHARE * len(same):
        first = int(np.argmax(same)) + 1
        yield Finding(
            "duplicated frames",
            Severity.WARNING,
            f"{int(same.sum())} of {len(recording)} frames repeat the one before exactly, the first is "
            f"frame {first}",
            f"p_HK[{first}]",
            "training and speeds leave them out; record at the glove's own rate",
        )


def check_spikes(recording: Recording) -> Iterator[Finding]:
    """Single frames in which a keypoint is somewhere else; they become invalid."""
    p = recording.p_HK.astype(float)
    off = np.linalg.norm(p[1:-1] - 0.5 * (p[:-2] + p[2:]), axis=-1)
    across = np.linalg.norm(p[2:] - p[:-2], axis=-1)
    usable = recording.valid[1:-1] & recording.valid[:-2] & recording.valid[2:]
    spike = (off > _SPIKE_M) & (across < 0.5 * off) & usable[:, None]
    # The frames beside a spike differ from their neighbours as well, by half as much.
    height = np.where(spike, off, 0.0).max(axis=1, initial=0.0)
    beside = np.maximum(np.append(height[1:], 0.0), np.append(0.0, height[:-1]))
    frames = np.flatnonzero(spike.any(axis=1) & (height >= beside)) + 1
    if len(frames):
        worst = int(frames[np.argmax(height[frames - 1])])
        keypoint = int(np.argmax(np.where(spike, off, 0.0)[worst - 1]))
        yield Finding(
            "jumps",
            Severity.WARNING,
            f"in {len(frames)} single frames a keypoint jumps away and back, the farthest by "
            f"{1e3 * height[worst - 1]:.0f} mm: {_named(keypoint)} in frame {worst}",
            f"p_HK[{worst}, {keypoint}]",
            "marked invalid",
            tuple(frames.tolist()),
        )


def check_jumps(recording: Recording) -> Iterator[Finding]:
    """Steps that no finger makes, as where two recordings were joined, and wrists that fly."""
    both = recording.valid[1:] & recording.valid[:-1]
    step = np.linalg.norm(np.diff(recording.p_HK.astype(float), axis=0), axis=-1)
    beside = np.maximum(step[:-2], step[2:])
    jump = (step[1:-1] > _JUMP_M) & (step[1:-1] > _JUMP_RATIO * beside)
    jump &= (both[1:-1] & both[:-2] & both[2:])[:, None]
    frames = np.flatnonzero(jump.any(axis=1)) + 2
    if len(frames):
        size = np.where(jump, step[1:-1], 0.0)
        keypoint = int(np.argmax(size[frames[0] - 2]))
        yield Finding(
            "jumps",
            Severity.WARNING,
            f"{len(frames)} jumps between frames that are otherwise smooth, the first by "
            f"{1e3 * size[frames[0] - 2, keypoint]:.0f} mm before frame {frames[0]}: {_named(keypoint)}",
            f"p_HK[{frames[0]}, {keypoint}]",
            "look whether frames were lost or recordings joined there",
        )
    if recording.X_WH is None:
        return
    speed = np.linalg.norm(np.diff(recording.X_WH[:, 4:], axis=0), axis=-1) / np.diff(recording.t)
    fast = np.flatnonzero((speed > _WRIST_M_S) & both) + 1
    if len(fast):
        yield Finding(
            "jumps",
            Severity.WARNING,
            f"the wrist jumps {len(fast)} times, the first before frame {fast[0]}, at "
            f"{speed[fast[0] - 1]:.0f} m/s",
            f"X_WH[{fast[0]}]",
            "look whether the tracker lost its base stations or started anew",
        )


def _named(keypoint: int) -> str:
    finger = next((name for name, chain in FINGER_KEYPOINTS.items() if keypoint in chain), "wrist")
    return f"keypoint {keypoint} ({finger})"
