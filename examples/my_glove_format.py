"""Reads my glove's .npz: `markers` (T, 21, 3), mm, wrist last; `time` (T,), s."""

from typing import Any

import numpy as np

from geort_drake.people.formats import FORMATS, Format, Track

ORDER = [20, *range(20)]  # indices of our keypoints in the file


def read(contents: Any, side: str) -> Track:
    """Returns times and keypoints as the file stores them; `side` is the one that the user wants."""
    p_WK = np.asarray(contents["markers"], dtype=float)[:, ORDER]
    return Track(contents["time"], p_WK, in_world=True, unit="mm")


FORMATS["my_glove"] = Format("my glove, 21 markers", (".npz",), lambda contents: "markers" in contents, read)
