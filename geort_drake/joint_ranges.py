"""Bound on plausible joint angles."""

# Limits beyond many turns are mistakes, and computing with them may overflow.
MAX_ANGLE = 100.0  # rad
