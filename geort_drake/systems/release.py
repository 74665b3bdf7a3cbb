"""Frees the memory of diagrams with systems written in Python."""

import gc

from pydrake.systems.framework import Diagram, System


def release(diagram: Diagram) -> None:
    """Deletes the attributes of the diagram's Python systems, and closes its recorders first.

    The diagram cannot be used afterwards: another step of its simulator may crash Python.

    pydrake never frees systems written in Python (drake#24162), nor the objects they refer to. The diagram of
    a trial leaks 11 MB, or 0.6 MB once released (Drake 1.51).
    """
    systems: list[System] = [diagram]
    while systems:
        system = systems.pop()
        if isinstance(system, Diagram):
            systems += system.GetSystems()
        if not type(system).__module__.startswith("pydrake") and system.__dict__:  # not released yet
            if close := getattr(system, "close", None):
                close()
            system.__dict__.clear()
    gc.collect()  # contexts are part of reference cycles
