"""Worker processes: how many, and that they end with the process that started them."""

import multiprocessing
import os
import threading
import time

import joblib

_WATCH_PERIOD = 1.0  # s


def usable_cores() -> int:
    """How many processes may share the work of this one, itself included: a worker starts no others."""
    return 1 if multiprocessing.parent_process() is not None else joblib.cpu_count()


def end_with(starter: int) -> None:
    """Ends this process when its parent, of number `starter`, has ended, were it by `kill -9`.

    Left alone, workers of loky hold their memory for five minutes more.
    """

    def watch() -> None:
        while os.getppid() == starter:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
