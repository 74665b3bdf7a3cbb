"""Trials: scenario, world, diagram; `tasks`; `operators`, the simulated people."""
