"""Checks of the frames' times: clock, lost frames, gaps and repeats."""

from collections.abc import Iterator

import numpy as np

from geort_drake.people.checks.findings import Finding, error, lost_frames, warning
from geort_drake.people.recording import Recording

_RATE_HZ = (2.0, 2000.0)  # plausible range
_GAP_S = 0.2
_MISSING_FRACTION = 0.05  # a glove at 118 Hz over radio loses 4 %
_FROZEN_S = 0.5
_REPEATED_FRACTION = 0.02
_REPEAT_TOLERANCE_M = 2e-7  # rounding errors when the wrist moves; a glove's jitter is 0.05 mm


def check_clock(recording: Recording) -> Iterator[Finding]:
    """Checks that there are frames, and that their times increase at a plausible rate."""
    t = recording.t
    if len(t) < 2:
        yield error("length", f"at least 2 frames are needed, {len(t)} given", "t")
        return
    bad = ~np.isfinite(t) | (np.diff(t, prepend=-np.inf) <= 0)
    if bad.any():
        frame = int(np.argmax(bad))
        what = f"times must be finite and increase, but frame {frame} has {t[frame]:.6f} s"
        yield error("clock", what, f"t[{frame}]", "give every frame its own time, in order")
        return
    low, high = _RATE_HZ
    if not low <= recording.rate_hz <= high:
        what = f"times must give {low:g} to {high:g} frames in a second, but give {recording.rate_hz:.3g}"
        factors = (10.0**power for power in (-9, -6, -3, 3, 6, 9))
        fit = next((factor for factor in factors if 10 <= recording.rate_hz / factor <= 1000), None)
        advice = f"it would be right if times were multiplied by {fit:g}: check their unit" if fit else ""
        yield error("clock", what, "t", advice)


def check_lost(recording: Recording) -> Iterator[Finding]:
    """Marks frames that are not finite numbers as invalid; at least two must be left."""
    known = np.isfinite(recording.p_HK).all(axis=2)
    never = np.flatnonzero(~known.any(axis=0)).tolist()
    if 0 < len(never) < known.shape[1]:
        what = f"keypoints {', '.join(map(str, never))} are lost in all {len(recording)} frames"
        yield error("lost frames", what, "p_HK", "check that finger's sensor")
        return
    finite = known.all(axis=1)
    if recording.X_WH is not None:
        finite = finite & np.isfinite(recording.X_WH).all(axis=1)
    lost = np.flatnonzero(recording.valid & ~finite)
    valid = int((recording.valid & finite).sum())
    if len(lost):
        yield lost_frames(lost.tolist(), len(recording), "are not finite numbers")
    elif valid < 2:
        yield error("lost frames", f"only {valid} of {len(recording)} frames are valid", "valid")


def check_dropped(recording: Recording) -> Iterator[Finding]:
    """Finds gaps between frames, measured in median periods."""
    step = np.diff(recording.t)
    missing = int((np.round(step / np.median(step)) - 1).clip(0).sum())
    count = len(step) + missing
    gaps, frame = int((step > _GAP_S).sum()), int(np.argmax(step)) + 1
    if gaps or missing > _MISSING_FRACTION * count:
        what = f"{missing} frames are missing in {count + 1}, with {gaps} gaps of over {_GAP_S:g} s; the "
        what += f"longest is {step.max():.2f} s before frame {frame}"
        yield warning("dropped frames", what, f"t[{frame}]", "check the radio link and the recorder's load")


def check_repeats(recording: Recording) -> Iterator[Finding]:
    """Finds frames that repeat the one before: a stalled sensor, or a recorder faster than the glove."""
    same: np.ndarray = np.abs(np.diff(recording.p_HK, axis=0)).max(axis=(1, 2)) < _REPEAT_TOLERANCE_M
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    held = recording.t[ends] - recording.t[starts]
    frozen = held[held > _FROZEN_S].sum()
    if frozen:
        start = starts[np.argmax(held)]
        what = f"frozen signal: frames repeat for {held.max():.1f} s from frame {start}, {frozen:.1f} s of "
        what += f"{recording.duration_s:.1f} s in all"
        kind = error if frozen > 0.5 * recording.duration_s else warning
        yield kind("constant signal", what, f"p_HK[{start}]", "check that the glove was connected")
    elif same.sum() > _REPEATED_FRACTION * len(same):
        first = int(np.argmax(same)) + 1
        what = f"{int(same.sum())} of {len(recording)} frames repeat the one before, first frame {first}"
        advice = "training ignores them; record at the glove's own rate"
        yield warning("duplicated frames", what, f"p_HK[{first}]", advice)
