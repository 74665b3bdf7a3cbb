"""Infers finger names, hand base and side from the shapes of a model's fingers and its names."""

import re
from collections.abc import Sequence

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.fingers import (
    CLOSING_FRACTION,
    FingerShape,
    finger_shapes,
    geometry_of,
    unit,
)
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
# A thumb is at the fingers' side if its sideways offset is over this fraction of its offset to the front.
_SIDEWAYS_FRACTION = 0.35
# Index and last finger tell the side if their knuckles are this far apart, m.
_KNUCKLES_APART = 0.01


def arrange(structure: HandStructure, hand: Hand, notes: list[str]) -> tuple[list[str], RigidTransform, str]:
    """Finds the finger name of each chain, the pose X_PB of the hand base in the palm's link P, and the side.

    Args:
        structure: structure of the model.
        hand: the model with provisional finger names and its root link R as hand base.
        notes: receives a sentence on each guess.
    """
    plant = structure.plant
    q_drawn = [plant.GetJointByName(name, structure.hand).get_default_angle() for name in hand.joint_names]
    fingers = finger_shapes(hand, np.clip(q_drawn, hand.lower, hand.upper))
    names, thumb = _thumb(structure, fingers, notes)
    others = [number for number in range(len(fingers)) if number != thumb]
    knuckles = np.array([finger.p_knuckle for finger in fingers])
    middle = knuckles[others].mean(axis=0)
    z = unit(np.mean([fingers[number].direction for number in others], axis=0))
    x = np.sum([fingers[number].bending for number in others], axis=0)
    if np.linalg.norm(x) < CLOSING_FRACTION * sum(fingers[number].play for number in others):
        x = fingers[thumb].p_base - middle
        notes.append("the fingers bend equally to both sides; the palm is assumed to be on the thumb's side")
    x = unit(x - (x @ z) * z)
    context = plant.CreateDefaultContext()
    X_RP = plant.EvalBodyPoseInWorld(context, structure.palm[0])
    R_RP = X_RP.rotation().matrix()
    R_RB = R_RP @ _snap(R_RP.T @ np.column_stack([x, np.cross(z, x), z]), notes)
    across = (knuckles - middle) @ R_RB[:, 1]
    forward, to_left, _ = (0.5 * (fingers[thumb].p_base + fingers[thumb].p_middle) - middle) @ R_RB
    place = "thumb's position indicates"
    if names is not None and len(names) > 2:
        # The order of the knuckles of named fingers tells more than the thumb's place.
        places = [FINGER_NAMES.index(name) for name in names]
        order = sorted(others, key=places.__getitem__)
        spread = float(across[order[0]] - across[order[-1]])
        if abs(spread) > _KNUCKLES_APART:
            forward, to_left, place = 0.0, spread, "order of the fingers indicates"
    side = _side(structure, forward, to_left, place, notes)
    if names is None:
        # The index finger is nearest to the thumb's side.
        names = [FINGER_NAMES[0]] * len(fingers)
        by_place = np.argsort(-across * (1 if side == "right" else -1))
        in_order = [number for number in by_place if number != thumb]
        for name, number in zip(FINGER_NAMES[1:], in_order, strict=False):
            names[number] = name
    parts, _ = geometry_of(structure, structure.palm)
    origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in structure.palm]
    palm = np.concatenate([part.points for part in parts]) if parts else np.array(origins)
    # The hand base is at the wrist end of the palm, behind the middle of the knuckles.
    wrist = middle + ((palm - middle) @ R_RB[:, 2]).min(initial=0.0) * R_RB[:, 2]
    return names, X_RP.inverse() @ RigidTransform(RotationMatrix(R_RB), wrist), side


def _thumb(
    structure: HandStructure, fingers: list[FingerShape], notes: list[str]
) -> tuple[list[str] | None, int]:
    """Returns the names of the fingers, if the model's names tell them all, and the number of the thumb."""
    names = fingers_by_name([chain.names for chain in structure.chains])
    if names is not None and "thumb" in names:
        return names, names.index("thumb")
    thumbs = [fingers_by_name([chain.names]) == ["thumb"] for chain in structure.chains]
    if thumbs.count(True) == 1:
        notes.append("names identify only the thumb; the other fingers are named by their positions")
        return None, thumbs.index(True)
    if len(fingers) == 2:
        thumb = int(np.argmin([finger.length for finger in fingers]))
    else:
        # The thumb differs most in position and direction.
        p_base = np.array([finger.p_base for finger in fingers])
        directions = np.array([finger.direction for finger in fingers])
        scale = max(float(np.ptp(p_base, axis=0).max()), 1e-6)
        differences = []
        for number in range(len(fingers)):
            others = np.delete(np.arange(len(fingers)), number)
            turn = 1.0 - directions[number] @ unit(directions[others].mean(axis=0))
            offset = np.linalg.norm(p_base[number] - p_base[others].mean(axis=0))
            differences.append(turn + offset / scale)
        thumb = int(np.argmax(differences))
    joints = ", ".join(structure.chains[thumb].joints)
    notes.append(f"no name identifies the thumb; it is assumed to be the finger with the joints {joints}")
    return None, thumb


def _side(structure: HandStructure, forward: float, to_left: float, place: str, notes: list[str]) -> str:
    """Returns the side of a hand whose thumb lies `forward` and `to_left` of the other fingers' knuckles, m.

    Names decide where the thumb is opposite the fingers. `place` says how its place is known.
    """
    plant = structure.plant
    links = [plant.get_body(index).name() for index in plant.GetBodyIndices(structure.hand)]
    # Names of links come last, because a whole robot has links of both sides.
    model = [plant.GetModelInstanceName(structure.hand), *links]
    texts = ([structure.path.stem], [structure.palm[0].name()], model)
    side_in_names = next(filter(None, map(side_by_name, texts)), None)
    if abs(to_left) < _SIDEWAYS_FRACTION * abs(forward):
        side = side_in_names or "right"
        notes.append(f"the thumb is opposite the fingers, not at their side; assuming a {side} hand")
        return side
    side = "right" if to_left > 0 else "left"
    if side_in_names is not None and side_in_names != side:
        notes.append(
            f"names indicate a {side_in_names} hand, but the {place} a {side} hand; check base_pose and "
            "side, and the joint limits, which may close the fingers backwards"
        )
    return side


def fingers_by_name(names: Sequence[Sequence[str]]) -> list[str] | None:
    """Identifies the finger of each chain by names; returns None if these are ambiguous.

    Args:
        names: names of each chain's joints and links.
    """
    fingers = []
    for group in names:
        counts = {
            finger: sum(bool(re.search(word, name.lower())) for name in group)
            for finger, word in _WORDS.items()
        }
        # "Middle" may also mean a phalanx.
        best = max(counts, key=lambda finger: (counts[finger], finger != "middle"))
        fingers.append(best if counts[best] else "")
    return fingers if "" not in fingers and len(set(fingers)) == len(fingers) else None


def side_by_name(texts: Sequence[str]) -> str | None:
    """Returns the side that most of the texts name; None for a tie."""
    right, left = (
        sum(bool(re.search(_SIDES[side], text.lower())) for text in texts) for side in ("right", "left")
    )
    return None if right == left else "right" if right > left else "left"


def _snap(R: np.ndarray, notes: list[str]) -> np.ndarray:
    """Returns the rotation, aligned with the nearest axes if they are close."""
    exchanges = Rotation.create_group("O")  # the rotations that exchange axes
    angles = (exchanges.inv() * Rotation.from_matrix(R)).magnitude()
    angle = angles.min()
    if angle >= _SNAP_ANGLE:
        notes.append(
            "no axes of the palm's link lie along the fingers, so the hand base is aligned with the fingers"
        )
        return R
    if angle > _NOTED_ANGLE:
        notes.append(
            f"the hand base is aligned with the palm's link; stretched fingers lean by "
            f"{np.rad2deg(angle):.0f} degrees"
        )
    return np.rint(exchanges[angles.argmin()].as_matrix())
