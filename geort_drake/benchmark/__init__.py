"""Compares retargeting methods by simulated trials, with statistics and reports."""
