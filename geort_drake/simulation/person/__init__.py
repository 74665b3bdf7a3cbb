"""The simulated person: one engine, whose behaviour in a task is a table of phases."""
