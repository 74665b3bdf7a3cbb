"""Checks a system's period, latency and low-pass cutoff."""

import math

# Shorter periods suffer from rounding in long sessions; longer ones are useless for control.
_PERIODS = (1e-5, 10.0)  # s
# Lower cutoffs would block all motion.
_CUTOFFS = (1e-3, 1e6)  # Hz


def check_timing(period: float, latency: float = 0.0, cutoff: float = 0.0) -> None:
    """Checks a period (s), a latency (s) and a low-pass cutoff (Hz, 0 for none).

    Raises:
        ValueError: a value is not finite or out of range.
    """
    low, high = _PERIODS
    if not low <= period <= high:
        raise ValueError(f"period must be from {low:g} to {high:g} s, not {period}")
    if not 0.0 <= latency <= high:
        raise ValueError(f"latency must be from 0 to {high:g} s, not {latency}")
    low, high = _CUTOFFS
    if not (cutoff == 0.0 or low <= cutoff <= high):
        raise ValueError(f"cutoff must be 0, or from {low:g} to {high:g} Hz, not {cutoff}")


def low_pass_factor(cutoff: float, period: float) -> float:
    """Fraction of the way to its input that a first-order low-pass moves in a period (s); 1 for cutoff 0."""
    return -math.expm1(-2.0 * math.pi * cutoff * period) if cutoff > 0 else 1.0
