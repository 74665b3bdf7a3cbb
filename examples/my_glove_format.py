"""My glove's .npz: `markers` (T, 21, 3), mm, wrist last; `time` (T), s."""

from typing import Any

from geort_drake.people.formats.tracks import Tracks, numbers, side_of, times

SUFFIXES = (".npz",)
ORDER = [20, *range(20)]  # indices of our keypoints in the file


def recognizes(contents: Any) -> bool:
    """Whether a file with such a suffix has this format."""
    return "markers" in contents


def read(name: str, contents: Any, side: str) -> Tracks:
    """The keypoints as the file gives them; `name` is for messages, `side` is what the user asked for."""
    p_WK = numbers(name, "markers", contents["markers"], (21, 3))[:, ORDER]
    return Tracks(p_WK, times(name, contents, len(p_WK)), world=True, side=side_of(name, contents), unit="mm")
