"""Repairs of recordings that need no guess: time stamps, and lengths of quaternions."""

import bisect

import numpy as np

from geort_drake.people.checks.findings import Finding, FrameFaults, warning

# A single first or last frame farther from the others than this has a wrong time.
_LONGEST_GAP_S, _LONGEST_GAP_PERIODS = 60.0, 1000.0
_WINDOW = 2  # frames to either side that tell which of two neighbouring times is wrong
# A quaternion is used as it is if its norm differs from 1 by at most the first, and scaled up to the second.
NORM_TOLERANCE, NORM_REPAIRABLE = 1e-2, 0.2


def repaired_times(t: np.ndarray, numbers: np.ndarray, faults: FrameFaults) -> np.ndarray:
    """Increasing times (T,), s: frames with an unusable time get one between their neighbours', and a fault.

    Args:
        t: (T,) times, s; NaN where there is none.
        numbers: (T,) of the frames, for the report.
        faults: to which the unusable frames are added.
    """
    usable = np.isfinite(t)
    if usable.sum() >= 2:
        usable[usable] = _increasing(t[usable])
    if usable.all() or usable.sum() < 2:
        return t
    first = int(np.argmin(usable))
    before = f" after {t[first - 1]:.6f} s" if first else ""
    faults.add(
        "have no time, or one that does not increase",
        numbers[~usable],
        f"{t[first]:.6f} s{before}",
    )
    index = np.arange(len(t))
    known = index[usable]
    repaired = np.where(usable, t, np.interp(index, known, t[usable]))
    period = np.median(np.diff(t[usable]) / np.diff(known))
    repaired[: known[0]] = t[known[0]] - period * (known[0] - index[: known[0]])
    repaired[known[-1] + 1 :] = t[known[-1]] + period * (index[known[-1] + 1 :] - known[-1])
    return repaired


def _increasing(t: np.ndarray) -> np.ndarray:
    """Which times (N,) to keep, so that they increase and as few as possible are dropped."""
    usable = np.ones(len(t), bool)
    period = float(np.median(np.diff(t)))
    # Of two neighbours in the wrong order, the one off the clock's rhythm is wrong.
    for i in np.flatnonzero(np.diff(t) <= 0).tolist():
        off = [_off_rhythm(t, j, period) for j in (i, i + 1)]
        usable[i if off[0] > off[1] else i + 1] = False
    kept = np.flatnonzero(usable)
    usable[np.setdiff1d(kept, kept[_longest_increasing(t[kept])])] = False
    kept = np.flatnonzero(usable)
    longest = max(_LONGEST_GAP_S, _LONGEST_GAP_PERIODS * period)
    if len(kept) > 2 and t[kept[1]] - t[kept[0]] > longest:
        usable[kept[0]] = False
    if len(kept) > 2 and t[kept[-1]] - t[kept[-2]] > longest:
        usable[kept[-1]] = False
    return usable


def _off_rhythm(t: np.ndarray, i: int, period: float) -> float:
    near = np.arange(max(i - _WINDOW, 0), min(i + _WINDOW + 1, len(t)))
    offset = t[near] - period * near
    return float(abs(t[i] - period * i - np.median(offset)))


def _longest_increasing(t: np.ndarray) -> list[int]:
    """Indices of a longest strictly increasing subsequence of t (N,)."""
    ends: list[float] = []  # the least last time of a subsequence of each length
    last: list[int] = []
    before = np.full(len(t), -1)
    for i, value in enumerate(t.tolist()):
        length = bisect.bisect_left(ends, value)
        before[i] = last[length - 1] if length else -1
        if length == len(ends):
            ends.append(value)
            last.append(i)
        elif value < ends[length]:
            ends[length], last[length] = value, i
    chain, i = [], last[-1] if last else -1
    while i >= 0:
        chain.append(i)
        i = int(before[i])
    return chain[::-1]


def repaired_poses(
    X_WH: np.ndarray, valid: np.ndarray, faults: FrameFaults
) -> tuple[np.ndarray, list[Finding]]:
    """Poses (T, 7) with unit quaternions, and what was repaired.

    Quaternions that are nearly of length one are scaled. Frames with others get a fault, and no rotation.

    Args:
        X_WH: (T, 7) as qw qx qy qz x y z.
        valid: (T,) which frames count.
        faults: to which the unusable frames are added.

    Raises:
        ValueError: most of the valid frames hold no quaternion; the message says what they hold.
    """
    norm = np.linalg.norm(X_WH[:, :4], axis=1)
    off = np.abs(norm - 1.0)
    bad, scaled = off > NORM_REPAIRABLE, (off > NORM_TOLERANCE) & (off <= NORM_REPAIRABLE)
    if (bad & valid).sum() > 0.5 * valid.sum():
        frame = int(np.argmax(bad & valid))
        raise ValueError(
            "X_WH must hold unit quaternions and then positions, but the first four numbers of frame "
            f"{frame} have norm {norm[frame]:.3g}"
        )
    faults.add("have a wrist pose X_WH without a unit quaternion", np.flatnonzero(bad & valid))
    repaired = X_WH.copy()
    repaired[bad, :4] = 1.0, 0.0, 0.0, 0.0
    repaired[scaled, :4] /= norm[scaled, None]
    if not scaled.any():
        return repaired, []
    what = f"{int(scaled.sum())} of {len(X_WH)} quaternions of the wrist have a norm of "
    what += f"{norm[scaled].min():.3g} to {norm[scaled].max():.3g}"
    frame = int(np.argmax(scaled))
    return repaired, [warning("axes", what, f"X_WH[{frame}]", "scaled to one")]
