"""Numeric core: criteria, networks, training, checkpoints and the NumPy retargeter. No pydrake here."""
