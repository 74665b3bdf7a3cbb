"""CSV export of MANUS Core: a header, then one row per frame, found by the columns' names.

Columns: `Frame`, `Elapsed_Time_In_Milliseconds`, `Time`, then `_X`, `_Y` and `_Z` of `Hand`, of `Thumb_` CMC,
MCP, DIP, TIP, and of `Index_`, `Middle_`, `Ring_` and `Pinky_` CMC, MCP, PIP, DIP, TIP, where a finger's
CMC is the base of its metacarpal. Rotations, velocities and other columns are left alone. The export
names no side, and MANUS documents no unit: metres are taken, and a hand of another size is refused.

Source: https://docs.manus-meta.com/2.4.0/Software/Rec/Exporting%20csv
"""

from typing import Any

import numpy as np

from geort_drake.errors import RecordingError
from geort_drake.gloves.formats.files import Table
from geort_drake.gloves.formats.tracks import Tracks
from geort_drake.gloves.health.findings import Finding, Severity

SUFFIXES = (".csv",)

_ELAPSED = "Elapsed_Time_In_Milliseconds"
# Of each keypoint. The thumb's interphalangeal joint is called DIP.
_JOINTS = ("Hand", *(f"Thumb_{joint}" for joint in ("CMC", "MCP", "DIP", "TIP"))) + tuple(
    f"{finger}_{joint}"
    for finger in ("Index", "Middle", "Ring", "Pinky")
    for joint in ("MCP", "PIP", "DIP", "TIP")
)
_COLUMNS = tuple(f"{joint}_{axis}" for joint in _JOINTS for axis in "XYZ")


def recognizes(contents: Any) -> bool:
    return isinstance(contents, Table) and any(name.startswith("Thumb_CMC_") for name in contents.header)


def read(name: str, contents: Table, side: str) -> Tracks:
    missing = [column for column in _COLUMNS if column not in contents.header]
    if missing:
        angles = any(column.endswith(("_Flex", "_Spread")) for column in contents.header)
        raise RecordingError(
            f"{name}: the header lacks {len(missing)} of the joint positions' {len(_COLUMNS)} columns, "
            f"such as {missing[0]}"
            + ("; these are ergonomics, that is joint angles: export joint positions" if angles else "")
        )
    twice = [column for column in (*_COLUMNS, _ELAPSED) if contents.header.count(column) > 1]
    if twice:
        raise RecordingError(f"{name}: the header has the column {twice[0]} more than once")
    p_WK = np.stack([_column(name, contents, column) for column in _COLUMNS], axis=1).reshape(-1, 21, 3)
    t = _column(name, contents, _ELAPSED) * 1e-3 if _ELAPSED in contents.header else None
    findings = []
    if "Frame" in contents.header and len(contents.rows):
        number = _column(name, contents, "Frame")
        skipped = (np.diff(number) - 1).clip(0)
        if skipped.any():
            after = int(np.argmax(skipped > 0))
            findings.append(
                Finding(
                    "dropped frames",
                    Severity.WARNING,
                    f"{int(skipped.sum())} frames are missing, the first after frame {int(number[after])}",
                    f"Frame, line {after + 3}",
                    "look at the radio link or the recorder's load",
                )
            )
    return Tracks(p_WK, t, world=True, findings=findings)


def _column(name: str, table: Table, column: str) -> np.ndarray:
    """Numbers (T,) of a column; NaN where a cell is empty."""
    place = table.header.index(column)
    values = np.empty(len(table.rows))
    for i, row in enumerate(table.rows):
        if len(row) != len(table.header):
            raise RecordingError(
                f"{name}: line {i + 2} has {len(row)} cells, the header has {len(table.header)}"
            )
        try:
            values[i] = float(row[place]) if row[place].strip() else np.nan
        except ValueError:
            raise RecordingError(
                f"{name}: line {i + 2}, column {column} must be a number, not '{row[place]}'"
            ) from None
    return values
