"""Pictures of Rerun recordings, taken by a viewer that needs no screen."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import IO, Any

import psutil
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from geort_drake.errors import RecordingError
from geort_drake.files import atomic_path
from geort_drake.rerun.writer import STEPS, TIMELINE

_GREETING = 6.0  # s; so long a notice of the viewer's covers a corner
_ATTEMPTS = 4
_PAUSE = 0.3  # s, between two looks at whether anything still moves
_DRIVER = (
    "The viewer needs a graphics driver; without a graphics card a software one will do "
    "(Debian and Ubuntu: apt-get install mesa-vulkan-drivers)."
)


class Camera:
    """Takes pictures of a recording that a viewer shows.

    Attributes:
        end: last time on the recording's timeline: simulated s, or training steps.
    """

    def __init__(self, client: ViewerClient, recording: Path, timeout_s: float):
        self._client, self._timeout_s = client, timeout_s
        client.open(str(recording))
        deadline = monotonic() + timeout_s
        while (state := client.get_state()).loading or not state.recordings:
            if monotonic() > deadline:
                raise RuntimeError(f"the recording did not load within {timeout_s:g} s")
            sleep(0.2)
        timelines = state.recordings[0].timelines
        ends = {timeline.name: timeline.end for timeline in timelines if timeline.end is not None}
        self._timeline = next((name for name in (TIMELINE, STEPS) if name in ends), None)
        if self._timeline is None:
            raise RecordingError(f"{recording}: holds nothing on the timeline '{TIMELINE}' or '{STEPS}'")
        self.end: float = ends[self._timeline] * (1e-9 if self._timeline == TIMELINE else 1)
        sleep(_GREETING)

    def take(self, time: float | None = None, view: str | None = None) -> bytes:
        """A .png of a time, by default the end; of the layout's view with a title, by default the window."""
        shown = self.end if time is None else time
        kind = {"duration": shown} if self._timeline == TIMELINE else {"sequence": round(shown)}
        _patiently(lambda: self._client.set_time(self._timeline, play_state="paused", **kind))
        return self._settled(view)

    def _settled(self, view: str | None) -> bytes:
        """What the viewer shows when nothing moves any more: layout and plots settle over many frames."""
        shown = None
        if view is not None:
            views = _patiently(self._client.get_state).views
            shown = next(one.view_id for one in views if one.name == view)
        end, before = monotonic() + self._timeout_s, b""
        while True:
            now = _patiently(lambda: self._client.take_screenshot(shown))
            if now == before or monotonic() > end:
                return now
            before = now
            sleep(_PAUSE)


def _patiently(ask: Callable[[], Any]) -> Any:
    """The answer of a viewer, which on a busy machine may not come within the client's own limit."""
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(RuntimeError):
            return ask()
    return ask()


@contextlib.contextmanager
def camera(
    recording: str | os.PathLike, size: tuple[int, int] = (1440, 900), timeout_s: float = 120.0
) -> Iterator[Camera]:
    """Shows a recording in a viewer without a screen, with the layout stored in the file.

    Args:
        recording: the .rrd file.
        size: width and height of the window, px.
        timeout_s: how long to wait for the viewer to start, the file to load, and the layout to settle.

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
            yield Camera(client, recording, timeout_s)
        except (OSError, RuntimeError) as error:
            raise RecordingError(f"{recording}: no picture: {error}. {_reason(viewer, log)}") from error
        finally:
            _end(viewer)


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
        recording, size, timeout_s: as in `camera`.
        picture: the .png file.
        time: what to show, on the recording's timeline: simulated s, or training steps; by default the end.

    Raises:
        RecordingError: see `camera`; or the picture has another suffix.
    """
    picture = Path(picture).resolve()
    if picture.suffix != ".png":
        raise RecordingError(f"{picture}: a picture's name must end with .png")
    with camera(recording, size, timeout_s) as opened:
        png = opened.take(time)
    with atomic_path(picture) as draft:
        draft.write_bytes(png)


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
