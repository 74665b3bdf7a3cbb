"""Finds tasks by name: each module here, or in a folder that is added to `__path__`, defines a `TASK`."""

import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from geort_drake.errors import UnknownNameError

if TYPE_CHECKING:
    from geort_drake.simulation.task import Task


def task_names() -> list[str]:
    """Names of all tasks."""
    return sorted(path.stem for folder in __path__ for path in Path(folder).glob("[!_]*.py"))


@functools.cache
def find_task(name: str) -> "Task":
    """Returns the task of that name.

    Raises:
        UnknownNameError: there is no such task; the message lists the existing ones.
    """
    if name not in task_names():
        raise UnknownNameError("task", name, task_names())
    return importlib.import_module(f"{__name__}.{name}").TASK
