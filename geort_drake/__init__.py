"""GeoRT hand retargeting, built and judged inside a Drake simulation.

The names below are loaded when they are first used, so that importing the package costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geort_drake.people.readers import read_recording
    from geort_drake.people.recording import Recording
    from geort_drake.rerun.recorder import add_rerun_recorder
    from geort_drake.retargeting.retargeter import Retargeter, load_retargeter
    from geort_drake.systems.glove_replay import GloveReplay
    from geort_drake.systems.retargeting_system import RetargetingSystem

__version__ = "0.1.0"

__all__ = [
    "GloveReplay",
    "Recording",
    "Retargeter",
    "RetargetingSystem",
    "add_rerun_recorder",
    "load_retargeter",
    "read_recording",
]

_HOMES = {
    "GloveReplay": "systems.glove_replay",
    "Recording": "people.recording",
    "Retargeter": "retargeting.retargeter",
    "RetargetingSystem": "systems.retargeting_system",
    "add_rerun_recorder": "rerun.recorder",
    "load_retargeter": "retargeting.retargeter",
    "read_recording": "people.readers",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
