"""Proposes a hand description for a model: fingers, fingertips, hand base, side, couplings and gains."""

import dataclasses as dc
import re
from pathlib import Path

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from geort_drake.hands.assembly import position_limits
from geort_drake.hands.description import (
    ActuationDescription,
    BasePoseDescription,
    CouplingDescription,
    FingerDescription,
    HandDescription,
)
from geort_drake.hands.importers.checks import contact_fractions
from geort_drake.hands.importers.couplings import coupling_notes
from geort_drake.hands.importers.finger_names import (
    fingers_by_name,
    fingers_by_place,
    side_by_name,
    thumb_by_place,
)
from geort_drake.hands.importers.fingertips import Fingertip, Part, find_fingertip, parts_of
from geort_drake.hands.importers.structure import Chain, HandStructure, read_structure
from geort_drake.hands.model import HandModel
from geort_drake.hands.model_files import read_model
from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT

_BASE_NAME = "hand_base"
# A hand base this close to the axes of the palm's link is aligned with them, because stretched fingers may
# lean against the palm; above the second angle, a note says so.
_SNAP_ANGLE, _NOTED_ANGLE = np.deg2rad(30.0), np.deg2rad(5.0)
_POSTURES, _STRETCH_GRID = 300, 7
# Fingers close to one side if their mean tip offset is this fraction of their mean distance from straight.
_CLOSING_FRACTION = 0.6
# A thumb is beside the fingers if its sideways offset is this fraction of its offset to the front.
_SIDEWAYS_FRACTION = 0.35
# Links that touch in this fraction of random postures are taken to touch in all of them.
_PERMANENT_FRACTION = 0.95
# How far the joints are opened towards the middle of their ranges to find a start without collision.
_OPENINGS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
# With this rotation on the shipped adapter, a left hand is the mirror image of a right one, degrees.
_LEFT_MOUNT = (0.0, 0.0, 90.0)
# Gains for models without position controllers, those of the Allegro hand: N·m/rad, N·m·s/rad, N·m.
_GAINS = ActuationDescription(stiffness=1.0, damping=0.1, effort_limit=1.0)


@dc.dataclass(frozen=True)
class Proposal:
    """A hand description, and notes for its user.

    Attributes:
        description: with the absolute path of the model.
        notes: one sentence on each guess or omission.
    """

    description: HandDescription
    notes: list[str]


@dc.dataclass(frozen=True)
class _Finger:
    """A chain, and how it lies and closes in the root link R.

    `p_base` is its first joint, `p_RF` (N, 3) are places of its tip at random postures, `p_stretched` is the
    farthest one, m.
    """

    chain: Chain
    p_base: np.ndarray
    p_stretched: np.ndarray
    p_RF: np.ndarray

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector along the stretched finger."""
        return _unit(self.p_stretched - self.p_base)

    @property
    def length(self) -> float:
        """Of the stretched finger, m."""
        return float(np.linalg.norm(self.p_stretched - self.p_base))

    @property
    def sideways(self) -> np.ndarray:
        """(N, 3) offsets of the tip perpendicular to the stretched finger, m."""
        v = self.p_RF - self.p_stretched
        return v - np.outer(v @ self.direction, self.direction)


def propose(model: Path, name: str | None = None, palm: str | None = None) -> Proposal:
    """Describes a model as far as it can be read or guessed.

    Args:
        model: URDF, SDF or MJCF file.
        name: of the hand; by default made from the file's.
        palm: link that carries the fingers; by default the one that most chains of joints leave.

    Raises:
        HandError: the model cannot be read, or is not one hand with 2 to 5 fingers of revolute joints.
        UnknownNameError: it has no such link.
    """
    structure = read_structure(model.resolve(), palm)
    plant = structure.plant
    notes: list[str] = []
    tips = [find_fingertip(structure, chain) for chain in structure.chains]
    # In the frame R of the root link, under names that are yet to be found.
    rough = HandDescription(
        name=name or re.sub(r"\W+", "_", model.stem),
        model=str(model.resolve()),
        base_frame=structure.root,
        fingers=[_describe(*each) for each in zip(FINGER_NAMES, structure.chains, tips, strict=False)],
        couplings=[
            CouplingDescription(c.joint, c.follows, round(c.ratio, 6), round(c.offset, 6))
            for c in structure.couplings
        ],
    )
    rough.default_positions = _default_positions(structure, rough)
    hand = HandModel(rough)
    fingers = _fingers(structure, hand)
    names, X_RB, side = _arrange(structure, fingers, notes)
    guessed: dict[str, list[str]] = {}
    for tip, label in zip(tips, names, strict=True):
        if not tip.source.startswith("a sphere"):
            guessed.setdefault(tip.source, []).append(f"{label} {1e3 * tip.radius:.1f} mm")
    notes += [f"tips and their radii come from {source}: {', '.join(of)}" for source, of in guessed.items()]
    for reason in dict.fromkeys(structure.held.values()):
        joints = ", ".join(f"'{joint}'" for joint, why in structure.held.items() if why == reason)
        notes.append(f"joints are held at their default positions, as each {reason}: {joints}")
    notes += coupling_notes(read_model(structure.path))
    palm_link = structure.palm[0]
    X_PB = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), palm_link).inverse() @ X_RB
    rpy_deg = np.rad2deg(RollPitchYaw(X_PB.rotation()).vector())
    taken = {plant.get_frame(index).name() for index in plant.GetFrameIndices(structure.hand)}
    base = next(
        f"{_BASE_NAME}{extra}" for extra in ("", *range(2, 100)) if f"{_BASE_NAME}{extra}" not in taken
    )
    described = [_describe(*each) for each in zip(names, structure.chains, tips, strict=True)]
    description = dc.replace(
        rough,
        side=side,
        base_frame=base,
        base_pose=BasePoseDescription(palm_link.name(), _rounded(X_PB.translation()), _rounded(rpy_deg, 2)),
        fingers=sorted(described, key=lambda finger: FINGER_NAMES.index(finger.name)),
        ignored_collisions=sorted(
            [a, b]
            for (a, b), share in contact_fractions(hand).items()
            if share >= _PERMANENT_FRACTION and a != b
        ),
        actuation=_actuation(structure, notes),
    )
    if side == "left":
        description.mount.rpy_deg = list(_LEFT_MOUNT)
    hand = HandModel(description)
    # The rearmost part lies on the arm.
    description.mount.translation = [0.0, 0.0, round(_depth(hand), 3)]
    start = _free_posture(hand)
    if start is None:
        notes.append("no initial posture without self-collision was found")
    elif (start != hand.default_position).any():
        description.default_positions |= dict(zip(hand.joint_names, _rounded(start), strict=True))
    return Proposal(description, notes)


def _fingers(structure: HandStructure, hand: HandModel) -> list[_Finger]:
    """Moves the hand through random postures, and stretches each finger."""
    q = hand.sample(_POSTURES)
    p_RF = hand.fingertips(q)
    context = structure.plant.CreateDefaultContext()
    fingers = []
    for number, chain in enumerate(structure.chains):
        first = structure.plant.GetJointByName(chain.joints[0], structure.hand)
        p_base = first.frame_on_parent().CalcPoseInWorld(context).translation()
        best = q[np.linalg.norm(p_RF[:, number] - p_base, axis=1).argmax()].copy()
        # From the most stretched sample, stretch one joint after the other, from the tip to the base.
        for joint in reversed([hand.joint_names.index(name) for name in chain.joints]):
            low, high = hand.lower[joint], hand.upper[joint]
            trials = np.tile(best, (_STRETCH_GRID, 1))
            trials[:, joint] = np.linspace(low, high, _STRETCH_GRID)
            if low < 0 < high:
                trials[_STRETCH_GRID // 2, joint] = 0.0
            reached = np.linalg.norm(hand.fingertips(trials)[:, number] - p_base, axis=1)
            # A joint that does not change the length, such as abduction, goes to zero.
            flat = np.ptp(reached) < 0.02 * reached.max()
            best[joint] = np.clip(0.0, low, high) if flat else trials[reached.argmax(), joint]
        fingers.append(_Finger(chain, p_base, hand.fingertips(best)[number], p_RF[:, number]))
    return fingers


def _arrange(
    structure: HandStructure, fingers: list[_Finger], notes: list[str]
) -> tuple[list[str], RigidTransform, str]:
    """The fingers' names, the pose X_RB of the hand base in the root link, and the side."""
    p_base = np.array([finger.p_base for finger in fingers])
    directions = np.array([finger.direction for finger in fingers])
    named = fingers_by_name([finger.chain.names for finger in fingers])
    if named is not None and "thumb" in named:
        thumb = named.index("thumb")
    else:
        named = None
        thumb = thumb_by_place(p_base, directions, np.array([finger.length for finger in fingers]))
        joints = ", ".join(fingers[thumb].chain.joints)
        notes.append(f"no name identifies the thumb; it is taken to be the finger with the joints {joints}")
    others = [number for number in range(len(fingers)) if number != thumb]
    z = _unit(directions[others].mean(axis=0))
    sideways = np.concatenate([fingers[number].sideways for number in others])
    x = sideways.mean(axis=0)
    if np.linalg.norm(x) < _CLOSING_FRACTION * np.linalg.norm(sideways, axis=1).mean():
        x = p_base[thumb] - p_base[others].mean(axis=0)
        notes.append("the fingers bend to both sides alike; the palm's side is taken to be the thumb's")
    x = _unit(x - (x @ z) * z)
    plant, hand = structure.plant, structure.hand
    context = plant.CreateDefaultContext()
    R_RP = plant.EvalBodyPoseInWorld(context, structure.palm[0]).rotation().matrix()
    R_RB = R_RP @ _snapped(R_RP.T @ np.column_stack([x, np.cross(z, x), z]), notes)
    knuckles = p_base[others].mean(axis=0)
    thumb_place = 0.5 * (p_base[thumb] + fingers[thumb].p_RF.mean(axis=0)) - knuckles
    forward, to_left, _ = thumb_place @ R_RB
    side = "right" if to_left > 0 else "left"
    links = [plant.get_body(index).name() for index in plant.GetBodyIndices(hand)]
    # The links come last, because those of a whole robot are of both sides.
    named_side = (
        side_by_name([structure.path.stem])
        or side_by_name([structure.palm[0].name()])
        or side_by_name([plant.GetModelInstanceName(hand), *links])
    )
    if abs(to_left) < _SIDEWAYS_FRACTION * abs(forward):
        side = named_side or "right"
        notes.append(f"the thumb is opposite to the fingers, not beside them; taken for a {side} hand")
    elif named_side is not None and named_side != side:
        notes.append(
            f"names say that this is a {named_side} hand, but the thumb's place says a {side} hand; check "
            "base_pose and side, and the joint limits, which may close the fingers backwards"
        )
    if named is None:
        towards_thumb = (p_base - knuckles) @ R_RB[:, 1] * (1 if side == "right" else -1)
        named = fingers_by_place(len(fingers), thumb, towards_thumb)
    parts: list[Part] = []
    for role in (Role.kProximity, Role.kIllustration):
        parts = parts or parts_of(plant, structure.scene_graph, structure.palm, role, plant.world_frame())
    origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in structure.palm]
    palm = np.concatenate([part.points for part in parts]) if parts else np.array(origins)
    # The wrist end of the palm, behind the middle of the knuckles.
    wrist = knuckles + ((palm - knuckles) @ R_RB[:, 2]).min(initial=0.0) * R_RB[:, 2]
    return named, RigidTransform(RotationMatrix(R_RB), wrist), side


def _snapped(R: np.ndarray, notes: list[str]) -> np.ndarray:
    """The rotation aligned with the nearest axes, if they are near."""
    nearest = np.zeros((3, 3))
    rows = np.abs(R).argmax(axis=0)
    nearest[rows, range(3)] = np.sign(R[rows, range(3)])
    if len(set(rows.tolist())) == 3 and np.linalg.det(nearest) > 0:
        angle = np.arccos(np.clip(0.5 * (np.trace(nearest.T @ R) - 1.0), -1.0, 1.0))
        if angle < _SNAP_ANGLE:
            if angle > _NOTED_ANGLE:
                notes.append(
                    f"the hand base has the axes of the palm's link; stretched fingers lean by "
                    f"{np.rad2deg(angle):.0f} degrees"
                )
            return nearest
    notes.append(
        "no axes of the palm's link lie along the fingers, so the hand base is aligned with the fingers"
    )
    return R


def _describe(name: str, chain: Chain, tip: Fingertip) -> FingerDescription:
    return FingerDescription(
        name=name,
        human_keypoint=TIP_KEYPOINT[name],
        joints=chain.joints,
        tip_link=tip.body.name(),
        tip_point=_rounded(tip.point),
        tip_radius=round(tip.radius, 5),
    )


def _default_positions(structure: HandStructure, description: HandDescription) -> dict[str, float]:
    """For joints whose default is outside their limits: a tenth of the range from the nearer limit."""
    positions = {}
    limits = position_limits(structure.plant, description, structure.hand, f"model {structure.path}")
    for name, low, high in zip(description.joint_names, *limits, strict=True):
        start = structure.plant.GetJointByName(name, structure.hand).get_default_angle()
        if not low <= start <= high:
            margin = 0.1 * (high - low)
            positions[name] = round(float(low + margin if start < low else high - margin), 4)
    return positions


def _free_posture(hand: HandModel) -> np.ndarray | None:
    """(n,) joint positions without self-collision, near the default ones; None if none was found."""
    start = hand.default_position
    for opening in _OPENINGS:
        q = start + opening * (0.5 * (hand.lower + hand.upper) - start)
        if not hand.collides(q):
            return q
    q = hand.sample(_POSTURES)
    free = q[~hand.collides(q)]
    return free[np.linalg.norm(free - start, axis=1).argmin()] if len(free) else None


def _depth(hand: HandModel) -> float:
    """How far the hand's collision geometry reaches behind the hand base in the default posture, m."""
    links = map(hand.plant.get_body, hand.plant.GetBodyIndices(hand.instance))
    base = hand.plant.GetFrameByName(hand.description.base_frame, hand.instance)
    parts = parts_of(hand.plant, hand.scene_graph, links, Role.kProximity, base)
    return max([0.0, *(-float(part.points[:, 2].min()) for part in parts)])


def _actuation(structure: HandStructure, notes: list[str]) -> ActuationDescription:
    """The model's own gains if every joint has some, else default ones."""
    plant = structure.plant
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(structure.hand)]
    ready = {actuator.joint().name() for actuator in actuators if actuator.has_controller()}
    joints = [joint for chain in structure.chains for joint in chain.joints]
    without = [f"'{joint}'" for joint in joints if joint not in ready]
    if not without:
        return ActuationDescription()
    some = f"{len(without)} of {len(joints)} joints, such as {without[0]}, have" if ready else "the model has"
    notes.append(
        f"{some} no position controllers; under actuation, replace the default gains "
        f"{_GAINS.stiffness:g} N·m/rad, {_GAINS.damping:g} N·m·s/rad and {_GAINS.effort_limit:g} N·m by "
        "your hand's"
    )
    return _GAINS


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def _rounded(values: np.ndarray, digits: int = 5) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
