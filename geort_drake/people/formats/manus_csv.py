"""CSV export of MANUS Core: a header, then one row per frame, found by the columns' names.

Columns: `Frame`, `Elapsed_Time_In_Milliseconds`, `Time`, then the coordinates of `Hand`, of `Thumb_` CMC,
MCP, DIP, TIP, and of `Index_`, `Middle_`, `Ring_` and `Pinky_` CMC, MCP, PIP, DIP, TIP, where a finger's CMC
is the base of its metacarpal. Rotations, velocities and others are left alone. Coordinates have two names:

`Hand_X`: MANUS documents these for Core 2.4, and no unit; metres are taken.
`Hand_Position_X`: those of exports that people publish, which are in centimetres.

MANUS documents neither axes nor side. Of published exports there is one for each hand, its name ends with
`_L` or `_R`, and axes were chosen at the export. Left-handed ones are found by the way the fingers of a
hand of known side bend; the x axis then is turned round. Without a tracker, as it seems, all is
given from the hand itself, and the bases of its metacarpals never move.

Source: https://docs.manus-meta.com/2.4.0/Software/Rec/Exporting%20csv for the first names,
https://github.com/jeannebelorgey/Metaglove-Ergo-Analysis/tree/main/data for the second and all else
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.people.checks.anatomy import bent_side
from geort_drake.people.checks.findings import Finding, Severity
from geort_drake.people.checks.timing import TIME_UNITS_S
from geort_drake.people.formats.files import Table
from geort_drake.people.formats.tracks import Clock, Tracks

SUFFIXES = (".csv",)

_ELAPSED = "Elapsed_Time_In_Milliseconds"
# Of each keypoint. The thumb's interphalangeal joint is called DIP.
_JOINTS = ("Hand", *(f"Thumb_{joint}" for joint in ("CMC", "MCP", "DIP", "TIP"))) + tuple(
    f"{finger}_{joint}"
    for finger in ("Index", "Middle", "Ring", "Pinky")
    for joint in ("MCP", "PIP", "DIP", "TIP")
)
# The palm's ends, which do not move where all is given from the hand.
_PALM = ("Hand", "Index_CMC", "Pinky_CMC")
# What stands between joint and axis, and the unit.
_NAMINGS = {"": "m", "_Position": "cm"}
_SIDES = {"L": "left", "R": "right"}


def recognizes(contents: Any) -> bool:
    return isinstance(contents, Table) and any(name.startswith("Thumb_CMC_") for name in contents.header)


def read(name: str, contents: Table, side: str) -> Tracks:
    naming = "_Position" if any("_CMC_Position_" in column for column in contents.header) else ""
    columns = _columns(_JOINTS, naming)
    missing = [column for column in columns if column not in contents.header]
    if missing:
        angles = any(column.endswith(("_Flex", "_Spread")) for column in contents.header)
        raise RecordingError(
            f"{name}: the header lacks {len(missing)} of the joint positions' {len(columns)} columns, "
            f"such as {missing[0]}"
            + ("; these are ergonomics, that is joint angles: export joint positions" if angles else "")
        )
    twice = [column for column in (*columns, _ELAPSED) if contents.header.count(column) > 1]
    if twice:
        raise RecordingError(f"{name}: the header has the column {twice[0]} more than once")
    p_WK = np.stack([_column(name, contents, column) for column in columns], axis=1).reshape(-1, 21, 3)
    clock = None
    if _ELAPSED in contents.header:
        clock = Clock(_column(name, contents, _ELAPSED) * TIME_UNITS_S["ms"], _ELAPSED, "ms")
    findings = _skipped_frames(name, contents)
    named = re.search(r"_([LR])$", Path(name).stem)
    if named and _SIDES[named[1]] == side and bent_side(p_WK, side) != side:
        p_WK = p_WK * [-1, 1, 1]
        findings.append(
            Finding(
                "axes",
                Severity.WARNING,
                f"the axes are left-handed: in them the fingers of this {side} hand, as the file's name "
                "has it, bend backwards",
                "*_X",
                "read with the x axis turned round",
            )
        )
    return Tracks(
        p_WK,
        clock,
        world=not _is_from_hand(name, contents, naming),
        side=_SIDES[named[1]] if named else None,
        unit=_NAMINGS[naming],
        findings=findings,
    )


def _columns(joints: tuple[str, ...], naming: str) -> tuple[str, ...]:
    return tuple(f"{joint}{naming}_{axis}" for joint in joints for axis in "XYZ")


def _is_from_hand(name: str, table: Table, naming: str) -> bool:
    columns = [column for column in _columns(_PALM, naming) if column in table.header]
    values = np.stack([_column(name, table, column) for column in columns], axis=1)
    return len(columns) == 3 * len(_PALM) and bool((values == values[:1]).all())


def _skipped_frames(name: str, table: Table) -> list[Finding]:
    if "Frame" not in table.header or not len(table.rows):
        return []
    number = _column(name, table, "Frame")
    skipped = (np.diff(number) - 1).clip(0)
    if not skipped.any():
        return []
    after = int(np.argmax(skipped > 0))
    finding = Finding(
        "dropped frames",
        Severity.WARNING,
        f"{int(skipped.sum())} frames are missing, the first after frame {int(number[after])}",
        f"Frame, line {after + 3}",
        "look at the radio link or the recorder's load",
    )
    return [finding]


def _column(name: str, table: Table, column: str) -> np.ndarray:
    """Numbers (T,) of a column; NaN where a cell is empty."""
    place = table.header.index(column)
    values = np.empty(len(table.rows))
    for i, row in enumerate(table.rows):
        if len(row) != len(table.header):
            split = "; are decimals written with commas? Write them with points"
            raise RecordingError(
                f"{name}: line {i + 2} has {len(row)} cells, the header has {len(table.header)}"
                + (split if len(row) > len(table.header) else "")
            )
        try:
            values[i] = float(row[place]) if row[place].strip() else np.nan
        except ValueError:
            comma = re.fullmatch(r"\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*", row[place], re.IGNORECASE)
            raise RecordingError(
                f"{name}: line {i + 2}, column {column} must be a number, not '{row[place]}'"
                + ("; write decimals with points, not with commas" if comma else "")
            ) from None
    return values
