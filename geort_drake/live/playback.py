"""A recording sent as a glove sends it."""

import threading
import time
from collections.abc import Callable

from geort_drake.live.glove_frame import GloveFrame, encode_frame
from geort_drake.people.recording import Recording


def play(
    recording: Recording,
    send: Callable[[bytes], None],
    stop: threading.Event,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Sends every frame when it is due, until the end or until `stop` is set.

    A frame's time is `clock` when it is sent, so frames that were late do not pretend otherwise.

    Returns:
        How many frames were sent.
    """
    start = clock()
    sent = 0
    for i, t in enumerate(recording.t - recording.t[:1]):
        if stop.wait(max(start + t - clock(), 0.0)):
            break
        p_HK = recording.p_HK[i] if recording.valid[i] else None
        X_WH = None if recording.X_WH is None else recording.X_WH[i]
        send(encode_frame(GloveFrame(recording.side, clock(), p_HK, X_WH)))
        sent += 1
    return sent
