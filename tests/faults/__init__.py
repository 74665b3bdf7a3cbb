"""Faults that are put in on purpose, for the tests."""
