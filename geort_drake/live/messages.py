"""Decodes messages from gloves: the package's own JSON format, and skeletons from MANUS bridges.

The package's own format is UTF-8 JSON of at most 64 KiB with exactly these fields:

    format      "geort_drake.glove"
    version     1
    unit        "m"
    side        "right" or "left"
    time        when the hand was measured, s, on the sender's clock, which must not run backwards
    p_HK        21 keypoints [x, y, z] in the wrist frame H, a left hand mirrored; null while the hand is lost
    X_WH        [qw, qx, qy, qz, x, y, z], the wrist's pose in the tracker's world; null without a tracker;
                a norm within 0.2 of 1 is scaled to 1

MANUS bridges send 25 nodes, numbered as in recordings, without a time; the time of arrival replaces it:

    text        "ID,x,y,z,qx,qy,qz,qw,x,y,z,…": a glove's serial number and 25 poses, m; or two gloves in a
                row, of which --glove-id selects one. Pushed to port 8000 by BiDex's client,
                https://github.com/leap-hand/Bidex_Manus_Teleop
    ManusGlove  the message of MANUS' ROS 2 package as JSON, with `side`, `glove_id` and `raw_nodes`, each
                with `node_id` and `pose`; published, for example, by manus_ros2_transporter

Ergonomics values are joint angles, which are refused.
"""

import dataclasses as dc
import json
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.transports import MAX_BYTES
from geort_drake.people.checks import NORM_REPAIRABLE, NORM_TOLERANCE
from geort_drake.people.formats import NODE_COUNT, keypoints_of_nodes
from geort_drake.people.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame, wrist_pose
from geort_drake.people.recording import SIDES

FORMAT, VERSION = "geort_drake.glove", 1
_FIELDS = {"format", "version", "unit", "side", "time", "p_HK", "X_WH"}
# Largest accepted coordinate, m.
_MAX_DISTANCE_M = 100.0
_TEXT_VALUES = 1 + 7 * NODE_COUNT  # number of values of one glove in the text form
_ERGONOMICS_VALUES = (20, 40)  # number of joint angles of one or two hands, which bridges can send instead


@dc.dataclass(frozen=True, eq=False)
class GloveFrame:
    """A hand at one moment.

    Attributes:
        side: "right" or "left"; a left hand is given as its mirror image, as in `Recording`.
        time: time of measurement, s, on the sender's clock; None if the message has none.
        p_HK: (21, 3) keypoints in the wrist frame H, m; None while the glove has lost the hand.
        X_WH: (7,) wrist pose, qw qx qy qz x y z, m; None without a tracker.
        repaired: whether the quaternion of X_WH was scaled to norm 1.
    """

    side: str
    time: float | None = None
    p_HK: np.ndarray | None = None
    X_WH: np.ndarray | None = None
    repaired: bool = False


def encode_frame(frame: GloveFrame) -> bytes:
    """Encodes a frame with a time as a message in the package's own format."""
    fields = {
        "format": FORMAT,
        "version": VERSION,
        "unit": "m",
        "side": frame.side,
        "time": frame.time,
        "p_HK": None if frame.p_HK is None else np.asarray(frame.p_HK, float).tolist(),
        "X_WH": None if frame.X_WH is None else np.asarray(frame.X_WH, float).tolist(),
    }
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode()


def decode(message: bytes, side: str, glove_id: str | None = None) -> GloveFrame | None:
    """Returns the frame in a message of any known form; None if it is from another glove.

    Args:
        message: bytes of the message, from which its form is recognised.
        side: "right" or "left", of the robot's hand.
        glove_id: serial number of the MANUS glove to read, if there are several.

    Raises:
        MismatchError: another version, unit or side; joint angles; or two gloves without a `glove_id`.
        LiveError: the message is too long or malformed.
    """
    if len(message) > MAX_BYTES:
        raise LiveError(f"glove message: {len(message)} bytes; at most {MAX_BYTES} are read")
    if not message.lstrip().startswith(b"{"):
        return _decode_manus_text(message, side, glove_id)
    fields = _parse_json(message)
    if fields.get("format") == FORMAT:
        frame = _decode_own(fields)
    elif "raw_nodes" in fields:
        if glove_id is not None and str(fields.get("glove_id")).lower() != glove_id.lower():
            return None
        frame = _decode_manus_glove(fields)
    else:
        raise LiveError(f"glove message: neither of format {FORMAT} nor a ManusGlove with raw_nodes")
    if frame.side != side:
        raise MismatchError(f"glove message: a {frame.side} hand is sent, but the robot's is a {side} one")
    return frame


def _decode_own(fields: dict[str, Any]) -> GloveFrame:
    for name, expected in (("version", VERSION), ("unit", "m")):
        value = fields.get(name)
        if value != expected or isinstance(value, bool):
            raise MismatchError(f"glove message: {name} must be {expected!r}, not {value!r:.40}")
    if fields.keys() != _FIELDS:
        wrong = ", ".join(sorted(fields.keys() ^ _FIELDS))[:80]
        raise LiveError(
            f"glove message: must have the fields {', '.join(sorted(_FIELDS))}; differs in {wrong}"
        )
    p_HK, X_WH, repaired = fields["p_HK"], fields["X_WH"], False
    if X_WH is not None:
        X_WH = _numbers("X_WH", X_WH, (7,), _MAX_DISTANCE_M)
        norm = float(np.linalg.norm(X_WH[:4]))
        if abs(norm - 1.0) > NORM_REPAIRABLE:
            raise LiveError(
                f"glove message: X_WH must begin with a unit quaternion, not {X_WH[:4].tolist()}, whose norm "
                f"is {norm:.3g}"
            )
        if abs(norm - 1.0) > NORM_TOLERANCE:
            X_WH[:4] /= norm
            repaired = True
    if p_HK is not None:
        p_HK = _numbers("p_HK", p_HK, (KEYPOINT_COUNT, 3), _MAX_DISTANCE_M)
    return GloveFrame(_side_of(fields), float(_numbers("time", fields["time"], ())), p_HK, X_WH, repaired)


def _decode_manus_text(message: bytes, side: str, glove_id: str | None) -> GloveFrame | None:
    words = message.decode("ascii", errors="replace").strip().split(",")
    if len(words) in _ERGONOMICS_VALUES:
        raise MismatchError(
            f"MANUS message: {len(words)} values are joint angles (ergonomics); send raw skeletons"
        )
    if len(words) not in (_TEXT_VALUES, 2 * _TEXT_VALUES):
        raise LiveError(
            f"MANUS message: expected {_TEXT_VALUES} values, or twice that for two gloves, not {len(words)}"
        )
    gloves = [words[start : start + _TEXT_VALUES] for start in range(0, len(words), _TEXT_VALUES)]
    if glove_id is None and len(gloves) > 1:
        ids = ", ".join(glove[0][:20] for glove in gloves)
        raise MismatchError(f"MANUS message: there are two gloves; choose one with --glove-id: {ids}")
    for glove in gloves:
        if glove_id is None or glove[0].strip().lower() == glove_id.lower():
            try:
                poses = np.array([float(word) for word in glove[1:]]).reshape(NODE_COUNT, 7)
            except ValueError as error:
                raise LiveError(f"MANUS message: {error!s:.80}") from None
            return frame_of_points(keypoints_of_nodes(poses[:, :3]), side)
    return None


def _decode_manus_glove(fields: dict[str, Any]) -> GloveFrame:
    try:
        nodes = [(node["node_id"], node["pose"]["position"]) for node in fields["raw_nodes"]]
        points = [[position[axis] for axis in "xyz"] for _, position in nodes]
        p_WK = keypoints_of_nodes(
            _numbers("raw_nodes", points, (NODE_COUNT, 3)), [number for number, _ in nodes]
        )
    except (KeyError, TypeError, ValueError):
        raise LiveError(
            f"ManusGlove message: raw_nodes must be {NODE_COUNT} nodes with node_id from 0 to "
            f"{NODE_COUNT - 1} and pose.position with x, y, z"
        ) from None
    return frame_of_points(p_WK, _side_of(fields))


def frame_of_points(p_WK: np.ndarray, side: str, time: float | None = None) -> GloveFrame:
    """Returns the frame of keypoints p_WK (21, 3), m, in any W; the wrist's pose is derived from them.

    Raises:
        LiveError: a position is not finite or too far away, or wrist and knuckles span no plane.
    """
    p_VK = mirrored(p_WK) if side == "left" else p_WK
    # With NaN, the comparison is false.
    p_HK = to_wrist_frame(p_VK) if np.abs(p_WK).max() <= _MAX_DISTANCE_M else np.full((1,), np.nan)
    if not np.isfinite(p_HK).all():
        raise LiveError(
            f"hand: positions must be finite and within {_MAX_DISTANCE_M:g} m, and wrist and knuckles must "
            "span a plane"
        )
    R_WH, p_WH = wrist_pose(p_VK)
    quaternion = Rotation.from_matrix(R_WH).as_quat(scalar_first=True)
    return GloveFrame(side, time, p_HK, np.concatenate([quaternion, p_WH]))


def _parse_json(message: bytes) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no number")

    try:
        return json.loads(message.decode(), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise LiveError(f"glove message: not JSON: {error!s:.80}") from None


def _side_of(fields: dict[str, Any]) -> str:
    side = str(fields.get("side")).lower()
    if side not in SIDES:
        raise LiveError(f"glove message: side must be one of {', '.join(SIDES)}, not {side:.40}")
    return side


def _numbers(name: str, value: Any, shape: tuple[int, ...], largest: float = np.inf) -> np.ndarray:
    """Checks that a field holds finite numbers of `shape`, at most `largest`, and returns them."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.dtype.kind not in "fiu" or array.shape != shape:
        expected = f"numbers of shape {shape}" if shape else "a number"
        raise LiveError(f"glove message: {name} must be {expected}, not {value!r:.60}")
    if not (np.isfinite(array).all() and np.abs(array).max() <= largest):
        raise LiveError(f"glove message: {name} must be finite and at most {largest:g}, not {value!r:.60}")
    return array.astype(float)
