"""Simulated trials: scenario, world and diagram; `tasks`; and `operators`, the simulated people."""
