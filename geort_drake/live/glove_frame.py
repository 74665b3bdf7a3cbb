"""One moment of a glove as a message: the wire format, and its checks.

UTF-8 JSON, at most `MAX_BYTES` long, with exactly the keys of `GloveFrame` besides format, version and unit:
    format      "geort_drake.glove"
    version     1
    unit        "m"
    side        "right" or "left"
    time        when the hand was like this, s on the sender's clock, which never runs backwards
    p_HK        21 keypoints [x, y, z] in the wrist frame H, as recordings hold them; null while lost
    X_WH        [qw, qx, qy, qz, x, y, z] of the wrist in the tracker's world; null without a tracker
docs/reference/messages.md shows one. Bridges of other makers are read in `manus_bridge`.
"""

import dataclasses as dc
import json
import math
from typing import Any

import numpy as np

from geort_drake.errors import LiveError, MismatchError
from geort_drake.people.keypoints import KEYPOINT_COUNT
from geort_drake.people.recording import SIDES

FORMAT, VERSION, UNIT = "geort_drake.glove", 1, "m"
# Ours take 2 kB; MANUS bridges add sensors and joint angles, up to 10 kB.
MAX_BYTES = 65_536
# No hand is farther from its wrist, nor any tracker's wrist from its origin, m.
FARTHEST_M = 100.0


@dc.dataclass(frozen=True, eq=False)
class GloveFrame:
    """A hand at one moment.

    Attributes:
        side: "right" or "left"; a left hand is given as its mirror image, as in `Recording`.
        time: s on the sender's clock; None where the sender says none.
        p_HK: (21, 3), m, wrist frame H; None while the glove has lost the hand.
        X_WH: (7,) qw qx qy qz x y z, m; None without a tracker.
    """

    side: str
    time: float | None = None
    p_HK: np.ndarray | None = None
    X_WH: np.ndarray | None = None


def encode_frame(frame: GloveFrame) -> bytes:
    """The message of a frame that has a time."""
    fields = {
        "format": FORMAT,
        "version": VERSION,
        "unit": UNIT,
        "side": frame.side,
        "time": frame.time,
        "p_HK": None if frame.p_HK is None else np.asarray(frame.p_HK, float).tolist(),
        "X_WH": None if frame.X_WH is None else np.asarray(frame.X_WH, float).tolist(),
    }
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode()


def decode_frame(fields: dict[str, Any]) -> GloveFrame:
    """The frame in a message's fields.

    Raises:
        MismatchError: another version or unit.
        LiveError: a field is missing, unknown or not what it must be.
    """
    for name, wanted in (("version", VERSION), ("unit", UNIT)):
        if fields.get(name) != wanted or isinstance(fields[name], bool):
            raise MismatchError(
                f"glove message: {name} must be {wanted!r}, which is read here, not {fields.get(name)!r:.40}"
            )
    names = {"format", "version", "unit", *(field.name for field in dc.fields(GloveFrame))}
    if fields.keys() != names:
        wrong = ", ".join(sorted(fields.keys() ^ names))[:80]
        raise LiveError(f"glove message: must have the fields {', '.join(sorted(names))}; differs in {wrong}")
    p_HK, X_WH = fields["p_HK"], fields["X_WH"]
    if X_WH is not None:
        X_WH = _numbers("X_WH", X_WH, 7)
        if abs(np.linalg.norm(X_WH[:4]) - 1.0) > 1e-2:
            raise LiveError(f"glove message: X_WH must begin with a unit quaternion, not {X_WH[:4].tolist()}")
    if p_HK is not None:
        if not isinstance(p_HK, list) or len(p_HK) != KEYPOINT_COUNT:
            raise LiveError(f"glove message: p_HK must be {KEYPOINT_COUNT} points")
        p_HK = np.stack([_numbers("p_HK", point, 3) for point in p_HK])
    return GloveFrame(side_of(fields), float(_numbers("time", [fields["time"]], 1, math.inf)[0]), p_HK, X_WH)


def parse_json(message: bytes) -> dict[str, Any]:
    """A message's JSON object; NaN and infinity are none.

    Raises:
        LiveError: it is none.
    """
    try:
        fields = json.loads(message.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise LiveError(f"glove message: not JSON: {error!s:.80}") from None
    if not isinstance(fields, dict):
        raise LiveError(f"glove message: a JSON object is wanted, not {type(fields).__name__}")
    return fields


def side_of(fields: dict[str, Any]) -> str:
    """The side that a message states, in whichever case.

    Raises:
        LiveError: neither right nor left.
    """
    side = str(fields.get("side")).lower()
    if side not in SIDES:
        raise LiveError(f"glove message: side must be one of {', '.join(SIDES)}, not {side:.40}")
    return side


def _numbers(name: str, value: Any, size: int, largest: float = FARTHEST_M) -> np.ndarray:
    """`size` finite numbers, no larger than `largest`."""
    numbers = isinstance(value, list) and len(value) == size
    if not numbers or not all(type(number) in (int, float) for number in value):
        raise LiveError(f"glove message: {name} must hold {size} numbers, not {value!r:.60}")
    try:
        array = np.array([float(number) for number in value])
    except OverflowError:
        array = np.full(size, math.inf)
    if not (np.isfinite(array).all() and np.abs(array).max() <= largest):
        raise LiveError(f"glove message: {name} must be finite and at most {largest:g}, not {value!r:.60}")
    return array


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")
