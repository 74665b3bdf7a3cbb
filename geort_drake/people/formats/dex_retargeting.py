"""dex-retargeting's .pkl of human hands: a list of (21, 3) arrays, one per frame, None where none was seen.

MediaPipe's world landmarks in its order, m, moved to the wrist and turned to the "operator" axes, whose
orientation comes from wrist, index and middle knuckles; no times, no wrist pose. Unpickled without running
anything that the file names (see `unpickling`).

Source: https://github.com/dexsuite/dex-retargeting, example/profiling/generate_human_data_from_video.py and
example/vector_retargeting/single_hand_detector.py
"""

from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.formats.tracks import Tracks, numbers, shape_of

SUFFIXES = (".pkl", ".pickle")


def recognizes(contents: Any) -> bool:
    if isinstance(contents, np.ndarray):
        return contents.shape[1:] == (21, 3)
    return isinstance(contents, list) and any(isinstance(frame, np.ndarray) for frame in contents)


def read(name: str, contents: Any, side: str) -> Tracks:
    if not isinstance(contents, list | np.ndarray):
        raise RecordingError(f"{name}: a list of (21, 3) arrays is wanted, not {type(contents).__name__}")
    for i, frame in enumerate(contents):
        if frame is not None and shape_of(frame) != (21, 3):
            raise RecordingError(f"{name}: frame {i} must have shape (21, 3), not {shape_of(frame)}")
    lost = np.full((21, 3), np.nan)
    return Tracks(numbers(name, "the list", [lost if f is None else f for f in contents], (21, 3)))
