"""How often a system updates, how long its work takes and how slow its low-pass is: what can work."""

import math

# Shorter periods round to nothing beside the time of a long session; longer ones are no control.
PERIODS = (1e-5, 10.0)  # s
# A slower low-pass hardly moves.
CUTOFFS = (1e-3, 1e6)  # Hz


def check_timing(period: float, latency: float = 0.0, cutoff: float = 0.0) -> None:
    """Looks whether an update every `period` (s) can work, with that latency (s) and low-pass (Hz, 0 none).

    Raises:
        ValueError: a value is not finite or out of range; the message names it.
    """
    low, high = PERIODS
    if not low <= period <= high:
        raise ValueError(f"period must be from {low:g} to {high:g} s, not {period}")
    if not 0.0 <= latency <= high:
        raise ValueError(f"latency must be from 0 to {high:g} s, not {latency}")
    low, high = CUTOFFS
    if not (cutoff == 0.0 or low <= cutoff <= high):
        raise ValueError(f"cutoff must be 0, or from {low:g} to {high:g} Hz, not {cutoff}")


def low_pass_share(cutoff: float, period: float) -> float:
    """Share of the way to its input that a first-order low-pass goes in one period; 1 without one.

    Args:
        cutoff: Hz; 0 is without.
        period: s.
    """
    return -math.expm1(-2.0 * math.pi * cutoff * period) if cutoff > 0 else 1.0
