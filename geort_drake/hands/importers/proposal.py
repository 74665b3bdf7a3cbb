"""Proposes a hand description for a model: fingers, fingertips, hand base, side, couplings and gains."""

import dataclasses as dc
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from pydrake.geometry import Convex, Mesh, Role
from pydrake.math import RollPitchYaw

from geort_drake.errors import HandError, listed, naming
from geort_drake.hands.assembly import HandInPlant, joint_paths
from geort_drake.hands.description import (
    ActuationDescription,
    BasePoseDescription,
    CouplingDescription,
    FingerDescription,
    HandDescription,
)
from geort_drake.hands.geometry import parts_of
from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.arrangement import arrange
from geort_drake.hands.importers.checks import FREQUENT_FRACTION, contact_fractions
from geort_drake.hands.importers.fingers import find_tip
from geort_drake.hands.importers.structure import HandStructure
from geort_drake.people.keypoints import FINGER_NAMES, TIP_KEYPOINT

# Links that touch in this fraction of random postures are assumed to touch in all postures.
_PERMANENT_FRACTION = 0.95
# Random postures towards which the start moves, in this many steps, until it is free of self-collision.
_POSTURES, _STEPS = 100, 10
# With this rotation on the shipped adapter, deg, a left hand is the mirror image of a right hand.
_LEFT_MOUNT = (0.0, 0.0, 90.0)
# Gains for models without position controllers: those of the Allegro hand, N·m/rad, N·m·s/rad, N·m.
_GAINS = ActuationDescription(stiffness=1.0, damping=0.1, effort_limit=1.0)


def propose(
    model: Path, name: str | None = None, palm: str | None = None, hulls: bool = False
) -> tuple[HandDescription, list[str]]:
    """Describes a model as far as it can be read or guessed.

    Args:
        model: URDF, SDF or MJCF file.
        name: name of the hand; by default derived from the file's.
        palm: link that carries the fingers; by default the one from which most joints start.
        hulls: whether links without collision geometry collide as they are drawn.

    Returns:
        The description, with the absolute path of its model, and a sentence on each guess or omission.

    Raises:
        HandError: the model cannot be read, or is not one hand with 2 to 5 fingers of revolute joints.
        UnknownNameError: the model has no such link.
    """
    structure = HandStructure(model.resolve(), palm)
    notes = structure.notes
    draft = _draft(structure, name or re.sub(r"\W+", "_", model.stem), hulls)
    hand = Hand(draft)
    names, X_PB, side = arrange(structure, hand, notes)
    fingers = [
        dc.replace(finger, name=label, human_keypoint=TIP_KEYPOINT[label])
        for finger, label in zip(draft.fingers, names, strict=True)
    ]
    notes += _notes_on_joints(structure, draft.joint_names)
    overlaps = _overlaps(hand)
    if overlaps:
        # First the pairs that can be apart.
        pairs = sorted(overlaps.items(), key=lambda item: item[1])
        texts = [f"'{a}' and '{b}' in {share:.0%} of postures" for (a, b), share in pairs]
        notes.append(f"contacts of links with overlapping shapes are ignored: {listed(texts)}")
    base_frame = "hand_base"
    while structure.plant.HasFrameNamed(base_frame, structure.hand):
        base_frame += "_"
    palm_link, rpy_deg = structure.palm[0].name(), np.rad2deg(RollPitchYaw(X_PB.rotation()).vector())
    description = dc.replace(
        draft,
        side=side,
        base_frame=base_frame,
        base_pose=BasePoseDescription(palm_link, _round(X_PB.translation()), _round(rpy_deg, 2)),
        fingers=sorted(fingers, key=lambda finger: FINGER_NAMES.index(finger.name)),
        ignored_collisions=sorted([a, b] for a, b in overlaps),
        actuation=_actuation(structure, notes),
    )
    if side == "left":
        description.mount.rpy_deg = list(_LEFT_MOUNT)
    hand = Hand(description)
    # The rearmost part touches the arm.
    description.mount.translation = [0.0, 0.0, round(_depth(hand), 3)]
    start = _free_posture(hand)
    if start is None:
        notes.append("no initial posture without self-collision was found")
    elif (start != hand.default_position).any():
        description.default_positions |= dict(zip(hand.joint_names, _round(start), strict=True))
    return description, notes


def _draft(structure: HandStructure, name: str, hulls: bool) -> HandDescription:
    """Returns what is known without the hand base.

    The root link stands for the base, and the fingers have provisional names.
    """
    draft = HandDescription(
        name=name,
        model=str(structure.path),
        base_frame=structure.root,
        couplings=[
            CouplingDescription(c.joint, c.follows, round(c.ratio, 6), round(c.offset, 6))
            for c in structure.couplings
        ],
        collide_as_drawn=_links_without_collisions(structure) if hulls else [],
    )
    for chain, label in zip(structure.chains, FINGER_NAMES, strict=False):
        link, point, radius = find_tip(structure, chain)
        tip = (link.name(), _round(point), *_round([radius]))
        draft.fingers.append(FingerDescription(label, TIP_KEYPOINT[label], chain.joints, *tip))
    draft.default_positions = _default_positions(structure, draft)
    return draft


def _notes_on_joints(structure: HandStructure, joint_names: list[str]) -> Iterator[str]:
    """Yields sentences on joints that are held, by reason, and on joints whose velocity limit is unknown."""
    held = structure.held_joints
    for reason in dict.fromkeys(held.values()):
        names = listed([f"'{name}'" for name in held if held[name] == reason])
        yield f"joints are held at their default positions, as each {reason}: {names}"
    for name in joint_names:
        if not structure.plant.GetJointByName(name, structure.hand).velocity_upper_limit() > 0:
            yield f"the velocity limit 0 of joint '{name}' counts as unknown: correct it in the model"


def _links_without_collisions(structure: HandStructure) -> list[str]:
    """Returns the names of drawn links that neither collide nor are welded to links that do."""
    plant, inspector = structure.plant, structure.scene_graph.model_inspector()
    return [
        body.name()
        for body in map(plant.get_body, plant.GetBodyIndices(structure.hand))
        if inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body.index()), Role.kIllustration)
        and not any(map(plant.GetCollisionGeometriesForBody, plant.GetBodiesWeldedTo(body)))
    ]


def _overlaps(hand: Hand) -> dict[tuple[str, str], float]:
    """Maps pairs of links with overlapping shapes to the fraction of random postures in which they touch.

    Such links touch in all postures, or frequently if at most two joints separate them and one has a mesh,
    whose convex hull is larger than the part.
    """
    plant, inspector = hand.plant, hand.scene_graph.model_inspector()
    joints, hulls = {}, set()
    for index, path in joint_paths(plant, hand.instance).items():
        link = plant.get_body(index)
        joints[link.name()] = {joint.name() for joint in path if joint.num_positions()}
        shapes = map(inspector.GetShape, plant.GetCollisionGeometriesForBody(link))
        if any(isinstance(shape, Convex | Mesh) for shape in shapes):
            hulls.add(link.name())
    shares = {}
    for (a, b), share in sorted(contact_fractions(hand).items()):
        near = len(joints[a] ^ joints[b]) <= 2 and not hulls.isdisjoint((a, b))
        if share >= (FREQUENT_FRACTION if near else _PERMANENT_FRACTION):
            shares[a, b] = share
    return shares


def _default_positions(structure: HandStructure, description: HandDescription) -> dict[str, float]:
    """Returns positions a tenth of the range inside the limits, for joints whose default is outside, rad."""
    positions = {}
    with naming(f"model {structure.path}", HandError):
        limits = HandInPlant(structure.plant, description, structure.hand).position_limits()
    for name, low, high in zip(description.joint_names, *limits, strict=True):
        start = structure.plant.GetJointByName(name, structure.hand).get_default_angle()
        if not low <= start <= high:
            margin = 0.1 * (high - low)
            positions[name] = round(float(low + margin if start < low else high - margin), 4)
    return positions


def _free_posture(hand: Hand) -> np.ndarray | None:
    """Returns (n,) joint positions without self-collision, as near to the default ones as one is found."""
    start = hand.default_position
    if not hand.collides(start):
        return start
    samples = hand.sample(_POSTURES)
    for step in range(_STEPS):
        q = start + (step + 1) / _STEPS * (samples - start)
        free = q[~hand.collides(q)]
        if len(free):
            return free[0]
    return None


def _depth(hand: Hand) -> float:
    """Returns how far the collision geometry extends behind the hand base in the default posture, m."""
    base = hand.plant.GetFrameByName(hand.description.base_frame, hand.instance)
    parts = parts_of(hand.plant, hand.scene_graph, hand.links, Role.kProximity, base)
    return max([0.0, *(-float(part.points[:, 2].min()) for part in parts)])


def _actuation(structure: HandStructure, notes: list[str]) -> ActuationDescription:
    """Keeps the model's own gains if every joint has a controller, else returns default gains."""
    plant = structure.plant
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(structure.hand)]
    controlled = {actuator.joint().name() for actuator in actuators if actuator.has_controller()}
    joints = [joint for chain in structure.chains for joint in chain.joints]
    without = [f"'{joint}'" for joint in joints if joint not in controlled]
    if not without:
        return ActuationDescription()
    notes.append(
        f"joints have no position controllers: {listed(without)}; under actuation, replace the default gains "
        f"{_GAINS.stiffness:g} N·m/rad, {_GAINS.damping:g} N·m·s/rad and {_GAINS.effort_limit:g} N·m with "
        "your hand's"
    )
    return _GAINS


def _round(values: Iterable[float], digits: int = 5) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
