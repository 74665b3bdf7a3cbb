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
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.transports import decode_json
from geort_drake.people.checks import NORM_TOLERANCE
from geort_drake.people.formats import NODE_COUNT, keypoints_of_nodes
from geort_drake.people.keypoints import KEYPOINT_COUNT, mirrored, to_wrist_frame, wrist_pose

_VERSION, _UNIT = 1, "m"
# Largest accepted coordinate, m.
_MAX_DISTANCE_M = 100.0
_NORM_REPAIRABLE = 0.2  # largest deviation of a quaternion's norm from 1 that is normalised
_TEXT_VALUES = 1 + 7 * NODE_COUNT  # number of values of one glove in the text form
_ERGONOMICS_VALUES = (20, 40)  # number of joint angles of one or two hands, which bridges can send instead

Coordinate = Annotated[float, Meta(ge=-_MAX_DISTANCE_M, le=_MAX_DISTANCE_M)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Keypoints = Annotated[list[Point], Meta(min_length=KEYPOINT_COUNT, max_length=KEYPOINT_COUNT)]
Side = Literal["left", "right"]


@dc.dataclass(frozen=True, eq=False)
class GloveFrame:
    """A hand at one moment.

    Attributes:
        side: "right" or "left"; a left hand is given as its mirror image, as in `Recording`.
        time: time of measurement, s, on the sender's clock; None if the message has none.
        p_HK: (21, 3) keypoints in the wrist frame H, m; None while the glove has lost the hand.
        X_WH: (7,) wrist pose, qw qx qy qz x y z, m; None without a tracker.
    """

    side: str
    time: float | None = None
    p_HK: np.ndarray | None = None
    X_WH: np.ndarray | None = None


class _Own(msgspec.Struct, forbid_unknown_fields=True):
    """A message in the package's own format."""

    format: Literal["geort_drake.glove"]
    version: int
    unit: str
    side: Side
    time: float
    p_HK: Keypoints | None
    X_WH: Annotated[list[Coordinate], Meta(min_length=7, max_length=7)] | None


class _Position(msgspec.Struct):
    x: float
    y: float
    z: float


class _Pose(msgspec.Struct):
    position: _Position


class _Node(msgspec.Struct):
    node_id: int
    pose: _Pose


class _ManusGlove(msgspec.Struct):
    """A ManusGlove message; its other fields are ignored."""

    side: Literal["left", "right", "Left", "Right", "LEFT", "RIGHT"]
    raw_nodes: Annotated[list[_Node], Meta(min_length=NODE_COUNT, max_length=NODE_COUNT)]
    glove_id: int | str | None = None


_OWN, _MANUS_GLOVE = msgspec.json.Decoder(_Own), msgspec.json.Decoder(_ManusGlove)


def encode_frame(frame: GloveFrame) -> bytes:
    """Encodes a frame with a time as a message in the package's own format."""
    fields = {
        "format": "geort_drake.glove",
        "version": _VERSION,
        "unit": _UNIT,
        "side": frame.side,
        "time": None if frame.time is None else float(frame.time),
        "p_HK": None if frame.p_HK is None else frame.p_HK.tolist(),
        "X_WH": None if frame.X_WH is None else frame.X_WH.tolist(),
    }
    return msgspec.json.encode(fields)


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
    if not message.lstrip().startswith(b"{"):
        return _decode_manus_text(message, side, glove_id)
    if b'"raw_nodes"' in message:
        glove = decode_json(_MANUS_GLOVE, message, "ManusGlove message")
        if glove_id is not None and str(glove.glove_id).lower() != glove_id.lower():
            return None
        frame = _frame_of_nodes(glove)
    else:
        frame = _frame_of_own(decode_json(_OWN, message, "glove message"))
    if frame.side != side:
        raise MismatchError(f"glove message: a {frame.side} hand is sent, but the robot's is a {side} one")
    return frame


def _frame_of_own(own: _Own) -> GloveFrame:
    for name, value, expected in (("version", own.version, _VERSION), ("unit", own.unit, _UNIT)):
        if value != expected:
            raise MismatchError(f"glove message: {name} must be {expected!r}, not {value!r:.40}")
    p_HK = None if own.p_HK is None else np.array(own.p_HK)
    if own.X_WH is None:
        return GloveFrame(own.side, own.time, p_HK)
    X_WH = np.array(own.X_WH)
    norm = float(np.linalg.norm(X_WH[:4]))
    if abs(norm - 1.0) > _NORM_REPAIRABLE:
        raise LiveError(
            f"glove message: X_WH must begin with a unit quaternion, not {own.X_WH[:4]}, whose norm is "
            f"{norm:.3g}"
        )
    if abs(norm - 1.0) > NORM_TOLERANCE:
        X_WH[:4] /= norm
    return GloveFrame(own.side, own.time, p_HK, X_WH)


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


def _frame_of_nodes(glove: _ManusGlove) -> GloveFrame:
    positions = [node.pose.position for node in glove.raw_nodes]
    p_WN = np.array([[p.x, p.y, p.z] for p in positions])
    try:
        p_WK = keypoints_of_nodes(p_WN, [node.node_id for node in glove.raw_nodes])
    except ValueError as error:
        raise LiveError(f"ManusGlove message: raw_nodes: {error}") from None
    return frame_of_points(p_WK, glove.side.lower())


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
