"""Reads my glove's .npz: `markers` (T, 21, 3), mm, wrist last; `time` (T,), s."""

from typing import Any

from geort_drake.people.formats.source import Source, Tracks

SUFFIXES = (".npz",)
ORDER = [20, *range(20)]  # indices of our keypoints in the file


def recognizes(contents: Any) -> bool:
    """Whether a file with one of `SUFFIXES` has this format."""
    return "markers" in contents


def read(file: Source, side: str) -> Tracks:
    """Returns the keypoints as stored in the file; `side` is the side that the user selected."""
    p_WK = file.array("markers", (21, 3))[:, ORDER]
    return Tracks(p_WK, file.times(len(p_WK)), world=True, side=file.side(), unit="mm")
