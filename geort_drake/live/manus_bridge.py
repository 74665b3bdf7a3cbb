"""MANUS skeletons as ZeroMQ bridges send them.

Two forms are common. Neither says when the hand was like this.
    text        "ID,x,y,z,qx,qy,qz,qw,x,y,z,…": a glove's serial number and 25 poses, m; or two gloves one
                after the other. Pushed by the client that BiDex published
                (https://github.com/leap-hand/Bidex_Manus_Teleop) and those made from it.
    ManusGlove  the message of MANUS' ROS 2 package as JSON: side, and `raw_nodes` with `node_id` and `pose`.
                Published, for example, by manus_ros2_transporter.
Nodes are numbered 0 wrist; 1–4 thumb (CMC, MCP, IP, tip); then five each of index, middle, ring and little
finger: metacarpal base, MCP, PIP, DIP, tip.
"""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geort_drake.errors import LiveError, MismatchError
from geort_drake.live.glove_frame import FARTHEST_M, GloveFrame, side_of
from geort_drake.people.formats.source import KEYPOINTS_OF_25
from geort_drake.people.keypoints import mirrored, to_wrist_frame, wrist_pose

_NODES = 25
_GLOVE = 1 + 7 * _NODES  # words of one glove in the text form
_ERGONOMICS = (20, 40)  # words of the text form's other messages, joint angles


def decode_text(message: bytes, side: str, glove_id: str | None) -> GloveFrame | None:
    """The frame of one glove in the text form, or None where the message is about others.

    Args:
        side: of the wanted glove, which the message does not say.
        glove_id: its serial number; None where there is but one glove.

    Raises:
        MismatchError: joint angles are sent, or two gloves and no serial number was given.
        LiveError: the message is malformed.
    """
    words = message.decode("ascii", errors="replace").strip().split(",")
    if len(words) in _ERGONOMICS:
        raise MismatchError(
            f"MANUS message: {len(words)} values are joint angles (ergonomics); raw skeletons are wanted"
        )
    if len(words) not in (_GLOVE, 2 * _GLOVE):
        raise LiveError(
            f"MANUS message: {_GLOVE} values are wanted, or twice that for two gloves; not {len(words)}"
        )
    gloves = [words[start : start + _GLOVE] for start in range(0, len(words), _GLOVE)]
    if glove_id is None and len(gloves) > 1:
        ids = ", ".join(glove[0][:20] for glove in gloves)
        raise MismatchError(f"MANUS message: there are two gloves; choose one with --glove-id: {ids}")
    for glove in gloves:
        if glove_id is None or glove[0].strip().lower() == glove_id.lower():
            try:
                values = np.array([float(word) for word in glove[1:]])
            except ValueError as error:
                raise LiveError(f"MANUS message: {error!s:.80}") from None
            return _frame(values.reshape(_NODES, 7)[:, :3], side)
    return None


def decode_manus_glove(fields: dict[str, Any], glove_id: str | None) -> GloveFrame | None:
    """The frame in the fields of a ManusGlove, or None where it is another glove's.

    Raises:
        LiveError: the message is malformed.
    """
    if glove_id is not None and str(fields.get("glove_id")).lower() != glove_id.lower():
        return None
    nodes = fields["raw_nodes"]
    p_WN = np.full((_NODES, 3), math.nan)
    if not isinstance(nodes, list) or len(nodes) != _NODES:
        raise LiveError(f"ManusGlove message: raw_nodes must be {_NODES} nodes")
    for node in nodes:
        try:
            number, position = node["node_id"], node["pose"]["position"]
            p_WN[range(_NODES).index(number)] = [float(position[axis]) for axis in "xyz"]
        except (KeyError, TypeError, ValueError, OverflowError):
            raise LiveError(
                f"ManusGlove message: a node must have node_id from 0 to {_NODES - 1} and pose.position with "
                f"x, y, z, not {node!r:.80}"
            ) from None
    return _frame(p_WN, side_of(fields))


def _frame(p_WN: np.ndarray, side: str) -> GloveFrame:
    """The frame of nodes p_WN (25, 3) in any frame W, m, where W's place does not matter."""
    p_WK = p_WN[list(KEYPOINTS_OF_25)]
    p_VK = mirrored(p_WK) if side == "left" else p_WK
    # NaN is not within either.
    p_HK = to_wrist_frame(p_VK) if np.abs(p_WK).max() <= FARTHEST_M else np.full((1,), math.nan)
    if not np.isfinite(p_HK).all():
        raise LiveError(
            f"MANUS message: positions must be finite, within {FARTHEST_M:g} m, and wrist and knuckles must "
            "span a plane"
        )
    R_WH, p_WH = wrist_pose(p_VK)
    return GloveFrame(
        side, None, p_HK, np.concatenate([Rotation.from_matrix(R_WH).as_quat(scalar_first=True), p_WH])
    )
