"""How far a joint can be said to turn."""

# Limits beyond many turns are mistakes, and what is computed from them may overflow.
MAX_ANGLE = 100.0  # rad
