"""Findings about a recording: fault, severity, location and remedy."""

import dataclasses
import enum
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

MAX_LOST = 0.1  # a recording with a larger fraction of lost frames is refused


class Severity(enum.StrEnum):
    """How bad a finding is."""

    ERROR = "error"  # the recording is refused
    UNFIT = "unfit"  # usable for replays, but not for training
    WARNING = "warning"  # usable, but suspicious


@dataclasses.dataclass(frozen=True)
class Finding:
    """One fault of a recording, or one repair.

    Attributes:
        check: short name of the check, such as "unit".
        severity: how bad it is.
        what: what was expected and what was found.
        where: field and frame of the fault, if known.
        advice: the remedy, or the repair that was made.
        lost: frames that become invalid.
    """

    check: str
    severity: Severity
    what: str
    where: str = ""
    advice: str = ""
    lost: tuple[int, ...] = ()

    def __str__(self) -> str:
        place = f" ({self.where})" if self.where else ""
        return f"{self.what}{place}" + (f"; {self.advice}" if self.advice else "")


def error(check: str, what: str, where: str = "", advice: str = "") -> Finding:
    """Makes a finding for which the recording is refused."""
    return Finding(check, Severity.ERROR, what, where, advice)


def warning(check: str, what: str, where: str = "", advice: str = "", lost: Sequence[int] = ()) -> Finding:
    """Makes a finding that leaves the recording usable."""
    return Finding(check, Severity.WARNING, what, where, advice, tuple(int(frame) for frame in lost))


def lost_frames(
    frames: Sequence[int], count: int, what: str, detail: str = "", too_many: bool = False
) -> Finding:
    """Reports unusable frames among `count`: a warning, or an error above `MAX_LOST`.

    Args:
        frames: numbers of the lost frames, at least one.
        count: number of all frames.
        what: completes "3 of 400 frames ...".
        detail: fault of the first lost frame.
        too_many: reports an error for any number of lost frames.
    """
    what = f"{len(frames)} of {count} frames {what}, the first is frame {frames[0]}"
    what += f": {detail}" if detail else ""
    if too_many or len(frames) > MAX_LOST * count:
        what += "; at most one in ten may be lost"
        return error("lost frames", what, advice="record with the hand in view of the tracker")
    return warning("lost frames", what, advice="marked invalid", lost=frames)


class FrameFaults:
    """Collects the faults of single frames while a file is read; each frame keeps its first fault."""

    def __init__(self) -> None:
        self._faults: dict[int, tuple[str, str]] = {}

    def add(self, kind: str, frames: Iterable[int] | Mapping[int, str], detail: str = "") -> None:
        """Marks frames as unusable.

        Args:
            kind: completes "3 of 400 frames ...".
            frames: numbers of the frames, or a mapping from number to fault.
            detail: the fault, if it is the same in all of them.
        """
        details = frames if isinstance(frames, Mapping) else dict.fromkeys(frames, detail)
        for frame, each in details.items():
            self._faults.setdefault(int(frame), (kind, each))

    def valid(self, count: int) -> np.ndarray:
        """Returns (count,) bool: which frames have no fault."""
        return ~np.isin(np.arange(count), list(self._faults))

    def findings(self, count: int) -> list[Finding]:
        """Makes one finding per kind of fault, all errors if too many of `count` frames are lost in total."""
        kinds: dict[str, list[int]] = {}
        for frame, (kind, _) in sorted(self._faults.items()):
            kinds.setdefault(kind, []).append(frame)
        too_many = len(self._faults) > MAX_LOST * count
        return [
            lost_frames(frames, count, kind, self._faults[frames[0]][1], too_many)
            for kind, frames in sorted(kinds.items(), key=lambda item: -len(item[1]))
        ]
