"""Faults that are put in on purpose, for the tests and for studies/reliability.py."""
