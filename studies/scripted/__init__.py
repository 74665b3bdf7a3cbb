"""Scripted robots without a person, for the gates: a module for each task, of its name.

Each has `plans(scenario, description)`, the ways to do the task with joint positions, the best first, and
`scripted(scenario, plan, seed)`, the score of one trial, 0 without success.
"""
