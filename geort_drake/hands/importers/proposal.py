"""A hand description for a model that nobody described, as far as it can be read off the model."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from geort_drake.hands.couplings import model_tree
from geort_drake.hands.description import (
    ActuationDescription,
    BasePoseDescription,
    CouplingDescription,
    FingerDescription,
    HandDescription,
)
from geort_drake.hands.importers.finger_names import (
    fingers_by_name,
    fingers_by_place,
    side_by_name,
    thumb_by_place,
)
from geort_drake.hands.importers.resting import free_posture, resting_contacts
from geort_drake.hands.importers.structure import Chain, HandStructure, read_structure
from geort_drake.hands.importers.tip_points import TipPoint, palm_points, tip_point
from geort_drake.hands.mjcf import remarks
from geort_drake.hands.model import HandModel
from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT

BASE = "hand_base"
# Frames of palms lie along them; fingers may be bent at rest. So a hand base this near to the axes of the
# palm's link is put there, and from the second angle on that is said.
_SNAP, _SAID = np.deg2rad(30.0), np.deg2rad(5.0)
_GRID = 7
_MANY = 8  # joints, each of which is not worth a sentence
# Fingers close to a side if their tips are there on average, by this part of how far they are to any side.
_CLOSING = 0.6
# A thumb is beside the fingers, not opposite to them, if it is by this part of how far it stands before them.
_BESIDE = 0.35
# On the shipped adapter a left hand is the mirror image of a right one when turned so, degrees.
_LEFT_MOUNT = (0.0, 0.0, 90.0)
# Gains for joints of a model without motors, those of the Allegro hand: N·m/rad, N·m·s/rad, N·m.
_GAINS = ActuationDescription(stiffness=1.0, damping=0.1, effort_limit=1.0)


@dataclass(frozen=True)
class Proposal:
    """A hand description, and what its reader should know of how it came about.

    Attributes:
        description: it names the model by its absolute path.
        notes: one sentence on each thing that was guessed or left out.
    """

    description: HandDescription
    notes: list[str]


@dataclass(frozen=True)
class _Finger:
    """A chain with its tip, and how it lies and closes in the root link R.

    `p_RF` are (N, 3) places of its tip at random postures, `p_stretched` is where it is farthest out, m.
    """

    chain: Chain
    tip: TipPoint
    p_stretched: np.ndarray
    p_RF: np.ndarray

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector along the stretched finger."""
        return _unit(self.p_stretched - self.chain.p_base)

    @property
    def reach(self) -> float:
        """Length of the stretched finger, m."""
        return float(np.linalg.norm(self.p_stretched - self.chain.p_base))

    @property
    def aside(self) -> np.ndarray:
        """(N, 3) how far the tip is to the side of the stretched finger, m."""
        v = self.p_RF - self.p_stretched
        return v - np.outer(v @ self.direction, self.direction)


def propose(model: Path, name: str | None = None, palm: str | None = None) -> Proposal:
    """Describes a model: fingers and their names, tips, side, hand base, joints that follow, gains.

    Args:
        model: URDF, SDF or MJCF file.
        name: of the hand; by default made from the file's.
        palm: link that carries the fingers; by default the one that most chains of joints leave.

    Raises:
        HandError: the model cannot be read, or is not one hand with 2 to 5 fingers of revolute joints.
        UnknownNameError: it has no such link.
    """
    structure = read_structure(model.resolve(), palm)
    notes: list[str] = []
    fingers = [_finger(structure, chain) for chain in structure.chains]
    names, X_RB, side = _arrange(structure, fingers, notes)
    guessed: dict[str, list[str]] = {}
    for finger, label in zip(fingers, names, strict=True):
        if not finger.tip.source.startswith("a sphere"):
            guessed.setdefault(finger.tip.source, []).append(f"{label} {1e3 * finger.tip.radius:.1f} mm")
    notes += [f"tips and their radii were taken from {what}: {', '.join(of)}" for what, of in guessed.items()]
    notes += _held_notes(structure.held)
    notes += remarks(model_tree(structure.path))
    palm_link = structure.palm[0]
    X_RP = structure.plant.EvalBodyPoseInWorld(structure.plant.CreateDefaultContext(), palm_link)
    X_PB = X_RP.inverse() @ X_RB
    rpy_deg = np.rad2deg(RollPitchYaw(X_PB.rotation()).vector())
    order = sorted(range(len(fingers)), key=lambda number: FINGER_NAMES.index(names[number]))
    frames = structure.plant.GetFrameIndices(structure.hand)
    taken = {structure.plant.get_frame(index).name() for index in frames}
    base = next(f"{BASE}{extra}" for extra in ("", *range(2, 100)) if f"{BASE}{extra}" not in taken)
    description = HandDescription(
        name=name or re.sub(r"\W+", "_", model.stem),
        model=str(model.resolve()),
        side=side,
        base_frame=base,
        base_pose=BasePoseDescription(palm_link.name(), _rounded(X_PB.translation()), _rounded(rpy_deg, 2)),
        fingers=[_describe(names[number], fingers[number]) for number in order],
        couplings=_couplings(structure),
        actuation=_actuation(structure, notes),
    )
    if side == "left":
        description.mount.rpy_deg = list(_LEFT_MOUNT)
    description.default_positions = _default_positions(structure)
    description.ignored_collisions = resting_contacts(HandModel(description))
    hand = HandModel(description)
    start = free_posture(hand)
    if start is None:
        notes.append("no posture without self-collision was found to start in")
    elif (start != hand.default_position).any():
        description.default_positions |= dict(zip(hand.joint_names, _rounded(start), strict=True))
    return Proposal(description, notes)


def _finger(structure: HandStructure, chain: Chain) -> _Finger:
    tip = tip_point(structure, chain)
    rng = np.random.default_rng(0)
    angles = structure.postures(chain, rng)
    p_RF = structure.tips(chain, tip.body, tip.point, angles)
    distance = np.linalg.norm(p_RF - chain.p_base, axis=1)
    best = angles[distance.argmax()]
    low, high = structure.limits(chain)
    # Stretched joint by joint from the best sample on, from the tip to the base.
    for joint in reversed(range(len(best))):
        trials = np.tile(best, (_GRID, 1))
        trials[:, joint] = np.linspace(low[joint], high[joint], _GRID)
        if low[joint] < 0 < high[joint]:
            trials[_GRID // 2, joint] = 0.0
        reached = np.linalg.norm(structure.tips(chain, tip.body, tip.point, trials) - chain.p_base, axis=1)
        # A joint that does not change the length, such as abduction, stays where the finger is straight.
        flat = np.ptp(reached) < 0.02 * reached.max()
        best[joint] = np.clip(0.0, low[joint], high[joint]) if flat else trials[reached.argmax(), joint]
    p_stretched = structure.tips(chain, tip.body, tip.point, best[None])[0]
    return _Finger(chain, tip, p_stretched, p_RF)


def _arrange(
    structure: HandStructure, fingers: list[_Finger], notes: list[str]
) -> tuple[list[str], RigidTransform, str]:
    """The fingers' names, the pose of the hand base in the root link, and the side."""
    p_base = np.array([finger.chain.p_base for finger in fingers])
    directions = np.array([finger.direction for finger in fingers])
    named = fingers_by_name([finger.chain.names for finger in fingers])
    if named is not None and "thumb" in named:
        thumb = named.index("thumb")
    else:
        thumb = thumb_by_place(p_base, directions, np.array([finger.reach for finger in fingers]))
        joints = ", ".join(fingers[thumb].chain.joints)
        notes.append(f"no name tells which finger is the thumb; taken is the one with the joints {joints}")
    others = [number for number in range(len(fingers)) if number != thumb]
    z = _unit(directions[others].mean(axis=0))
    aside = np.concatenate([fingers[number].aside for number in others])
    x = aside.mean(axis=0)
    if np.linalg.norm(x) < _CLOSING * np.linalg.norm(aside, axis=1).mean():
        x = p_base[thumb] - p_base[others].mean(axis=0)
        notes.append("the fingers bend to either side alike; the palm's side is taken to be the thumb's")
    x = _unit(x - (x @ z) * z)
    context = structure.plant.CreateDefaultContext()
    X_RP = structure.plant.EvalBodyPoseInWorld(context, structure.palm[0])
    R_RB = X_RP.rotation().matrix() @ _snapped(
        X_RP.rotation().matrix().T @ np.column_stack([x, np.cross(z, x), z]), notes
    )
    knuckles = p_base[others].mean(axis=0)
    thumb_place = 0.5 * (p_base[thumb] + fingers[thumb].p_RF.mean(axis=0)) - knuckles
    forwards, sideways, _ = thumb_place @ R_RB
    side = "right" if sideways > 0 else "left"
    bodies = structure.plant.GetBodyIndices(structure.hand)
    links = [structure.plant.get_body(index).name() for index in bodies]
    # Links of a whole robot are of both sides.
    told = (
        side_by_name([structure.path.stem])
        or side_by_name([structure.palm[0].name()])
        or side_by_name([structure.plant.GetModelInstanceName(structure.hand), *links])
    )
    if abs(sideways) < _BESIDE * abs(forwards):
        side = told or "right"
        notes.append(f"the thumb stands opposite to the fingers, not beside them; taken for a {side} hand")
    elif told is not None and told != side:
        notes.append(
            f"names speak of a {told} hand, but its thumb lies as on a {side} hand: one of them is wrong, or "
            "the joint limits let the fingers close backwards; look at base_pose and side"
        )
    towards_thumb = (p_base - knuckles) @ R_RB[:, 1] * (1 if side == "right" else -1)
    if named is None or "thumb" not in named:
        named = fingers_by_place(len(fingers), thumb, towards_thumb)
    rotation = RotationMatrix(R_RB)
    palm = palm_points(structure, RigidTransform(rotation, knuckles))
    # The wrist end of the palm, behind the middle of the knuckles.
    wrist = knuckles + min(float(palm[:, 2].min()), 0.0) * R_RB[:, 2]
    return named, RigidTransform(rotation, wrist), side


def _snapped(R: np.ndarray, notes: list[str]) -> np.ndarray:
    """The rotation to the nearest axes, where these are near."""
    nearest = np.zeros((3, 3))
    rows = np.abs(R).argmax(axis=0)
    nearest[rows, range(3)] = np.sign(R[rows, range(3)])
    if len(set(rows.tolist())) == 3 and np.linalg.det(nearest) > 0:
        angle = np.arccos(np.clip(0.5 * (np.trace(nearest.T @ R) - 1.0), -1.0, 1.0))
        if angle < _SNAP:
            if angle > _SAID:
                notes.append(
                    f"stretched fingers lean by {np.rad2deg(angle):.0f} degrees against the axes of the "
                    "palm's link, which the hand base was given"
                )
            return nearest
    notes.append("no axes of the palm's link lie along the fingers, so the hand base is turned as they are")
    return R


def _held_notes(held: dict[str, str]) -> list[str]:
    """A sentence on each joint that is held; on many with the same reason, as of a whole robot, one."""
    notes = []
    for reason in dict.fromkeys(held.values()):
        joints = [joint for joint, why in held.items() if why == reason]
        if len(joints) > _MANY:
            named = ", ".join(f"'{joint}'" for joint in joints[:3])
            notes.append(f"{len(joints)} joints are held, as each {reason}: {named}, ...")
        else:
            notes += [f"joint '{joint}' {reason}: it is held at its default position" for joint in joints]
    return notes


def _describe(name: str, finger: _Finger) -> FingerDescription:
    return FingerDescription(
        name=name,
        human_keypoint=TIP_KEYPOINT[name],
        joints=list(finger.chain.joints),
        tip_link=finger.tip.body.name(),
        tip_point=_rounded(finger.tip.point),
        tip_radius=round(finger.tip.radius, 5),
    )


def _couplings(structure: HandStructure) -> list[CouplingDescription]:
    return [
        CouplingDescription(c.joint, c.follows, round(c.ratio, 6), round(c.offset, 6))
        for c in structure.couplings
    ]


def _default_positions(structure: HandStructure) -> dict[str, float]:
    """Of joints that do not start within their limits: a tenth of the range from the nearer one."""
    positions = {}
    for chain in structure.chains:
        low, high = structure.limits(chain)
        for name, a, b in zip(chain.joints, low, high, strict=True):
            start = structure.plant.GetJointByName(name, structure.hand).get_default_angle()
            if not a <= start <= b:
                positions[name] = round(float(a + 0.1 * (b - a) if start < a else b - 0.1 * (b - a)), 4)
    return positions


def _actuation(structure: HandStructure, notes: list[str]) -> ActuationDescription:
    """Nothing where the model's motors have gains; else those of a hand of usual size."""
    plant = structure.plant
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(structure.hand)]
    ready = {actuator.joint().name() for actuator in actuators if actuator.has_controller()}
    joints = [joint for chain in structure.chains for joint in chain.joints]
    without = [f"'{joint}'" for joint in joints if joint not in ready]
    if not without:
        return ActuationDescription()
    some = f"{len(without)} of {len(joints)} joints, such as {without[0]}, have" if ready else "the model has"
    notes.append(
        f"{some} no position controllers; under actuation, put your hand's gains "
        f"for {_GAINS.stiffness:g} N·m/rad, {_GAINS.damping:g} N·m·s/rad and {_GAINS.effort_limit:g} N·m"
    )
    return _GAINS


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def _rounded(values: np.ndarray, digits: int = 5) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
