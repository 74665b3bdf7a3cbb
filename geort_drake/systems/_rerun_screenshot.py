"""Pictures of Rerun recordings, taken by a viewer that needs no screen."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic, sleep
from typing import IO

import psutil
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from geort_drake.errors import RecordingError
from geort_drake.files import atomic_path
from geort_drake.systems._rerun_writer import STEPS, TIMELINE

_GREETING = 6.0  # s; so long a notice of the viewer's covers a corner
_ATTEMPTS = 4
_DRIVER = (
    "The viewer needs a graphics driver; without a graphics card a software one will do "
    "(Debian and Ubuntu: apt-get install mesa-vulkan-drivers)."
)


def take_screenshot(
    recording: str | os.PathLike,
    picture: str | os.PathLike,
    *,
    time: float | None = None,
    size: tuple[int, int] = (1440, 900),
    timeout_s: float = 120.0,
) -> None:
    """Writes a .png of a recording as the viewer shows it, with the layout stored in the file.

    Args:
        recording: the .rrd file.
        picture: the .png file.
        time: what to show, on the recording's timeline: simulated s, or training steps; by default the end.
        size: width and height of the window, px.
        timeout_s: how long to wait for the viewer to start, the file to load, and the layout to settle.

    Raises:
        RecordingError: the recording is missing or empty, or the viewer cannot draw here.
    """
    recording, picture = Path(recording).resolve(), Path(picture).resolve()
    if not recording.is_file():
        raise RecordingError(f"{recording}: no such recording")
    if picture.suffix != ".png":
        raise RecordingError(f"{picture}: a picture's name must end with .png")
    try:
        RrdReader(recording).recordings()
    except (OSError, RuntimeError, ValueError) as error:
        raise RecordingError(f"{recording}: not a Rerun recording: {error}") from error
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # Not ViewerClient.spawn, which listens on all network interfaces and fixes the window's size.
    command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen"]
    with tempfile.TemporaryFile() as log:
        viewer = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=os.environ | {"NO_COLOR": "1"}
        )
        try:
            _wait_for(port, viewer, timeout_s)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            _show(client, recording, time, timeout_s)
            with atomic_path(picture) as draft:
                _photograph(client, draft, timeout_s)
        except (OSError, RuntimeError) as error:
            raise RecordingError(f"{recording}: no picture: {error}. {_reason(viewer, log)}") from error
        finally:
            _end(viewer)


def _reason(viewer: subprocess.Popen, log: IO[bytes]) -> str:
    """What the viewer said went wrong, and what to do if it died."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(timeout=2)
    log.seek(0)
    said = log.read().decode(errors="replace").splitlines()
    telling = [line.strip() for line in said if "ERROR" in line or "adapter" in line]
    return "\n".join([_DRIVER] * (viewer.poll() is not None) + telling[-3:])


def _end(viewer: subprocess.Popen) -> None:
    # The command's Python part starts the viewer proper as its child.
    processes = [viewer]
    with contextlib.suppress(psutil.NoSuchProcess):
        processes = [*psutil.Process(viewer.pid).children(recursive=True), viewer]
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    viewer.wait()


def _wait_for(port: int, viewer: subprocess.Popen, timeout_s: float) -> None:
    deadline = monotonic() + timeout_s
    while monotonic() < deadline:
        if viewer.poll() is not None:
            raise RuntimeError(f"the viewer ended with code {viewer.returncode}")
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        sleep(0.2)
    raise RuntimeError(f"the viewer did not answer within {timeout_s:g} s")


def _show(client: ViewerClient, recording: Path, time: float | None, timeout_s: float) -> None:
    client.open(str(recording))
    deadline = monotonic() + timeout_s
    while (state := client.get_state()).loading or not state.recordings:
        if monotonic() > deadline:
            raise RuntimeError(f"the recording did not load within {timeout_s:g} s")
        sleep(0.2)
    timelines = state.recordings[0].timelines
    ends = {timeline.name: timeline.end for timeline in timelines if timeline.end is not None}
    if TIMELINE in ends:
        shown = ends[TIMELINE] * 1e-9 if time is None else time
        client.set_time(TIMELINE, duration=shown, play_state="paused")
    elif STEPS in ends:
        step = ends[STEPS] if time is None else round(time)
        client.set_time(STEPS, sequence=step, play_state="paused")
    else:
        raise RecordingError(f"{recording}: holds nothing on the timeline '{TIMELINE}' or '{STEPS}'")


def _photograph(client: ViewerClient, picture: Path, timeout_s: float) -> None:
    """Saves what the viewer shows when nothing moves any more: layout and plots settle over many frames."""
    end, before, failures = monotonic() + timeout_s, b"", 0
    sleep(_GREETING)
    while True:
        try:
            client.save_screenshot(str(picture))
        except RuntimeError:  # a busy machine may not draw within the client's own limit
            failures += 1
            if failures == _ATTEMPTS:
                raise
            continue
        now = picture.read_bytes()
        if now == before or monotonic() > end:
            return
        before = now
        sleep(1.0)
