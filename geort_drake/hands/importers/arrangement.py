"""Infers finger names, hand base and side from the shapes of a model's fingers and its names."""

import re
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.fingers import Part, finger_shapes, parts_of, unit
from geort_drake.hands.importers.structure import HandStructure
from geort_drake.people.keypoints import FINGER_NAMES

# Names of fingers in models; Shadow and others use two-letter names.
_WORDS = {
    "thumb": r"thumb|pollex|(?<![a-z])th(?![a-z])|(?<![a-z])thj",
    "index": r"index|fore|point(?!_)|(?<![a-z])ff|(?<![a-z])if(?![a-z])",
    "middle": r"middle|medium|long|(?<![a-z])mf",
    "ring": r"(?<![a-z])ring|(?<![a-z])rf",
    "little": r"little|pinky|pinkie|small|(?<![a-z])lf",
}
_SIDES = {
    "right": r"right|(?<![a-z0-9])(rh|r)(?![a-z0-9])",
    "left": r"left|(?<![a-z0-9])(lh|l)(?![a-z0-9])",
}
# Up to the first angle from the axes of the palm's link, the hand base is aligned with these axes, because
# stretched fingers may lean against the palm; above the second angle, a note says so.
_SNAP_ANGLE, _NOTED_ANGLE = np.deg2rad(30.0), np.deg2rad(5.0)
# Fingers close to one side if mid-range is off the stretched posture by this part of the range.
_CLOSING_FRACTION = 0.25
# A thumb is at the fingers' side if its sideways offset is over this fraction of its offset to the front.
_SIDEWAYS_FRACTION = 0.35
# Index and last finger tell the side if their knuckles are this far apart, m.
_KNUCKLES_APART = 0.01


def arrange(structure: HandStructure, hand: Hand, notes: list[str]) -> tuple[list[str], RigidTransform, str]:
    """Finds the finger name of each chain, the pose X_RB of the hand base in the root link R, and the side.

    Args:
        structure: structure of the model.
        hand: the model with provisional finger names and R as hand base.
        notes: receives a sentence on each guess.
    """
    plant = structure.plant
    drawn = [plant.GetJointByName(name, structure.hand).get_default_angle() for name in hand.joint_names]
    fingers = finger_shapes(hand, np.clip(drawn, hand.lower, hand.upper))
    knuckles = np.array([finger.p_knuckle for finger in fingers])
    directions = np.array([finger.direction for finger in fingers])
    named = fingers_by_name([chain.names for chain in structure.chains])
    thumbs = [fingers_by_name([chain.names]) == ["thumb"] for chain in structure.chains]
    if named is not None and "thumb" in named:
        thumb = named.index("thumb")
    elif thumbs.count(True) == 1:
        named, thumb = None, thumbs.index(True)
        notes.append("names identify only the thumb; the other fingers are named by their positions")
    else:
        named = None
        thumb = _thumb_by_position(
            np.array([finger.p_base for finger in fingers]), directions, [f.length for f in fingers]
        )
        joints = ", ".join(structure.chains[thumb].joints)
        notes.append(f"no name identifies the thumb; it is assumed to be the finger with the joints {joints}")
    others = [number for number in range(len(fingers)) if number != thumb]
    middle = knuckles[others].mean(axis=0)
    z = unit(directions[others].mean(axis=0))
    x = np.sum([fingers[number].bending for number in others], axis=0)
    if np.linalg.norm(x) < _CLOSING_FRACTION * sum(fingers[number].play for number in others):
        x = fingers[thumb].p_base - middle
        notes.append("the fingers bend equally to both sides; the palm is assumed to be on the thumb's side")
    x = unit(x - (x @ z) * z)
    context = plant.CreateDefaultContext()
    R_RP = plant.EvalBodyPoseInWorld(context, structure.palm[0]).rotation().matrix()
    R_RB = R_RP @ _snapped(R_RP.T @ np.column_stack([x, np.cross(z, x), z]), notes)
    side = _side(structure, named, (knuckles - middle) @ R_RB[:, 1], thumb, notes, (
        0.5 * (fingers[thumb].p_base + fingers[thumb].p_middle) - middle
    ) @ R_RB)  # fmt: skip
    if named is None:
        towards_thumb = (knuckles - middle) @ R_RB[:, 1] * (1 if side == "right" else -1)
        named = _fingers_by_position(thumb, towards_thumb)
    parts: list[Part] = []
    for role in (Role.kProximity, Role.kIllustration):
        parts = parts or parts_of(plant, structure.scene_graph, structure.palm, role, plant.world_frame())
    origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in structure.palm]
    palm = np.concatenate([part.points for part in parts]) if parts else np.array(origins)
    # The hand base is at the wrist end of the palm, behind the middle of the knuckles.
    wrist = middle + ((palm - middle) @ R_RB[:, 2]).min(initial=0.0) * R_RB[:, 2]
    return named, RigidTransform(RotationMatrix(R_RB), wrist), side


def _side(
    structure: HandStructure,
    named: list[str] | None,
    across: np.ndarray,
    thumb: int,
    notes: list[str],
    thumb_place: np.ndarray,
) -> str:
    """Returns the side of the hand.

    The order of the knuckles of named fingers decides, else the thumb's place, else names.

    Args:
        structure: structure of the model.
        named: names of the fingers, if they are known.
        across: (F,) coordinates of the knuckles along y of the hand base, m.
        thumb: number of the thumb.
        notes: receives a sentence on each guess.
        thumb_place: (3,) position of the thumb relative to the middle of the knuckles, in the hand base, m.
    """
    plant, hand = structure.plant, structure.hand
    links = [plant.get_body(index).name() for index in plant.GetBodyIndices(hand)]
    # Names of links come last, because a whole robot has links of both sides.
    named_side = (
        side_by_name([structure.path.stem])
        or side_by_name([structure.palm[0].name()])
        or side_by_name([plant.GetModelInstanceName(hand), *links])
    )
    forward, to_left, _ = thumb_place
    place = "thumb's position indicates"
    if named is not None and len(named) > 2:
        order = sorted(
            (n for n in range(len(named)) if n != thumb), key=lambda n: FINGER_NAMES.index(named[n])
        )
        apart = across[order[0]] - across[order[-1]]
        if abs(apart) > _KNUCKLES_APART:
            forward, to_left, place = 0.0, float(apart), "order of the fingers indicates"
    if abs(to_left) < _SIDEWAYS_FRACTION * abs(forward):
        side = named_side or "right"
        notes.append(f"the thumb is opposite the fingers, not at their side; assuming a {side} hand")
        return side
    side = "right" if to_left > 0 else "left"
    if named_side is not None and named_side != side:
        notes.append(
            f"names indicate a {named_side} hand, but the {place} a {side} hand; check base_pose and "
            "side, and the joint limits, which may close the fingers backwards"
        )
    return side


def fingers_by_name(names: Sequence[Sequence[str]]) -> list[str] | None:
    """Identifies the finger of each chain by names; returns None if these are ambiguous.

    Args:
        names: names of each chain's joints and links.
    """
    found = []
    for group in names:
        counts = {
            finger: sum(bool(re.search(word, name.lower())) for name in group)
            for finger, word in _WORDS.items()
        }
        # "Middle" may also mean a phalanx.
        best = max(counts, key=lambda finger: (counts[finger], finger != "middle"))
        found.append(best if counts[best] else "")
    return found if "" not in found and len(set(found)) == len(found) else None


def side_by_name(texts: Sequence[str]) -> str | None:
    """Returns the side that most of the texts name; None for a tie."""
    right, left = (
        sum(bool(re.search(_SIDES[side], text.lower())) for text in texts) for side in ("right", "left")
    )
    return None if right == left else "right" if right > left else "left"


def _thumb_by_position(p_base: np.ndarray, directions: np.ndarray, lengths: Sequence[float]) -> int:
    """Returns the number of the finger that differs most in position and direction; of two, the shorter.

    Args:
        p_base: (F, 3) positions of the fingers' first joints, m.
        directions: (F, 3) unit vectors along the stretched fingers.
        lengths: (F,) lengths of the stretched fingers, m.
    """
    if len(p_base) == 2:
        return int(np.argmin(lengths))
    scale = max(float(np.ptp(p_base, axis=0).max()), 1e-6)
    apart = []
    for number in range(len(p_base)):
        others = np.delete(np.arange(len(p_base)), number)
        turned = 1.0 - directions[number] @ unit(directions[others].mean(axis=0))
        apart.append(turned + np.linalg.norm(p_base[number] - p_base[others].mean(axis=0)) / scale)
    return int(np.argmax(apart))


def _fingers_by_position(thumb: int, towards_thumb: np.ndarray) -> list[str]:
    """Names fingers by their coordinates (F,) towards the thumb's side, beginning with the index finger."""
    names = [FINGER_NAMES[0]] * len(towards_thumb)
    others = [number for number in np.argsort(-towards_thumb) if number != thumb]
    for name, number in zip(FINGER_NAMES[1:], others, strict=False):
        names[number] = name
    return names


def _snapped(R: np.ndarray, notes: list[str]) -> np.ndarray:
    """Returns the rotation, aligned with the nearest axes if they are close."""
    nearest = np.zeros((3, 3))
    rows = np.abs(R).argmax(axis=0)
    nearest[rows, range(3)] = np.sign(R[rows, range(3)])
    if len(set(rows.tolist())) == 3 and np.linalg.det(nearest) > 0:
        angle = np.arccos(np.clip(0.5 * (np.trace(nearest.T @ R) - 1.0), -1.0, 1.0))
        if angle < _SNAP_ANGLE:
            if angle > _NOTED_ANGLE:
                notes.append(
                    f"the hand base is aligned with the palm's link; stretched fingers lean by "
                    f"{np.rad2deg(angle):.0f} degrees"
                )
            return nearest
    notes.append(
        "no axes of the palm's link lie along the fingers, so the hand base is aligned with the fingers"
    )
    return R
