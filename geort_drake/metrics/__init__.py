"""Measures maps on recordings: figures, protocols with held-out parts, comparisons, and the explorer."""
