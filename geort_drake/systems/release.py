"""Frees the memory of diagrams with systems written in Python."""

from pydrake.systems.framework import Diagram, System


def release(diagram: Diagram) -> None:
    """Drops everything that the diagram's Python systems hold. The diagram cannot be used afterwards.

    pydrake never frees systems written in Python (drake#24162), and so neither what they refer to: a dropped
    grasp diagram leaves 11 MB, a released one 0.3 MB (Drake 1.51).
    """
    systems: list[System] = [diagram]
    while systems:
        system = systems.pop()
        if isinstance(system, Diagram):
            systems += system.GetSystems()
        if not type(system).__module__.startswith("pydrake"):
            system.__dict__.clear()
