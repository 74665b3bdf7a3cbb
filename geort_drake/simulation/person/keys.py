"""Phases of a person who presses keys with the robot's fingers."""

import numpy as np

from geort_drake.simulation.person.engine import Moment, Phase, rest

_PRESS = np.array([1.0, 0.0, 0.0])  # direction of a press in B


def _cue(m: Moment) -> int:
    return round(m.percept.values["phase"][0])


def _travel(m: Moment, finger: int) -> float:
    return float(m.percept.values["positions"][m.goal.key_of[finger]])


def above(m: Moment) -> np.ndarray:
    """go above the keys; a finger is raised if it feels its key, or if the key goes down without a cue"""
    config, goal, raised = m.config, m.goal, m.recall("raised", np.zeros(len(m.goal.touches))).copy()
    for finger in np.flatnonzero(goal.touches).tolist():
        idle = finger not in m.recall("acting", ())
        if idle and (m.feels[finger] or _travel(m, finger) > m.settings.still):
            step = config.lift * config.period / config.attention_time
            raised[finger] = min(raised[finger] + step, 3 * config.lift)
    m.note(raised=raised)
    return goal.p_BF_open - np.outer(raised, _PRESS)


def idle_as_seen(m: Moment, error: np.ndarray) -> np.ndarray:
    """Ignores what twice the error of vision may explain of the errors of fingers without a cue.

    They would drift into their keys, because they hover nearer to these than a person sees.
    """
    size = np.linalg.norm(error, axis=1, keepdims=True)
    beyond = error * np.maximum(1 - 2 * m.config.visual_error / np.maximum(size, 1e-9), 0.0)
    acting = np.isin(np.arange(len(error)), m.recall("acting", ()))
    return np.where(acting[:, None], error, beyond)


def _pressed(m: Moment, share: float, further: float) -> np.ndarray:
    target, (finger,) = above(m), m.recall("acting")
    target[finger] += share * (m.goal.p_BF_pressed - target)[finger] + further * _PRESS
    return target


def press(m: Moment) -> np.ndarray:
    """press the cued key, and push further while it is not seen to go down"""
    overdue = max(m.since - m.config.press_time - m.config.visual_delay, 0.0)
    return _pressed(m, m.move(m.config.press_time), min(m.config.push_speed * overdue, m.config.most_push))


def release(m: Moment) -> np.ndarray:
    """go back above the keys"""
    return _pressed(m, 1 - m.move(m.config.press_time), 0.0)


def has_settled(m: Moment) -> str | None:
    """the fingers have moved to where free play showed them above the keys"""
    return "wait" if m.since > m.memory.settle_time else None


def is_cued(m: Moment) -> str | None:
    """a cue is seen"""
    cue = _cue(m)
    if cue == 0:
        m.note(cue=0)
    elif cue != m.recall("cue", 0):
        m.note(cue=cue, acting=np.flatnonzero(m.goal.key_of == cue - 1))
        return "choose"
    return None


def has_chosen(m: Moment) -> str | None:
    """the finger is chosen"""
    return "press" if m.since > m.config.choice_time else None


def is_down(m: Moment) -> str | None:
    """the key is seen to be down, or the cue is over"""
    margin = m.settings.depth + m.settings.still
    return "release" if _travel(m, m.recall("acting")[0]) > margin or not _cue(m) else None


def is_back(m: Moment) -> str | None:
    """the finger is back"""
    if m.since <= m.config.press_time:
        return None
    m.memory.notes = {name: note for name, note in m.memory.notes.items() if name != "acting"}
    return "wait"


KEYS = (
    Phase("settle", above, has_settled, rest, error=idle_as_seen),
    Phase("wait", above, is_cued, rest, error=idle_as_seen),
    Phase("choose", above, has_chosen, rest, error=idle_as_seen),
    Phase("press", press, is_down, rest, error=idle_as_seen),
    Phase("release", release, is_back, rest, error=idle_as_seen),
)
