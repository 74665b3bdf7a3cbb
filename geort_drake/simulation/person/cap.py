"""Phases of a person who unscrews a cap with the robot's fingers."""

import numpy as np

from geort_drake.simulation.person import handling
from geort_drake.simulation.person.engine import Moment, Phase, rest

_VISIBLE_TURN = np.deg2rad(1.0)  # smallest turn of the cap that is seen as progress
_SLIP = 0.5  # the fingers have slipped if they have turned by this share of a stroke more than the cap
_ACROSS = np.array([0.0, 1.0, 1.0])  # the cap's axis is along x of B


def around(m: Moment) -> np.ndarray:
    """go around the cap"""
    return m.goal.p_BF_open


def close(m: Moment) -> np.ndarray:
    """slowly close; a finger that feels the cap stops"""
    target = m.goal.fingertips(0.0, m.config.overshoot)
    target[m.feels] = np.nan
    return target


def turn(m: Moment) -> np.ndarray:
    """turn the cap as far as the hand reaches"""
    if m.recall("grip") is None:
        m.note(grip=m.memory.reference)
    return m.goal.turned(m.recall("grip"), m.move(_stroke_time(m)) * m.goal.stroke)


def along_surface(m: Moment, error: np.ndarray) -> np.ndarray:
    """Ignores errors normal to the cap: its surface stops the squeezing fingertips."""
    normal = (m.percept.p_BF - m.goal.p_BC) * _ACROSS
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return error - np.sum(error * normal, axis=1, keepdims=True) * normal


def let_go(m: Moment) -> np.ndarray:
    """move off the cap"""
    return m.goal.fingertips(m.goal.stroke, -m.goal.gap)


def go_back(m: Moment) -> np.ndarray:
    """return to the beginning of the stroke"""
    return m.goal.fingertips((1 - m.move(_stroke_time(m))) * m.goal.stroke, -m.goal.gap)


def _stroke_time(m: Moment) -> float:
    """Duration of a stroke's minimum-jerk movement, s."""
    length = abs(m.goal.stroke) * np.linalg.norm((m.goal.p_BF_open - m.goal.p_BC)[m.goal.thumb])
    return max(m.config.min_movement_time, 1.875 * length / m.config.max_fingertip_speed)


def _time_to_see(m: Moment) -> float:
    """Time from the beginning of a stroke until its intended end is seen, s."""
    return _stroke_time(m) + m.config.visual_delay


def _turned(m: Moment) -> float:
    """Returns the seen turn of the cap, rad, positive where it unscrews, as strokes do; not mirrored."""
    return float(m.percept.values["positions"][0])


def has_settled(m: Moment) -> str | None:
    """the fingers have moved to where free play showed them around the cap"""
    return "close" if m.since > m.memory.settle_time else None


def all_feel(m: Moment) -> str | None:
    """all three feel the cap, or have closed for long"""
    if not m.feels[m.goal.touches].all() and m.since <= handling.closing_time(m.config, m.goal.gap):
        return None
    return handling.begin_squeeze(m)


def has_squeezed(m: Moment) -> str | None:
    """the grip is firm, or after 0.5 s"""
    if not handling.is_squeezed(m):
        return None
    m.note(grip=None, began=(_turned(m), m.percept.p_BF), farthest=-np.inf, progress_at=m.t)
    return "turn"


def is_turned(m: Moment) -> str | None:
    """the cap is seen to turn no further"""
    turned = _turned(m)
    if turned > m.recall("farthest") + _VISIBLE_TURN:
        m.note(farthest=turned, progress_at=m.t)
    # Fingers that press on the cap follow the own ones late.
    if min(m.since - _time_to_see(m), m.t - m.recall("progress_at")) <= m.config.patience:
        return None
    began, p_BF_began = m.recall("began")
    # Fingers that have not moved either do not slip, and move no better with a firmer grip.
    slip = m.goal.mean_turn(p_BF_began, m.percept.p_BF) - (turned - began)
    if slip > _SLIP * abs(m.goal.stroke):
        handling.grip_firmer(m)
    return "open"


def is_free(m: Moment) -> str | None:
    """no contact is felt, and the fingers are seen off the cap, or come no further; or after 2 s"""
    off = m.fingers_have_come(m.config.shape_tolerance)
    return "return" if (off and not m.feels.any()) or m.since > m.config.opening_time else None


def is_back(m: Moment) -> str | None:
    """the fingers are seen back, or come no nearer"""
    if m.since <= _time_to_see(m) or not m.fingers_have_come(m.config.shape_tolerance):
        return None
    m.memory.attempt += 1
    return "close"


CAP = (
    Phase("settle", around, has_settled, rest),
    Phase("close", close, all_feel, rest, speed="closing_speed", from_seen=True),
    Phase("squeeze", handling.press, has_squeezed, rest, press=handling.squeeze),
    Phase("turn", turn, is_turned, rest, error=along_surface, press=handling.regrip, from_seen=True),
    Phase(
        "open", let_go, is_free, rest, speed="opening_speed", error=handling.outwards, press=handling.relax
    ),
    Phase("return", go_back, is_back, rest),
)
