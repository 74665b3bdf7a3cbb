"""Infers finger names, hand base and side from the shapes of a model's fingers and their names."""

import re
from collections.abc import Iterable

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
# Up to this angle, the hand base is aligned with the palm's link: stretched fingers may lean, rad.
_ALIGNED = np.deg2rad(30.0)
# A hand is a left one if its thumb, or its index finger, is this far to the right of the others, m.
_APART = 0.01


def arrange(structure: HandStructure, hand: Hand, notes: list[str]) -> tuple[list[str], RigidTransform, str]:
    """Finds the finger name of each chain, the pose X_PB of the hand base in the palm's link P, and the side.

    Args:
        structure: structure of the model.
        hand: the model with provisional finger names and its root link R as hand base.
        notes: receives a sentence on each guess.
    """
    fingers = finger_shapes(hand, hand.default_position)
    names = [finger_by_name(chain.names) for chain in structure.chains]
    all_named = "" not in names and "thumb" in names and len(set(names)) == len(names)
    thumb = names.index("thumb") if names.count("thumb") == 1 else _thumb_by_shape(structure, fingers, notes)
    others = [number for number in range(len(fingers)) if number != thumb]
    knuckles = np.array([finger.p_knuckle for finger in fingers])
    middle = knuckles[others].mean(axis=0)
    z = unit(np.mean([fingers[number].direction for number in others], axis=0))
    x = np.mean([fingers[number].bending for number in others], axis=0)
    if np.linalg.norm(x) < CLOSING_FRACTION:
        x = fingers[thumb].p_base - middle
        notes.append("the fingers bend equally to both sides; the palm is assumed to be on the thumb's side")
    x = unit(x - (x @ z) * z)
    plant = structure.plant
    context = plant.CreateDefaultContext()
    X_RP = plant.EvalBodyPoseInWorld(context, structure.palm[0])
    R_RP = X_RP.rotation().matrix()
    R_RB = R_RP @ _aligned(R_RP.T @ np.column_stack([x, np.cross(z, x), z]), notes)
    to_left = (knuckles - middle) @ R_RB[:, 1]
    thumb_to_left = float((0.5 * (fingers[thumb].p_base + fingers[thumb].p_middle) - middle) @ R_RB[:, 1])
    if all_named and len(names) > 2:
        # The order of the knuckles of named fingers tells more than the thumb's place.
        first, *_, last = sorted(others, key=lambda number: FINGER_NAMES.index(names[number]))
        thumb_to_left = to_left[first] - to_left[last]
    side = "left" if thumb_to_left < -_APART else "right"
    if not all_named:
        # The index finger is nearest to the thumb's side.
        in_order = sorted(others, key=lambda number: to_left[number] * (1 if side == "left" else -1))
        names = [FINGER_NAMES[0]] * len(fingers)
        for name, number in zip(FINGER_NAMES[1:], in_order, strict=False):
            names[number] = name
        notes.append("the fingers other than the thumb are named by their places")
    parts = geometry_of(structure, structure.palm)
    origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in structure.palm]
    palm = np.vstack([*origins, *(part.points for part in parts)])
    # The hand base is at the wrist end of the palm, behind the middle of the knuckles.
    wrist = middle + ((palm - middle) @ R_RB[:, 2]).min(initial=0.0) * R_RB[:, 2]
    return names, X_RP.inverse() @ RigidTransform(RotationMatrix(R_RB), wrist), side


def _thumb_by_shape(structure: HandStructure, fingers: list[FingerShape], notes: list[str]) -> int:
    """Returns the number of the finger whose direction differs most from that of the others."""
    directions = np.array([finger.direction for finger in fingers])
    thumb = int(np.argmin(directions @ directions.sum(axis=0)))
    joints = ", ".join(structure.chains[thumb].joints)
    notes.append(f"no name identifies the thumb; it is assumed to be the finger with the joints {joints}")
    return thumb


def finger_by_name(names: Iterable[str]) -> str:
    """Returns the finger that most of its joints and links name, or an empty string."""
    texts = [name.lower() for name in names]
    counts = {finger: sum(bool(re.search(word, text)) for text in texts) for finger, word in _WORDS.items()}
    # "Middle" may also mean a phalanx.
    best = max(counts, key=lambda finger: (counts[finger], finger != "middle"))
    return best if counts[best] else ""


def _aligned(R_PB: np.ndarray, notes: list[str]) -> np.ndarray:
    """Returns the rotation that exchanges axes nearest to R_PB, if it is near."""
    exchanges = Rotation.create_group("O")
    angles = (exchanges.inv() * Rotation.from_matrix(R_PB)).magnitude()
    if angles.min() < _ALIGNED:
        return np.rint(exchanges[angles.argmin()].as_matrix())
    notes.append(
        "no axes of the palm's link lie along the fingers, so the hand base is aligned with the fingers"
    )
    return R_PB
