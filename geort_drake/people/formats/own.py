"""Our own .npz, as `Recording.save` writes it: t, p_HK, valid, optionally X_WH, and metadata.

Source: docs/reference/recording-formats.md
"""

from typing import Any

from geort_drake.people.recording import Recording

SUFFIXES = (".npz",)


def recognizes(contents: Any) -> bool:
    return "p_HK" in contents


def read(name: str, contents: Any, side: str) -> Recording:
    return Recording.from_arrays(name, contents)
