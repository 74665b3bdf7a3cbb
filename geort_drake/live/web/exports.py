"""Replays recorded sessions, for the Rerun viewer and as LeRobot datasets."""

import subprocess
import sys
import threading
from pathlib import Path

from geort_drake.errors import LiveError


def start_command(*words: str | Path) -> "subprocess.Popen[str]":
    """Starts a command of the package with low priority; its standard error is a pipe."""
    command = ["nice", "-n", "10", sys.executable, "-m", "geort_drake", *map(str, words), "--quiet"]
    # In a process group of its own, so that Ctrl-C does not end it.
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


class SessionExports:
    """Exports sessions one after another, in processes of low priority.

    A replay takes longer than the pause between two sessions and must not slow down the page's loop.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._closed = False

    def close(self) -> None:
        """Ends the running process and starts no further one."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def write(self, session: Path, retargeter: Path, simulated: bool) -> None:
        """Exports a session to a folder named like its file, and waits for the processes.

        A simulated session is replayed with its own task, object and seed. For a session with a real robot,
        whose objects are unknown, hand and joints are exported as recorded.

        Args:
            session: file of the session's recording.
            retargeter: checkpoint or map that drove the session.
            simulated: whether the robot was simulated.

        Raises:
            LiveError: a step failed.
        """
        folder = session.with_suffix("")
        if simulated:
            self._run("grasp", "--replay", session, "--retargeter", retargeter, "--output", folder)
            self._run("export", folder, folder / "lerobot", "--format", "lerobot")
        else:
            self._run("export", session, folder / "hand.rrd", "--format", "rrd")
            self._run("export", session, folder / "lerobot", "--format", "lerobot")

    def _run(self, *words: str | Path) -> None:
        with self._lock:
            if self._closed:
                raise LiveError(f"{words[0]}: closed before it started")
            self._process = process = start_command(*words)
            _, errors = process.communicate()
        if process.returncode:
            raise LiveError(f"{words[0]}: {errors.strip()[-300:] or 'ended before it was done'}")
