"""Compares maps by metrics: training, protocols with held-out parts, and reports."""
