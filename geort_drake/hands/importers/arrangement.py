"""Infers finger names, hand base and side from the positions and motions of a model's fingers."""

import dataclasses as dc

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix

from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.finger_names import (
    fingers_by_name,
    fingers_by_position,
    side_by_name,
    thumb_by_position,
)
from geort_drake.hands.importers.fingertips import Part, parts_of
from geort_drake.hands.importers.structure import Chain, HandStructure

POSTURES = 300  # number of random postures
_STRETCH_GRID = 7
# Up to the first angle from the axes of the palm's link, the hand base is aligned with these axes, because
# stretched fingers may lean against the palm; above the second angle, a note says so.
_SNAP_ANGLE, _NOTED_ANGLE = np.deg2rad(30.0), np.deg2rad(5.0)
# Fingers close to one side if their mean tip offset is over this fraction of the mean distance from straight.
_CLOSING_FRACTION = 0.6
# A thumb is at the fingers' side if its sideways offset is over this fraction of its offset to the front.
_SIDEWAYS_FRACTION = 0.35


@dc.dataclass(frozen=True)
class _Finger:
    """A chain with its position and motion in the root link R.

    `p_base` is the position of its first joint, `p_RF` (N, 3) are those of its tip in random postures, and
    `p_stretched` is that of its tip when stretched, m.
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
        """Length of the stretched finger, m."""
        return float(np.linalg.norm(self.p_stretched - self.p_base))

    @property
    def sideways(self) -> np.ndarray:
        """(N, 3) offsets of the tip, perpendicular to the stretched finger, m."""
        v = self.p_RF - self.p_stretched
        return v - np.outer(v @ self.direction, self.direction)


def arrange(structure: HandStructure, hand: Hand, notes: list[str]) -> tuple[list[str], RigidTransform, str]:
    """Finds the finger name of each chain, the pose X_RB of the hand base in the root link R, and the side.

    Args:
        structure: structure of the model.
        hand: the model with provisional finger names and R as hand base.
        notes: receives a sentence on each guess.
    """
    fingers = _stretched(structure, hand)
    p_base = np.array([finger.p_base for finger in fingers])
    directions = np.array([finger.direction for finger in fingers])
    named = fingers_by_name([finger.chain.names for finger in fingers])
    called_thumb = [fingers_by_name([finger.chain.names]) == ["thumb"] for finger in fingers]
    if named is not None and "thumb" in named:
        thumb = named.index("thumb")
    elif called_thumb.count(True) == 1:
        named, thumb = None, called_thumb.index(True)
        notes.append("names identify only the thumb; the other fingers are named by their positions")
    else:
        named = None
        thumb = thumb_by_position(p_base, directions, np.array([finger.length for finger in fingers]))
        joints = ", ".join(fingers[thumb].chain.joints)
        notes.append(f"no name identifies the thumb; it is assumed to be the finger with the joints {joints}")
    others = [number for number in range(len(fingers)) if number != thumb]
    z = _unit(directions[others].mean(axis=0))
    sideways = np.concatenate([fingers[number].sideways for number in others])
    x = sideways.mean(axis=0)
    if np.linalg.norm(x) < _CLOSING_FRACTION * np.linalg.norm(sideways, axis=1).mean():
        x = p_base[thumb] - p_base[others].mean(axis=0)
        notes.append("the fingers bend equally to both sides; the palm is assumed to be on the thumb's side")
    x = _unit(x - (x @ z) * z)
    plant = structure.plant
    context = plant.CreateDefaultContext()
    R_RP = plant.EvalBodyPoseInWorld(context, structure.palm[0]).rotation().matrix()
    R_RB = R_RP @ _snapped(R_RP.T @ np.column_stack([x, np.cross(z, x), z]), notes)
    knuckles = p_base[others].mean(axis=0)
    thumb_place = 0.5 * (p_base[thumb] + fingers[thumb].p_RF.mean(axis=0)) - knuckles
    forward, to_left, _ = thumb_place @ R_RB
    side = "right" if to_left > 0 else "left"
    links = [plant.get_body(index).name() for index in plant.GetBodyIndices(structure.hand)]
    # Names of links come last, because a whole robot has links of both sides.
    named_side = (
        side_by_name([structure.path.stem])
        or side_by_name([structure.palm[0].name()])
        or side_by_name([plant.GetModelInstanceName(structure.hand), *links])
    )
    if abs(to_left) < _SIDEWAYS_FRACTION * abs(forward):
        side = named_side or "right"
        notes.append(f"the thumb is opposite the fingers, not at their side; assuming a {side} hand")
    elif named_side is not None and named_side != side:
        notes.append(
            f"names indicate a {named_side} hand, but the thumb's position a {side} hand; check "
            "base_pose and side, and the joint limits, which may close the fingers backwards"
        )
    if named is None:
        towards_thumb = (p_base - knuckles) @ R_RB[:, 1] * (1 if side == "right" else -1)
        named = fingers_by_position(len(fingers), thumb, towards_thumb)
    parts: list[Part] = []
    for role in (Role.kProximity, Role.kIllustration):
        parts = parts or parts_of(plant, structure.scene_graph, structure.palm, role, plant.world_frame())
    origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in structure.palm]
    palm = np.concatenate([part.points for part in parts]) if parts else np.array(origins)
    # The hand base is at the wrist end of the palm, behind the middle of the knuckles.
    wrist = knuckles + ((palm - knuckles) @ R_RB[:, 2]).min(initial=0.0) * R_RB[:, 2]
    return named, RigidTransform(RotationMatrix(R_RB), wrist), side


def _stretched(structure: HandStructure, hand: Hand) -> list[_Finger]:
    """Moves the hand through random postures and stretches each finger."""
    q = hand.sample(POSTURES)
    p_RF = hand.fingertips(q)
    context = structure.plant.CreateDefaultContext()
    fingers = []
    for number, chain in enumerate(structure.chains):
        first = structure.plant.GetJointByName(chain.joints[0], structure.hand)
        p_base = first.frame_on_parent().CalcPoseInWorld(context).translation()
        best = q[np.linalg.norm(p_RF[:, number] - p_base, axis=1).argmax()].copy()
        # Start from the most stretched sample and stretch one joint after the other, from tip to base.
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


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-12)
