"""Raw MANUS skeletons in .npz: `data` (T, 25, 7) of `px py pz qw qx qy qz`, m, and Unix `timestamps`, s.

Nodes: wrist 0; thumb 1–4 (CMC, MCP, IP, tip); then five each of index, middle, ring and little finger:
metacarpal base, MCP, PIP, DIP, tip. Optional `keypoint_ids` (25) give their order and `chirality` the
side. The frame is the one the client of MANUS Core chose; the wrist's own quaternion turns with frame H
up to a constant and the arching of the palm (6° at most), so the keypoints give the wrist's pose.

Source: https://github.com/mimicrobotics/mimic_retargeter_lab, whose published recordings these are.
"""

from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.formats.tracks import (
    KEYPOINTS_OF_25,
    Tracks,
    check_quaternions,
    numbers,
    side_of,
    times,
)

SUFFIXES = (".npz",)


def recognizes(contents: Any) -> bool:
    if "data" not in contents:
        return False
    return "timestamps" in contents or contents["data"].shape[1:] == (25, 7)


def read(name: str, contents: Any, side: str) -> Tracks:
    if "data" not in contents:
        raise RecordingError(f"{name}: a raw MANUS file holds data, timestamps; not {', '.join(contents)}")
    data = numbers(name, "data", contents["data"], (25, 7))
    check_quaternions(name, "data", data)
    nodes = np.asarray(contents.get("keypoint_ids", np.arange(25)))
    if nodes.shape != (25,) or sorted(nodes.tolist()) != list(range(25)):
        raise RecordingError(f"{name}: keypoint_ids must be the numbers 0 to 24 in some order")
    p_WK = data[:, np.argsort(nodes), :3][:, KEYPOINTS_OF_25]
    return Tracks(p_WK, times(name, contents, len(data)), world=True, side=side_of(name, contents))
