"""Screenshots of Rerun recordings, taken by a headless viewer."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import IO, Any

from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from geort_drake.errors import RecordingError
from geort_drake.files import atomic_path
from geort_drake.rerun.writer import STEPS, TIMELINE

_NOTICE = 6.0  # s, during which a notice of the viewer covers a corner
_TIMEOUT = 120.0  # s, for the viewer to start, the file to load and the layout to settle
_ATTEMPTS = 4
_PAUSE = 0.3  # s, between two screenshots that are compared
_DRIVER = (
    "The viewer needs a graphics driver; without a graphics card, install a software driver "
    "(Debian and Ubuntu: apt-get install mesa-vulkan-drivers)."
)


class Camera:
    """Takes screenshots of a recording that a viewer shows.

    Attributes:
        end: last time on the recording's timeline: simulated s, or training steps.
    """

    def __init__(self, client: ViewerClient, recording: Path):
        self._client = client
        client.open(str(recording))
        deadline = monotonic() + _TIMEOUT
        while (state := client.get_state()).loading or not state.recordings:
            if monotonic() > deadline:
                raise RuntimeError(f"the recording did not load within {_TIMEOUT:g} s")
            sleep(0.2)
        timelines = state.recordings[0].timelines
        ends = {timeline.name: timeline.end for timeline in timelines if timeline.end is not None}
        self._timeline = next((name for name in (TIMELINE, STEPS) if name in ends), None)
        if self._timeline is None:
            raise RecordingError(f"{recording}: has no data on the timeline '{TIMELINE}' or '{STEPS}'")
        self.end: float = ends[self._timeline] * (1e-9 if self._timeline == TIMELINE else 1)
        sleep(_NOTICE)

    def take(self, time: float | None = None) -> bytes:
        """Returns a .png of the window at a time, by default the end, once layout and plots have settled."""
        shown = self.end if time is None else time
        kind = {"duration": shown} if self._timeline == TIMELINE else {"sequence": round(shown)}
        _retry(lambda: self._client.set_time(self._timeline, play_state="paused", **kind))
        end, before = monotonic() + _TIMEOUT, b""
        while (now := _retry(lambda: self._client.take_screenshot(None))) != before and monotonic() < end:
            before = now
            sleep(_PAUSE)
        return now


@contextlib.contextmanager
def camera(recording: str | os.PathLike, size: tuple[int, int] = (1440, 900)) -> Iterator[Camera]:
    """Shows a recording in a viewer without a screen, with the layout stored in the file.

    Args:
        recording: the .rrd file.
        size: width and height of the window, px.

    Raises:
        RecordingError: the recording is missing or empty, or the viewer cannot draw here.
    """
    recording = Path(recording).resolve()
    if not recording.is_file():
        raise RecordingError(f"{recording}: no such recording")
    try:
        RrdReader(recording).recordings()
    except (OSError, RuntimeError, ValueError) as error:
        raise RecordingError(f"{recording}: not a Rerun recording: {error}") from error
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # ViewerClient.spawn would listen on all network interfaces and fix the window's size.
    command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen"]
    with tempfile.TemporaryFile() as log:
        viewer = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=os.environ | {"NO_COLOR": "1"},
            start_new_session=True,  # makes a process group; see `_end`
        )
        try:
            _wait_for(port, viewer)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            yield Camera(client, recording)
        except (OSError, RuntimeError) as error:
            raise RecordingError(f"{recording}: no screenshot: {error}. {_reason(viewer, log)}") from error
        finally:
            _end(viewer)


def take_screenshot(
    recording: str | os.PathLike,
    picture: str | os.PathLike,
    *,
    time: float | None = None,
    size: tuple[int, int] = (1440, 900),
) -> None:
    """Takes a screenshot (.png) of a recording in the viewer, with the layout stored in the file.

    Args:
        recording: the .rrd file.
        picture: the .png file.
        time: time on the recording's timeline, simulated s or training steps; by default the end.
        size: width and height of the picture, px.

    Raises:
        RecordingError: the recording is missing or empty, the viewer cannot draw here, or the picture has
            another suffix.
    """
    picture = Path(picture).resolve()
    if picture.suffix != ".png":
        raise RecordingError(f"{picture}: a picture's name must end with .png")
    with camera(recording, size) as opened:
        png = opened.take(time)
    with atomic_path(picture) as draft:
        draft.write_bytes(png)


def _retry(ask: Callable[[], Any]) -> Any:
    """Returns the viewer's reply; on a busy machine, it may exceed the client's time limit a few times."""
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(RuntimeError):
            return ask()
    return ask()


def _reason(viewer: subprocess.Popen, log: IO[bytes]) -> str:
    """Returns the errors that the viewer reported, and advice if it has ended."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(timeout=2)
    log.seek(0)
    lines = [line.strip() for line in log.read().decode(errors="replace").splitlines()]
    errors = [line for line in lines if "ERROR" in line or "adapter" in line]
    return "\n".join([_DRIVER] * (viewer.poll() is not None) + errors[-3:])


def _end(viewer: subprocess.Popen) -> None:
    # The Python command starts the actual viewer in the same process group.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()


def _wait_for(port: int, viewer: subprocess.Popen) -> None:
    deadline = monotonic() + _TIMEOUT
    while monotonic() < deadline:
        if viewer.poll() is not None:
            raise RuntimeError(f"the viewer ended with code {viewer.returncode}")
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        sleep(0.2)
    raise RuntimeError(f"the viewer did not answer within {_TIMEOUT:g} s")
