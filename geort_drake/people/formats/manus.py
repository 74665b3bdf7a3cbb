"""MANUS gloves: raw skeletons in .npz, and the CSV export of MANUS Core.

Raw skeletons: `data` (T, 25, 7) of `px py pz qw qx qy qz`, m, and Unix `timestamps`, s. Nodes: wrist 0;
thumb 1-4 (CMC, MCP, IP, tip); then five each of index, middle, ring and little finger: metacarpal base,
MCP, PIP, DIP, tip. Optional `keypoint_ids` (25) give the nodes' order, `chirality` the side. Quaternions are
ignored.
Source: https://github.com/mimicrobotics/mimic_retargeter_lab, whose published recordings these are.

CSV: `Elapsed_Time_In_Milliseconds` and joint positions. `Hand_X` is documented for Core 2.4 without a unit
(metres are assumed), `Hand_Position_X` in centimetres in published exports. A finger's `CMC` is the base of
its metacarpal. MANUS documents neither axes nor side. Published exports contain one hand each; the file's
name ends with `_L` or `_R`. The user chooses the axes at export. If the fingers bend backwards, the axes are
left-handed, and x is negated. Without a tracker, the ends of the palm never move.
Source: https://docs.manus-meta.com/2.4.0/Software/Rec/Exporting%20csv for the first names, and
https://github.com/jeannebelorgey/Metaglove-Ergo-Analysis/tree/main/data for the second and all else
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import warning
from geort_drake.people.formats.contents import BadFrame, Table, shape_in
from geort_drake.people.formats.source import KEYPOINTS_OF_25, Format, Source, Tracks

NODE_COUNT = 25

_ELAPSED = "Elapsed_Time_In_Milliseconds"
# The 21 keypoints. The thumb's interphalangeal joint is called DIP.
_JOINTS = ("Hand", *(f"Thumb_{joint}" for joint in ("CMC", "MCP", "DIP", "TIP"))) + tuple(
    f"{finger}_{joint}"
    for finger in ("Index", "Middle", "Ring", "Pinky")
    for joint in ("MCP", "PIP", "DIP", "TIP")
)
_PALM_ENDS = ("Hand", "Index_CMC", "Pinky_CMC")
_SIDES = {"L": "left", "R": "right"}


def keypoints_of_nodes(p_WN: np.ndarray, numbers: Sequence[int] = range(NODE_COUNT)) -> np.ndarray:
    """Returns the 21 keypoints p_WK (..., 21, 3) of a skeleton's nodes p_WN (..., 25, 3).

    Args:
        p_WN: the nodes, in any frame W and unit.
        numbers: number of each node, a permutation of 0 to 24.

    Raises:
        ValueError: the numbers are no such permutation.
    """
    if not isinstance(numbers, Sequence) or sorted(numbers) != list(range(NODE_COUNT)):
        raise ValueError(f"must be the numbers 0 to {NODE_COUNT - 1} in some order")
    return p_WN[..., np.argsort(numbers), :][..., KEYPOINTS_OF_25, :]


def _is_raw(contents: Any) -> bool:
    if not isinstance(contents, Mapping) or "data" not in contents:
        return False
    return "timestamps" in contents or shape_in(contents, "data")[1:] == (25, 7)


def _read_raw(file: Source, side: str) -> Tracks:
    p = file.array("data", (25, 7))[..., :3]
    try:
        p_WK = keypoints_of_nodes(p, np.asarray(file.header.get("keypoint_ids", range(NODE_COUNT))).tolist())
    except (TypeError, ValueError) as error:
        raise file.error(f"keypoint_ids {error}") from None
    return Tracks(p_WK, file.times(len(p)), world=True, side=file.side())


def _is_csv(contents: Any) -> bool:
    return isinstance(contents, Table) and any(name.startswith("Thumb_CMC_") for name in contents.header)


def _read_csv(file: Source, side: str) -> Tracks:
    header: list[str] = file.contents.header
    infix, unit = ("_Position", "cm") if any("_CMC_Position_" in name for name in header) else ("", "m")
    columns, palm = (
        [f"{joint}{infix}_{axis}" for joint in joints for axis in "XYZ"] for joints in (_JOINTS, _PALM_ENDS)
    )
    if missing := [column for column in columns if column not in header]:
        what = f"the header lacks {len(missing)} of {len(columns)} columns with joint positions, such as "
        raise file.error(what + missing[0])
    others = [name for name in (_ELAPSED, *palm) if name in header]
    if twice := next((name for name in (*columns, *others) if header.count(name) > 1), None):
        raise file.error(f"the header has the column {twice} more than once")
    values = _numbers(file, [*columns, *others])
    p_WK = values[:, : len(columns)].reshape(-1, 21, 3)
    other = dict(zip(others, values[:, len(columns) :].T, strict=True))
    stated = next((name for end, name in _SIDES.items() if Path(file.name).stem.endswith(f"_{end}")), None)
    if stated == side and bent_side(p_WK, side) != side:
        p_WK = p_WK * [-1, 1, 1]
        what = f"the axes are left-handed: by the file's name a {side} hand, but its fingers bend backwards"
        file.findings.append(warning("axes", what, "*_X", "read with the x axis negated"))
    from_hand = all(name in other and _is_constant(other[name]) for name in palm)
    t = 1e-3 * other[_ELAPSED] if _ELAPSED in other else None
    return Tracks(p_WK, t, world=not from_hand, side=stated, unit=unit)


def _numbers(file: Source, columns: list[str]) -> np.ndarray:
    """Returns the numbers (T, len(columns)) of a table; NaN if a cell is empty or its row unreadable."""
    header = file.contents.header
    places = [header.index(column) for column in columns]

    def read(numbered: tuple[int, Sequence[str]]) -> list[float]:
        line, row = numbered
        if len(row) != len(header):
            raise BadFrame(f"line {line} has {len(row)} cells, the header has {len(header)}")
        try:
            return [float(row[place].strip() or "nan") for place in places]
        except ValueError as error:
            raise BadFrame(f"line {line} must contain numbers with decimal points: {error}") from None

    return file.each(list(enumerate(file.contents.rows, 2)), read, (len(columns),), "cells")


def _is_constant(values: np.ndarray) -> bool:
    """Whether a column is constant, except for a few faulty frames."""
    return bool((values == np.nanmedian(values)).mean() > 0.9) if np.isfinite(values).any() else False


RAW = Format("raw MANUS skeleton, 25 nodes", (".npz",), _is_raw, _read_raw)
CSV = Format("MANUS Core's CSV export", (".csv",), _is_csv, _read_csv)
