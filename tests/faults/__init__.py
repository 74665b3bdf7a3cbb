"""Faults that are put in on purpose, for the tests and for benchmarks/measure_reliability.py."""
