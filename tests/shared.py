"""Results that many tests need, computed once in a test run, also when several processes share its tests."""

import functools
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from geort_drake import Recording, synthesize_play
from geort_drake.files import locked

# Names the folder of the run's results; processes started by the run inherit it.
FOLDER = "GEORT_DRAKE_TEST_RESULTS"


def shared(function: Callable) -> Callable:
    """Caches a function of strings and numbers in the process, and its results in the run's folder.

    The code does not change during a run, and each run has a new folder, so no result is out of date.
    """

    @functools.cache
    def call(*arguments: Any) -> Any:
        if FOLDER not in os.environ:
            return function(*arguments)
        words = (function.__module__, function.__qualname__, *map(str, arguments))
        path = Path(os.environ[FOLDER], "-".join(words))
        path.mkdir(exist_ok=True)
        with locked(path, wait=True):
            result = path / "result.pickle"
            if not result.exists():
                result.write_bytes(pickle.dumps(function(*arguments)))
            # Also where it was computed: a copy's arrays may lie otherwise in memory, and then sum otherwise.
            return pickle.loads(result.read_bytes())  # noqa: S301  (written by this run)

    return functools.update_wrapper(call, function)


@shared
def synthesized(seed: int, duration_s: float, rate_hz: float) -> Recording:
    """Synthetic play; do not change its arrays."""
    return synthesize_play(seed, duration_s, rate_hz)
