"""Repairs of recordings that need no guess: times, and norms of quaternions."""

import bisect

import numpy as np

from geort_drake.people.checks.findings import Finding, FrameFaults, warning

# The time of a first or last frame that is farther from the others than this is wrong.
_LONGEST_GAP_S, _LONGEST_GAP_PERIODS = 60.0, 1000.0
_WINDOW = 2  # frames to either side that determine which of two neighbouring times is wrong
# Deviations of a quaternion's norm from 1 that are accepted, and those that are normalised.
NORM_TOLERANCE, NORM_REPAIRABLE = 1e-2, 0.2


def repaired_times(t: np.ndarray, numbers: np.ndarray, faults: FrameFaults) -> np.ndarray:
    """Returns increasing times (T,), s: unusable ones are interpolated, and their frames get a fault.

    Args:
        t: (T,) times, s; NaN where there is none.
        numbers: (T,) numbers of the frames, for the report.
        faults: collects the unusable frames.
    """
    known = np.flatnonzero(np.isfinite(t))
    if len(known) >= 2:
        known = known[_increasing(t[known])]
    if len(known) == len(t) or len(known) < 2:
        return t
    bad = np.setdiff1d(np.arange(len(t)), known)
    faults.add("have no time, or one that does not increase", numbers[bad], f"{t[bad[0]]:.6f} s")
    index = np.arange(len(t))
    repaired = np.interp(index, known, t[known])
    period = np.median(np.diff(t[known]) / np.diff(known))
    # Beyond the ends, np.interp repeats the first or the last time.
    return repaired + period * (np.minimum(index - known[0], 0) + np.maximum(index - known[-1], 0))


def _increasing(t: np.ndarray) -> np.ndarray:
    """Returns the indices of the times t (N,) to keep so that they increase.

    Of two neighbours in the wrong order, the one that deviates more from the regular clock is dropped; then
    as few as possible.
    """
    period = float(np.median(np.diff(t)))
    offset = np.pad(t - period * np.arange(len(t)), _WINDOW, constant_values=np.nan)
    near = np.lib.stride_tricks.sliding_window_view(offset, 2 * _WINDOW + 1)
    off = np.abs(near[:, _WINDOW] - np.nanmedian(near, axis=1))
    back = np.flatnonzero(np.diff(t) <= 0)
    kept = np.setdiff1d(np.arange(len(t)), np.where(off[back] > off[back + 1], back, back + 1))
    kept = kept[_longest_increasing(t[kept])]
    longest = max(_LONGEST_GAP_S, _LONGEST_GAP_PERIODS * period)
    if len(kept) > 2 and t[kept[1]] - t[kept[0]] > longest:
        kept = kept[1:]
    if len(kept) > 2 and t[kept[-1]] - t[kept[-2]] > longest:
        kept = kept[:-1]
    return kept


def _longest_increasing(t: np.ndarray) -> list[int]:
    """Returns the indices of a longest strictly increasing subsequence of t (N,)."""
    ends: list[float] = []  # the smallest last time of the subsequences of each length
    last: list[int] = []
    before = [-1] * len(t)
    for i, value in enumerate(t.tolist()):
        length = bisect.bisect_left(ends, value)
        before[i] = last[length - 1] if length else -1
        ends[length : length + 1], last[length : length + 1] = [value], [i]
    chain, i = [], last[-1] if last else -1
    while i >= 0:
        chain.append(i)
        i = before[i]
    return chain[::-1]


def repaired_poses(
    X_WH: np.ndarray, valid: np.ndarray, faults: FrameFaults
) -> tuple[np.ndarray, list[Finding]]:
    """Returns poses (T, 7) with unit quaternions, and findings about repairs.

    Quaternions with a norm near one are normalised; other frames get a fault and the identity rotation.

    Args:
        X_WH: (T, 7) poses as qw qx qy qz x y z, m.
        valid: (T,) bool; faults of invalid frames are not reported.
        faults: collects the unusable frames.
    """
    norm = np.linalg.norm(X_WH[:, :4], axis=1)
    off = np.abs(norm - 1.0)
    bad, scaled = off > NORM_REPAIRABLE, (off > NORM_TOLERANCE) & (off <= NORM_REPAIRABLE)
    faults.add("have a wrist pose X_WH without a unit quaternion", np.flatnonzero(bad & valid))
    repaired = X_WH.copy()
    repaired[bad, :4] = 1.0, 0.0, 0.0, 0.0
    repaired[scaled, :4] /= norm[scaled, None]
    if not scaled.any():
        return repaired, []
    what = f"{int(scaled.sum())} of {len(X_WH)} quaternions of the wrist have a norm of "
    what += f"{norm[scaled].min():.3g} to {norm[scaled].max():.3g}"
    return repaired, [warning("axes", what, f"X_WH[{int(np.argmax(scaled))}]", "scaled to one")]
