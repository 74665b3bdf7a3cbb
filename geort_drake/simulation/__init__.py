"""Simulated trials: scenario, world and diagram; `tasks`; and `person`, the simulated person."""
