"""The fingers of a model: their tips, from the geometry of their last links; and how they lie and bend."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from pydrake.geometry import Capsule, Role, Sphere
from pydrake.multibody.tree import RigidBody
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from geort_drake.hands.geometry import Part, parts_of
from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.structure import Chain, HandStructure
from geort_drake.hands.kinematics import FingerChain

# The cross-section of this last fraction of a finger's last link gives the radius, within bounds, m.
_END_FRACTION = 0.25
_RADIUS_RANGE = (0.003, 0.016)
# Without geometry: the tip's distance, relative to the length of the preceding link, and the radius, m.
_DEFAULT_LENGTH, _DEFAULT_RADIUS = 0.8, 0.008


def find_tip(structure: HandStructure, chain: Chain) -> tuple[RigidBody, np.ndarray, float]:
    """Finds the tip of a finger: the centre of its rounded end, from the geometry of its last links.

    Returns:
        Link, point (3,) in its frame, m, and radius, m.
    """
    plant = structure.plant
    context = plant.CreateDefaultContext()
    joints = [plant.GetJointByName(name, structure.hand) for name in chain.moving]
    p_RJ = [joint.frame_on_child().CalcPoseInWorld(context).translation() for joint in joints]
    parts = geometry_of(structure, chain.bodies)
    if parts:
        link, p_RT, radius = _end_of(parts, p_RJ[-1])
    else:
        lengths = [p_RJ[-1] - p for p in reversed(p_RJ)]
        along = next((v for v in lengths if np.linalg.norm(v) > 1e-3), np.array([0.0, 0.0, 0.02]))
        link, p_RT, radius = chain.bodies[0], p_RJ[-1] + _DEFAULT_LENGTH * along, _DEFAULT_RADIUS
    return link, plant.EvalBodyPoseInWorld(context, link).inverse() @ p_RT, radius


def _end_of(parts: list[Part], p_RJ: np.ndarray) -> tuple[RigidBody, np.ndarray, float]:
    """Returns what `find_tip` does, with the point p_RT, of geometries that move with the joint at p_RJ."""
    points = np.concatenate([part.points for part in parts])
    distance = np.linalg.norm(points - p_RJ, axis=1)
    along = (points[distance.argmax()] - p_RJ) / distance.max()
    link, X_RG, shape, _ = max(parts, key=lambda part: np.linalg.norm(part.points - p_RJ, axis=1).max())
    if isinstance(shape, Sphere | Capsule):
        end = np.array([0.0, 0.0, 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0])
        centre = max((X_RG @ end, X_RG @ -end), key=lambda p: float((p - p_RJ) @ along))
        return link, centre, shape.radius()
    depth = (points - p_RJ) @ along
    end_points = points[depth > (1 - _END_FRACTION) * depth.max()] - p_RJ
    across = end_points - np.outer(end_points @ along, along)
    _, _, axes = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)
    low, high = (across @ axes[:2].T).min(axis=0), (across @ axes[:2].T).max(axis=0)
    smallest, largest = _RADIUS_RANGE
    radius = float(np.clip(0.5 * (high - low).min(), smallest, min(largest, 0.5 * depth.max())))
    centre = p_RJ + along * (depth.max() - radius) + axes[:2].T @ (0.5 * (low + high))
    return link, centre, radius


def geometry_of(structure: HandStructure, links: Sequence[RigidBody]) -> list[Part]:
    """Returns the links' collision geometry in the root link R, or else their visual geometry."""
    plant, scene_graph = structure.plant, structure.scene_graph
    roles = (Role.kProximity, Role.kIllustration)
    parts = (parts_of(plant, scene_graph, links, role, plant.world_frame()) for role in roles)
    return next(filter(None, parts), [])


# Joints bend a finger if their axes are parallel to that of its last joint up to this angle.
_PARALLEL = np.cos(np.deg2rad(35.0))
# Fingers bend to one side if mid-range moves their tips across them by this part of their lengths.
CLOSING_FRACTION = 0.25


@dataclass(frozen=True)
class FingerShape:
    """A stretched finger: points (3,) in the frame of the hand base, m.

    Attributes:
        p_base: origin of the finger's first joint.
        p_knuckle: origin of the first joint that bends the finger.
        p_tip: the fingertip.
        p_middle: the fingertip where all joints are in the middle of their ranges.
    """

    p_base: np.ndarray
    p_knuckle: np.ndarray
    p_tip: np.ndarray
    p_middle: np.ndarray

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector along the finger."""
        return unit(self.p_tip - self.p_knuckle)

    @property
    def bending(self) -> np.ndarray:
        """(3,) the tip's move across the finger as all joints move to mid-range, per length of the finger."""
        length = max(float(np.linalg.norm(self.p_tip - self.p_base)), 1e-6)
        move = (self.p_middle - self.p_tip) / length
        return move - (move @ self.direction) * self.direction


def finger_shapes(hand: Hand, start: np.ndarray) -> list[FingerShape]:
    """Returns the shapes of a hand's stretched fingers.

    From `start` (n,), rad, the joints beyond a finger's first bending joint turn until the tip is as far from
    that joint as it can be. A spread joint before it thus has no influence, wherever it lies.
    """
    return [_shape(hand, chain, start) for chain in hand.kinematics().fingers]


def _shape(hand: Hand, chain: FingerChain, start: np.ndarray) -> FingerShape:
    """Returns the shape of one finger."""
    columns = np.array(chain.joint_indices)

    def poses(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the poses (m, 4, 4) of the finger's m joints and its tip (3,) at q (n,)."""
        turns = np.tile(np.eye(4), (len(chain.axes), 1, 1))
        angles = chain.coupling @ q[columns]
        turns[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * chain.axes).as_matrix()
        X_BJ = np.array(list(accumulate(chain.X_PJ @ turns, np.matmul)))
        return X_BJ, X_BJ[-1, :3, :3] @ chain.p_tip + X_BJ[-1, :3, 3]

    def closeness(angles: np.ndarray) -> float:
        q[movers] = angles
        X_BJ, tip = poses(q)
        return -float(np.linalg.norm(tip - X_BJ[knuckle, :3, 3]))

    X_BJ, _ = poses(start)
    axes = (X_BJ[:, :3, :3] @ chain.axes[:, :, None])[..., 0]
    knuckle, *beyond = np.flatnonzero(np.abs(axes @ axes[-1]) > _PARALLEL)
    movers = columns[chain.coupling[beyond].any(axis=0)]
    q = start.copy()
    if movers.size:
        limits = np.column_stack([hand.lower[movers], hand.upper[movers]])
        q[movers] = minimize(closeness, start[movers], bounds=limits).x
    X_BJ, tip = poses(q)
    _, middle = poses(0.5 * (hand.lower + hand.upper))
    return FingerShape(X_BJ[0, :3, 3], X_BJ[knuckle, :3, 3], tip, middle)


def unit(v: np.ndarray) -> np.ndarray:
    """Returns v / |v|, or zero for zero."""
    return v / max(float(np.linalg.norm(v)), 1e-12)
