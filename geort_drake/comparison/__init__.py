"""Comparison of maps by metrics: training, held-out parts, report."""
