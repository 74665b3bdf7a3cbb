"""MANUS gloves: raw skeletons in .npz, and the CSV export of MANUS Core.

Raw skeletons: `data` (T, 25, 7) of `px py pz qw qx qy qz`, m, and Unix `timestamps`, s. Nodes: wrist 0;
thumb 1-4 (CMC, MCP, IP, tip); then five each of index, middle, ring and little finger: metacarpal base,
MCP, PIP, DIP, tip. Optional `keypoint_ids` (25) give their order and `chirality` the side. The client of
MANUS Core chose the frame. The keypoints give the wrist's pose, and quaternions are not used.
Source: https://github.com/mimicrobotics/mimic_retargeter_lab, whose published recordings these are.

CSV: a header, then one row per frame. Columns: `Frame`, `Elapsed_Time_In_Milliseconds`, `Time`, then the
coordinates of `Hand`, of `Thumb_` CMC, MCP, DIP, TIP, and of `Index_`, `Middle_`, `Ring_` and `Pinky_` CMC,
MCP, PIP, DIP, TIP, where a finger's CMC is the base of its metacarpal. Other columns are ignored.
Coordinates have two names: `Hand_X`, which MANUS documents for Core 2.4 without a unit (metres are
assumed), and `Hand_Position_X`, in centimetres, in exports that people publish.

MANUS documents neither axes nor side. Of published exports there is one for each hand, whose name ends with
`_L` or `_R`, in axes chosen at the export. Left-handed axes are recognised by the fingers bending
backwards; then x is negated. Without a tracker, positions seem to be given from the hand itself: the ends
of the palm never move.
Source: https://docs.manus-meta.com/2.4.0/Software/Rec/Exporting%20csv for the first names, and
https://github.com/jeannebelorgey/Metaglove-Ergo-Analysis/tree/main/data for the second and all else
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import Finding, warning
from geort_drake.people.checks.timing import TIME_UNITS_S
from geort_drake.people.formats.source import (
    KEYPOINTS_OF_25,
    BadFrame,
    Clock,
    Format,
    Source,
    Table,
    Tracks,
    shape_in,
)

NODE_COUNT = 25
_FRAME, _ELAPSED = "Frame", "Elapsed_Time_In_Milliseconds"
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
        numbers: of each node.

    Raises:
        ValueError: the numbers are not those of all nodes.
    """
    if not isinstance(numbers, Sequence) or sorted(numbers) != list(range(NODE_COUNT)):
        raise ValueError(f"must be the numbers 0 to {NODE_COUNT - 1} in some order")
    return p_WN[..., np.argsort(numbers), :][..., KEYPOINTS_OF_25, :]


def _is_raw(contents: Any) -> bool:
    if not isinstance(contents, Mapping) or "data" not in contents:
        return False
    return "timestamps" in contents or shape_in(contents, "data")[1:] == (25, 7)


def _read_raw(file: Source, side: str) -> Tracks:
    p, _ = file.positions("data", file.array("data", (25, 7)))
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
    columns = _columns(_JOINTS, infix)
    if missing := [column for column in columns if column not in header]:
        angles = any(name.endswith(("_Flex", "_Spread")) for name in header)
        raise file.error(
            f"the header lacks {len(missing)} of the joint positions' {len(columns)} columns, such as "
            + missing[0]
            + ("; these are ergonomics, that is joint angles: export joint positions" if angles else "")
        )
    others = [name for name in (_ELAPSED, _FRAME, *_columns(_PALM_ENDS, infix)) if name in header]
    if twice := next((name for name in (*columns, *others) if header.count(name) > 1), None):
        raise file.error(f"the header has the column {twice} more than once")
    values = _numbers(file, [*columns, *others])
    p_WK = values[:, : len(columns)].reshape(-1, 21, 3)
    other = dict(zip(others, values[:, len(columns) :].T, strict=True))
    clock = Clock(other[_ELAPSED] * TIME_UNITS_S["ms"], _ELAPSED, "ms") if _ELAPSED in other else None
    findings = _skipped_frames(other[_FRAME]) if _FRAME in other else []
    named = re.search(r"_([LR])$", Path(file.name).stem)
    stated = _SIDES[named[1]] if named else None
    if stated == side and bent_side(p_WK, side) != side:
        p_WK = p_WK * [-1, 1, 1]
        findings.append(
            warning(
                "axes",
                f"the axes are left-handed: the fingers of this {side} hand (according to the file's name) "
                "bend backwards",
                "*_X",
                "read with the x axis negated",
            )
        )
    palm = [other[name] for name in _columns(_PALM_ENDS, infix) if name in other]
    from_hand = len(palm) == 9 and all(_is_constant(values) for values in palm)
    return Tracks(p_WK, clock, world=not from_hand, side=stated, unit=unit, findings=findings)


def _columns(joints: tuple[str, ...], infix: str) -> list[str]:
    return [f"{joint}{infix}_{axis}" for joint in joints for axis in "XYZ"]


def _numbers(file: Source, columns: list[str]) -> np.ndarray:
    """Numbers (T, len(columns)) of a table; NaN where a cell is empty, or the row cannot be read."""
    header = file.contents.header
    places = [header.index(column) for column in columns]

    def read(numbered: tuple[int, Sequence[str]]) -> list[float]:
        line, row = numbered
        if len(row) != len(header):
            commas = "; are decimals written with commas? Write them with points" * (len(row) > len(header))
            raise BadFrame(f"line {line} has {len(row)} cells, the header has {len(header)}{commas}")
        return [_number(row[place], line, column) for place, column in zip(places, columns, strict=True)]

    return file.each(list(enumerate(file.contents.rows, 2)), read, (len(columns),), "cells")


def _number(cell: str, line: int, column: str) -> float:
    try:
        return float(cell) if cell.strip() else np.nan
    except ValueError:
        comma = re.fullmatch(r"\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*", cell, re.IGNORECASE)
        advice = "; write decimals with points, not with commas" if comma else ""
        raise BadFrame(f"line {line}, column {column} must be a number, not '{cell:.40}'{advice}") from None


def _is_constant(values: np.ndarray) -> bool:
    """Whether a column has one value, but for a few faulty frames."""
    return bool((values == np.nanmedian(values)).mean() > 0.9) if np.isfinite(values).any() else False


def _skipped_frames(number: np.ndarray) -> list[Finding]:
    steps = np.nan_to_num(np.diff(number))
    # Larger steps are faults of the number itself.
    skipped = np.where(steps < len(number), steps - 1, 0).clip(0)
    if not skipped.any():
        return []
    after = int(np.argmax(skipped > 0))
    what = f"{int(skipped.sum())} frames are missing, the first after frame {int(number[after])}"
    advice = "look at the radio link or the recorder's load"
    return [warning("dropped frames", what, f"Frame, line {after + 3}", advice)]


RAW = Format("raw MANUS skeleton, 25 nodes", (".npz",), _is_raw, _read_raw)
CSV = Format("MANUS Core's CSV export", (".csv",), _is_csv, _read_csv)
