"""Photographs Rerun recordings in a headless viewer: python studies/screenshots.py FILE.rrd OUT.png [TIME].

Without a graphics card, the viewer draws with Mesa's software driver (apt-get install mesa-vulkan-drivers).
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from rerun.experimental import ViewerClient

TIMELINE = "sim_time"
_NOTICE = 6.0  # s, during which a notice of the viewer covers a corner
_TIMEOUT = 120.0  # s, for the viewer to start, and for layout and plots to settle


def photographs(
    recording: Path, times: Callable[[float], Iterable[float]], size: tuple[int, int] = (1440, 900)
) -> Iterator[bytes]:
    """Yields a .png of the recording's layout at each time, s.

    Args:
        times: function that chooses the times, given the recording's end.
        size: width and height of the window, px.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # `ViewerClient.spawn` would listen on all network interfaces and fix the window's size.
    command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen"]
    viewer = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            time.sleep(0.2)
        client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        client.open(str(recording.resolve()))
        while (state := client.get_state()).loading or not state.recordings:
            time.sleep(0.2)
        ends = {timeline.name: timeline.end for timeline in state.recordings[0].timelines}
        time.sleep(_NOTICE)
        for moment in times(1e-9 * ends[TIMELINE]):
            client.set_time(TIMELINE, play_state="paused", duration=moment)
            deadline, before = time.monotonic() + _TIMEOUT, b""
            while (now := client.take_screenshot(None)) != before and time.monotonic() < deadline:
                before = now
                time.sleep(0.3)
            yield now
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)  # the command starts the viewer in its process group
        viewer.wait()


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="Rerun recording (.rrd)")
    parser.add_argument("picture", type=Path, help="picture to write (.png)")
    parser.add_argument("time", type=float, nargs="?", help="time, s (default: the end)")
    arguments = parser.parse_args(argv)
    shots = photographs(arguments.recording, lambda end: [end if arguments.time is None else arguments.time])
    arguments.picture.write_bytes(next(shots))


if __name__ == "__main__":
    main()
