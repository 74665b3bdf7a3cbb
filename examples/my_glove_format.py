"""Reads my glove's .npz: `markers` (T, 21, 3), mm, wrist last; `time` (T,), s."""

import numpy as np

from geort_drake.people.formats import FORMATS, File, Format, Track

ORDER = [20, *range(20)]  # indices of our keypoints in the file


def read(file: File, side: str) -> Track:
    """Returns times and keypoints as the file stores them; `side` is the one that the user wants."""
    p_WK = np.asarray(file.fields["markers"], dtype=float)[:, ORDER]
    return Track(file.fields["time"], p_WK, in_world=True, unit="mm")


FORMATS["my_glove"] = Format("my glove, 21 markers", (".npz",), lambda file: "markers" in file.fields, read)
