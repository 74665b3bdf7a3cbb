"""Comparison of maps by simulated trials: statistics, report."""
