"""Counts the cores for worker processes, and ends workers together with their parent."""

import multiprocessing
import os
import threading
import time

import joblib

_WATCH_PERIOD = 0.2  # s


def usable_cores() -> int:
    """Number of processes over which this one may spread its work; 1 in a worker."""
    return 1 if multiprocessing.parent_process() is not None else joblib.cpu_count()


def end_with(starter: int) -> None:
    """Ends this process soon after its parent, of process id `starter`, has ended, even by `kill -9`.

    Otherwise loky's workers would keep their memory for five more minutes.
    """

    def watch() -> None:
        while os.getppid() == starter:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
