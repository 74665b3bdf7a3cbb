"""Numeric core: criteria, networks, training, checkpoints and the NumPy retargeter, without pydrake."""
