"""A task of a worker process that imports little, so that its start costs little."""

import os
import time

import numpy as np

_kept = []


def grow() -> int:
    """Keeps 400 MB, and waits as long as loky does between its looks at memory; its process."""
    _kept.append(np.ones(50_000_000))
    time.sleep(1)
    return os.getpid()
