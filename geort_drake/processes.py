"""Worker processes that end with the process that started them."""

import os
import threading
import time

_WATCH_PERIOD = 1.0  # s


def end_with(starter: int) -> None:
    """Ends this process when its parent, of number `starter`, has ended, were it by `kill -9`.

    Left alone, workers of loky hold their memory for five minutes more.
    """

    def watch() -> None:
        while os.getppid() == starter:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
