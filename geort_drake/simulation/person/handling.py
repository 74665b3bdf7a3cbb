"""Phases of a person who grasps an object, and who brings it to a place."""

import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.simulation.person.config import OperatorConfig
from geort_drake.simulation.person.engine import Moment, Phase, opposition, rest
from geort_drake.simulation.person.finger_motion import limited
from geort_drake.simulation.person.goal import yaw_of
from geort_drake.simulation.person.perception import average
from geort_drake.systems.port_values import rotation_of_vector

# Unit forces of thumb and fingers whose sum is larger need the palm: half a unit is within friction.
_UNBALANCED = 0.5
# Distance ahead of a fingertip that leaves a surface, m.
_LEAVING_DISTANCE = 0.02
# A task that is done is over this long after the object is let go, s.
_TIME_TO_END = 1.0


# -- where the fingertips go


def shape(m: Moment) -> np.ndarray:
    """open around the object"""
    return m.goal.p_BF_open


def let_go(m: Moment) -> np.ndarray:
    """straight off the object, then open around it"""
    target, feels = m.goal.p_BF_open.copy(), m.goal.touches & m.feels
    # A finger that moved along the surface would turn the object over.
    target[feels] = (m.percept.p_BF - _LEAVING_DISTANCE * _directions_inwards(m))[feels]
    return target


def letting_go_speed(m: Moment) -> np.ndarray:
    """Returns limits (F,), m/s: fingers leave the object as fast as they squeezed it, and then open."""
    return np.where(m.goal.touches & m.feels, m.config.squeeze_speed, m.config.opening_speed)


def _around(m: Moment, depth: float) -> np.ndarray:
    """Returns fingertips `depth` (m) below the seen surface, (F, 3) in B; NaN for fingers that feel it."""
    X_BO = m.percept.X_BW @ m.goal.object_frame(m.percept.X_WO)
    target, touches = m.goal.p_BF_open.copy(), m.goal.touches
    target[touches] = X_BO.multiply((m.goal.p_OF_touch + depth * m.goal.n_OF)[touches].T).T
    target[touches & m.feels] = np.nan
    return target


def gather(m: Moment) -> np.ndarray:
    """gather just off the surface"""
    return _around(m, -_aperture(m))


def _aperture(m: Moment) -> float:
    """Returns the intended distance of the fingertips from the surface before they close, m."""
    return max(m.config.aperture, 2 * m.config.visual_error)


def close(m: Moment) -> np.ndarray:
    """slowly close; a finger that feels the object stops"""
    return _around(m, m.config.overshoot)


def closing_speed(m: Moment) -> np.ndarray:
    """Returns limits (F,), m/s: leading fingers wait for the slowest, as long as it comes nearer."""
    config, error = m.config, m.memory.error
    assert error is not None  # set at the start of every decision
    distance = np.nan_to_num(np.linalg.norm(error - m.expected, axis=1))
    pending = m.goal.touches & ~m.feels
    slowest = distance[pending].max() if pending.any() else 0.0
    share = np.clip(1 - (slowest - distance - config.closing_lead) / config.closing_lead, 0, 1)
    return config.closing_speed * (1.0 if m.fingers_at_limit else share) * np.ones_like(distance)


def press(m: Moment) -> None:
    """press towards each other"""


def hold(m: Moment) -> None:
    """hold; press more if the grip weakens"""


# -- how the own hand presses


def _felt(m: Moment) -> np.ndarray:
    """Returns the felt forces (F,), N, averaged since the squeeze began."""
    force = m.recall("contact")
    return m.percept.contact if force is None else force


def _grip(m: Moment) -> float:
    """Returns the felt force of the grip, N: that of the thumb, or of all others if it is less."""
    force = _felt(m)
    thumb = force[m.thumb]
    return min(thumb, force[m.goal.touches].sum() - thumb)


def _wanted_grip(m: Moment) -> float:
    """Returns the wanted force of the grip, N."""
    minimum = max(m.config.grip_force, m.config.grip_per_weight * m.goal.weight)
    return m.recall("grip_force", minimum)


def _is_firm(m: Moment, share: float = 1.0) -> bool:
    """Whether the grip is felt to have a share of the wanted force."""
    return _grip(m) >= share * _wanted_grip(m)


def grip_firmer(m: Moment) -> None:
    """Lets the person grip with more force after a slip."""
    m.note(grip_force=m.config.firmer * _wanted_grip(m))


def _inwards(m: Moment, touches: np.ndarray) -> np.ndarray:
    """Returns motions (F, 3) in B with which the fingers of `touches` (F,) and the thumb press.

    Where the intended normals of thumb and fingers do not balance, the palm bears the rest: they press along
    the normals, into the palm. Otherwise they press towards each other, see `opposition`.
    """
    n_OF = getattr(m.goal, "n_OF", None)
    others = m.goal.touches & (np.arange(len(touches)) != m.thumb)
    if n_OF is None or np.linalg.norm(n_OF[m.thumb] + n_OF[others].mean(axis=0)) < _UNBALANCED:
        return opposition(m.percept.p_BF, touches, m.thumb)
    pressing = touches | (np.arange(len(touches)) == m.thumb)
    R_BO = (m.percept.X_BW @ m.goal.object_frame(m.percept.X_WO)).rotation().matrix()
    way = np.where(pressing[:, None], n_OF @ R_BO.T, 0.0)
    way[others] /= np.count_nonzero(others)
    return way


def _directions_inwards(m: Moment) -> np.ndarray:
    """Returns unit vectors (F, 3) in B along which the grasping fingers press; zero for other fingers."""
    inwards = _inwards(m, m.goal.touches)
    return inwards / np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)


def _pressing(m: Moment, share: float) -> np.ndarray:
    """Returns velocities (F, 3), m/s, with which fingertips close further, and press where the grip is weak.

    Those that feel the object press against each other, each until it has its part of the grip: the thumb
    bears all of it, and the fingers share it. One that pressed harder than the others would push the object
    out between them, or turn it. A side that feels it alone rests, because pressing would push the object.

    Args:
        share: share of the wanted force below which a finger presses.
    """
    touches, config, pressed = m.goal.touches, m.config, m.recall("pressed")
    # A person without touch takes all to be touching.
    feels = touches & m.feels if config.touch else touches
    velocity = config.closing_speed * _inwards(m, touches)
    velocity[feels] = 0.0
    if feels[m.thumb] and np.count_nonzero(feels) > 1 and not _is_firm(m, share):
        others = touches & (np.arange(len(touches)) != m.thumb)
        part = np.full(len(touches), share * _wanted_grip(m))
        part[others] /= np.count_nonzero(others)
        weak = feels & (_felt(m) < part)
        pressing = weak if weak.any() else feels
        way = _inwards(m, pressing if (pressing & others).any() else feels)
        velocity[pressing] = config.squeeze_speed * way[pressing]
    velocity *= np.linalg.norm(pressed, axis=1).max() < config.squeeze
    m.note(
        pressed=pressed + config.period * velocity,
        contact=average(m.recall("contact"), m.percept.contact, config),
    )
    return velocity


def squeeze(m: Moment) -> np.ndarray:
    """Returns velocities (F, 3), m/s, of digits that press towards each other until the grip is firm."""
    return _pressing(m, 1.0)


def regrip(m: Moment) -> np.ndarray:
    """Returns velocities (F, 3), m/s, of digits that press more where the grip weakens to half or less."""
    return _pressing(m, 0.5)


def relax(m: Moment) -> np.ndarray:
    """Returns velocities (F, 3), m/s, that undo the squeeze as fast as it was made.

    A finger that let go much before the others would leave the object to be pushed by them.
    """
    pressed = m.recall("pressed")
    velocity = -limited(pressed / m.config.period, m.config.squeeze_speed)
    m.note(pressed=pressed + m.config.period * velocity)
    return velocity


def outwards(m: Moment, error: np.ndarray) -> np.ndarray:
    """Ignores errors inwards while the squeeze is undone: the fingertips hardly move then."""
    if m.since > m.config.squeeze / m.config.squeeze_speed + m.config.visual_delay:
        return error
    inwards = _directions_inwards(m)
    return error - np.maximum(np.sum(error * inwards, axis=1, keepdims=True), 0.0) * inwards


# -- where the wrist goes


def _go(m: Moment, X_WB: RigidTransform, tolerance: float) -> RigidTransform | None:
    return None if m.is_at(X_WB, tolerance) else X_WB


def _before(m: Moment) -> RigidTransform:
    return m.goal.object_frame(m.percept.X_WO) @ m.goal.X_OB_before


def _at_object(m: Moment) -> RigidTransform:
    return m.goal.object_frame(m.percept.X_WO) @ m.goal.X_OB


def go_before(m: Moment) -> RigidTransform | None:
    """goes to 80 to 170 mm before the grasp"""
    return _go(m, _before(m), m.tolerance(m.config.reach_tolerance))


def leave(m: Moment) -> RigidTransform | None:
    """rests while fingers feel the object, up to 2 s, and goes to 80 to 170 mm before the grasp"""
    return None if m.feels.any() and m.since < m.config.opening_time else go_before(m)


def go_around(m: Moment) -> RigidTransform | None:
    """goes around the object"""
    return _go(m, _at_object(m), m.tolerance(m.config.reach_tolerance))


def _shift(m: Moment) -> np.ndarray | None:
    """Returns a shift of the hand, (3,) m in W, for errors out of the fingers' reach; None if small.

    It is the midrange of the fingertips' errors to the surface, which minimises the largest error.
    """
    error, config = m.memory.error, m.config
    assert error is not None  # set at the start of every decision
    touches = m.goal.touches
    if m.memory.movements >= config.max_corrections:
        return None
    X_BO = m.percept.X_BW @ m.goal.object_frame(m.percept.X_WO)
    depth = config.overshoot if m.recall("closing") else 0.0
    error = np.nan_to_num(error - depth * (m.goal.n_OF @ X_BO.rotation().matrix().T))
    error[m.feels] = 0.0
    middle = 0.5 * (error[touches].min(axis=0) + error[touches].max(axis=0))
    if np.linalg.norm(middle) < config.shift_tolerance:
        return None
    return m.percept.X_WB.rotation().matrix() @ middle


def shift(m: Moment) -> RigidTransform | None:
    """shifts if fingers are at their limit"""
    shift = _shift(m) if m.fingers_at_limit else None
    if shift is None:
        return None
    m.memory.best_error, m.memory.best_time = np.inf, m.t
    return RigidTransform(m.percept.X_WB.rotation(), m.percept.X_WB.translation() + shift)


def rise(m: Moment) -> RigidTransform | None:
    """rises, and again if it is seen too low"""
    if m.memory.movement is None:
        m.note(X_WB_lifted=RigidTransform([0, 0, m.config.lift_height]) @ m.percept.X_WB)
    elif not _is_too_low(m):
        return None
    return m.recall("X_WB_lifted")


def _is_too_low(m: Moment) -> bool:
    """Whether the hand is seen lower than it was to rise, and may rise once more."""
    short = (m.recall("X_WB_lifted").translation() - m.percept.X_WB.translation())[2]
    may_rise = m.memory.movements < m.config.max_corrections
    return may_rise and bool(short > m.tolerance(m.config.lift_tolerance))


def _to_place(m: Moment) -> RigidTransform:
    """Returns the seen motion from object to place: rotation and translation of the origin in W."""
    X_WO, X_WP = m.percept.X_WO, m.percept.X_WP
    assert X_WP is not None  # tasks with a place show it
    upright = m.settings.upright
    R = _tilt_to(X_WO.rotation().col(2), X_WP.rotation().col(2)) if upright else RotationMatrix()
    yaw, symmetry = yaw_of(X_WP.rotation()) - yaw_of(R @ X_WO.rotation()), m.goal.yaw_symmetry
    yaw = math.remainder(yaw, symmetry) if symmetry else 0.0
    return RigidTransform(RotationMatrix.MakeZRotation(yaw) @ R, X_WP.translation() - X_WO.translation())


def _above_place(m: Moment) -> RigidTransform:
    motion, p_WO = _to_place(m), m.percept.X_WO.translation()
    p_OB_W = m.percept.X_WB.translation() - p_WO
    p_WO_above = p_WO + motion.translation() + [0, 0, m.settings.hover]
    return RigidTransform(
        motion.rotation() @ m.percept.X_WB.rotation(), p_WO_above + motion.rotation() @ p_OB_W
    )


def carry(m: Moment) -> RigidTransform | None:
    """brings the object above its place, as if their own hand held it"""
    return _go(m, _above_place(m), m.tolerance(m.config.place_tolerance))


def lower(m: Moment) -> RigidTransform | None:
    """slowly lowers the object onto its place, until it stays behind the hand"""
    if m.memory.movement is not None:
        return None
    m.note(p_BO_carried=m.memory.p_BO)
    down = min(_to_place(m).translation()[2], 0.0) - m.config.place_overshoot
    return RigidTransform([0, 0, down]) @ m.percept.X_WB


# -- when a phase ends


def _is_shaped(m: Moment, tolerance: float) -> bool:
    """Whether the fingertips are at their targets, or as near as fingers and hand can bring them."""
    return m.worst_error < m.tolerance(tolerance) or _at_limit(m)


def _at_limit(m: Moment) -> bool:
    """Whether neither fingers nor hand can bring the fingertips nearer to their targets."""
    return m.fingers_at_limit and _shift(m) is None


def _has_slipped(m: Moment) -> bool:
    """Whether the object is seen to have moved in the hand, or no finger feels it."""
    contact = m.recall("contact")
    if m.config.touch and contact is not None and contact.max() < m.config.touch_force:
        return True
    # Two views differ by 1.4 times the error of one; about three times this is rare.
    least = max(m.config.lost_distance, 4 * m.config.visual_error)
    return bool(np.linalg.norm(m.memory.p_BO - m.recall("p_BO")) > least)


def _lost(m: Moment) -> str | None:
    """Returns the phase after the object has slipped, if it has; the next grip is firmer."""
    if not _has_slipped(m):
        return None
    grip_firmer(m)
    return _try_again(m, "release")


def _try_again(m: Moment, phase: str) -> str:
    """Returns the phase with which a new attempt begins."""
    m.memory.attempt += 1
    return phase


def is_before(m: Moment) -> str | None:
    """hand in place; fingers shaped, or at their limit after 4 s"""
    # Fingers at their limit may miss by up to the clearance.
    clearance = m.goal.clearance if m.fingers_at_limit else 0.0
    shaped = m.worst_error < m.tolerance(max(m.config.shape_tolerance, clearance))
    gives_up = m.fingers_at_limit and m.since > m.config.shaping_time
    if not ((shaped or gives_up) and m.has_arrived(_before(m), m.tolerance(m.config.reach_tolerance))):
        return None
    m.note(p_WO=m.percept.X_WO.translation())
    return "approach"


def _is_pushed(m: Moment) -> bool:
    """Whether the object is seen to have moved since the approach: one that rolls is caught at once."""
    return bool(np.linalg.norm(m.percept.X_WO.translation() - m.recall("p_WO")) > m.config.visual_error)


def is_around(m: Moment) -> str | None:
    """hand in place, or the object moves"""
    arrived = m.has_arrived(_at_object(m), m.tolerance(m.config.reach_tolerance))
    return "surround" if arrived or _is_pushed(m) else None


def is_gathered(m: Moment) -> str | None:
    """fingers shaped, or the object moves"""
    m.note(closing=False)
    shaped = m.wrist_rests and _is_shaped(m, m.config.aperture_tolerance)
    if not (shaped or _is_pushed(m)):
        return None
    m.note(closing=True, pressed=np.zeros_like(m.percept.p_BF))
    return "close"


def has_closed(m: Moment) -> str | None:
    """all grasping fingers feel the object, or both sides do and others come no nearer; else a new attempt"""
    feels, config = m.goal.touches & m.feels, m.config
    if feels[m.goal.touches].all():
        return begin_squeeze(m)
    if feels[m.thumb] and np.count_nonzero(feels) > 1:
        m.note(held_at=m.t)
    movement = m.memory.movement
    since = max(m.memory.best_time, m.memory.phase_start if movement is None else movement.t_end)
    if not _at_limit(m) or m.t - since < closing_time(config, _aperture(m)):
        return None
    # A contact that is not felt for a moment may come back. A person without touch takes fingers that have
    # stopped to be touching.
    holds = m.t - m.recall("held_at", -np.inf) < config.judging_time or not config.touch
    return begin_squeeze(m) if holds else _try_again(m, "release")


def closing_time(config: OperatorConfig, gap: float) -> float:
    """Returns the time, s, in which fingers cross a gap, m, come as deep as intended, and are seen there."""
    return (gap + config.overshoot) / config.closing_speed + config.visual_delay


def begin_squeeze(m: Moment) -> str:
    """Returns the phase that squeezes, and forgets what was pressed and felt before."""
    m.note(pressed=np.zeros_like(m.percept.p_BF), contact=None)
    return "squeeze"


def is_squeezed(m: Moment) -> bool:
    """Whether the person takes the grip to be firm; a weak one is mended on the way."""
    return m.since > m.config.settle_time if _is_firm(m) else m.since > m.config.squeeze_time


def has_squeezed(m: Moment) -> str | None:
    """the grip is firm, or after 0.5 s"""
    if not is_squeezed(m):
        return None
    m.note(p_BO=m.memory.p_BO, lowered=0)
    return "lift"


def is_lifted(m: Moment) -> str | None:
    """hand at rest, and high enough or after four movements; or object lost"""
    lifted = m.wrist_rests and m.memory.movement is not None and not _is_too_low(m)
    return _lost(m) or ("hold" if lifted else None)


def is_lost(m: Moment) -> str | None:
    """the trial ends, or object lost"""
    return _lost(m)


def is_carried(m: Moment) -> str | None:
    """hand in place, or object lost"""
    return _lost(m) or (
        "lower" if m.has_arrived(_above_place(m), m.tolerance(m.config.place_tolerance)) else None
    )


def is_down(m: Moment) -> str | None:
    """object on its place, or on something else, or lost"""
    if lost := _lost(m):
        return lost
    if m.memory.movement is None:
        return None
    rise = m.percept.X_WB.rotation().matrix()[2] @ (m.memory.p_BO - m.recall("p_BO_carried"))
    if not (m.wrist_rests or rise > 3 * m.config.visual_error):
        return None
    # An object that is still above its place stands on something else, and is held where it has slid to.
    lowered = m.recall("lowered") + 1
    m.note(p_BO=m.memory.p_BO, lowered=lowered)
    stands_above = _to_place(m).translation()[2] < -m.config.reach_tolerance
    return "carry" if stands_above and lowered <= m.config.max_corrections else "open"


def is_open(m: Moment) -> str | None:
    """fingers shaped or at their limit, and no contact is felt or 2 s have passed"""
    shaped = m.fingers_have_come(m.config.shape_tolerance)
    freed = not m.feels.any() or m.since > m.config.opening_time
    return "retreat" if shaped and freed else None


def has_retreated(m: Moment) -> str | None:
    """hand in place, and the task is not over"""
    arrived = m.has_arrived(_before(m), m.tolerance(m.config.reach_tolerance))
    return _try_again(m, "reach") if arrived and m.since > _TIME_TO_END else None


_GRASP = (
    Phase("reach", shape, is_before, go_before),
    Phase("approach", shape, is_around, go_around),
    Phase("surround", gather, is_gathered, shift, from_seen=True),
    Phase("close", close, has_closed, shift, speed=closing_speed, from_seen=True),
    Phase("squeeze", press, has_squeezed, rest, press=squeeze),
    Phase("lift", hold, is_lifted, rise, press=regrip),
)
_RELEASE = Phase("release", let_go, is_before, leave, speed=letting_go_speed, error=outwards, press=relax)
GRASP = (*_GRASP, Phase("hold", hold, is_lost, rest, press=regrip), _RELEASE)
PLACE = (
    *_GRASP[:-1],
    Phase("lift", hold, lambda m: "carry" if (end := is_lifted(m)) == "hold" else end, rise, press=regrip),
    Phase("carry", hold, is_carried, carry, press=regrip),
    Phase("lower", hold, is_down, lower, press=regrip, wrist_speed="lowering_speed"),
    Phase("open", let_go, is_open, rest, speed=letting_go_speed, error=outwards, press=relax, from_seen=True),
    Phase("retreat", shape, has_retreated, go_before),
    _RELEASE,
)


def _tilt_to(v: np.ndarray, u: np.ndarray) -> RotationMatrix:
    """Returns the smallest rotation that turns the unit vector v to u."""
    normal = np.cross(v, u)
    sine = np.linalg.norm(normal)
    return rotation_of_vector(normal / max(sine, 1e-12) * math.atan2(sine, v @ u))
