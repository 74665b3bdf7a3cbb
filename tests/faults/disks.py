"""Disks that are full or read-only, mounted in memory if this process may, and files that may not grow."""

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from trial_records import error

from faults.child import run
from faults.kills import unclear
from faults.sound import checkpoint, play
from geort_drake.benchmark.records import TrialLog
from geort_drake.files import write_text
from geort_drake.people.recording_parts import RecordingParts, read_parts
from geort_drake.rerun.streams import file_writer


def save_recording() -> None:
    play().save("play.npz")


def record_session() -> None:
    parts = RecordingParts("session.npz", {"side": "right"})
    poses = np.tile(np.eye(7)[0], (25, 1))
    for start in range(0, 200, 25):
        part = slice(start, start + 25)
        parts.append(play().t[part], play().p_HK[part], play().valid[part], poses)
    parts.finish()


def save_checkpoint() -> None:
    checkpoint(Path())


def save_text() -> None:
    write_text("notes.txt", "x" * 200_000)


def record_for_rerun() -> None:
    with file_writer("trial.rrd") as writer:
        writer.at(np.arange(5000.0)).series("/signal", ["x"], np.random.default_rng(0).random((5000, 1)))


def append_trials() -> None:
    with TrialLog("trials.jsonl") as log:
        for seed in range(1000):
            log.append(error(seed=seed, error="x" * 184))


WRITERS = (save_recording, record_session, save_checkpoint, save_text, record_for_rerun, append_trials)
# What is wrong with a disk → how to mount one; files that may not grow need no disk.
FULL = "size=16k"
DISKS = {"File too large": "", "No space left on device": FULL, "Read-only file system": "ro"}


def spoilt(folder: Path, reason: str) -> list[str]:
    """Writes to such a disk with each writer. Returns what is wrong with its error and what it leaves."""
    wrong, options = [], DISKS[reason]
    limits = {} if options else {"RLIMIT_FSIZE": 2_000}
    for writer in WRITERS:
        with mounted(folder / writer.__name__, options) as disk:
            found = unclear(run(writer, (), disk, folder / "beside", **limits), reason)
            left = [path.name for path in disk.iterdir()]
            if left and writer is append_trials:
                with TrialLog(disk / "trials.jsonl") as log:
                    found += [] if 0 < len(log.records) < 1000 else ["the log lost its lines"]
            elif writer is record_session:
                if options == FULL and not 0 < len(read_parts(disk / "session.npz") or ()) < 200:
                    found.append("the session was lost")
            elif left:
                found.append(f"left {left}")
            wrong += [f"{writer.__name__}: {text}" for text in found]
    return wrong


def can_mount(folder: Path) -> bool:
    """Returns whether this process may mount disks; few but the superuser may."""
    if os.geteuid() != 0:
        return False
    try:
        with mounted(folder / "try", "size=64k"):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


@contextlib.contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """Mounts a disk in memory at `folder`; without options it stays a folder."""
    folder.mkdir(parents=True)
    if not options:
        yield folder
        return
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
