"""Scripted robots without a person, for `gates.py`: a module for each task, named after it, and `oracle`.

Each module of a task has `plans(scenario, description)`, which returns plans with joint positions, the best
first, and `scripted(scenario, plan, seed)`, which returns the score of a trial, 0 without success.
"""
