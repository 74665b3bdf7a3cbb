"""The fingers of a model: their tips, from the geometry of their last links; and how they lie and bend."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from pydrake.geometry import (
    CalcObb,
    Capsule,
    Convex,
    GeometryId,
    Mesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, RigidBody

from geort_drake.hands.hand import Hand
from geort_drake.hands.importers.structure import Chain, HandStructure
from geort_drake.hands.kinematics import HandKinematics

# The cross-section of this last fraction of a finger's last link gives the radius, within bounds, m.
_END_FRACTION = 0.25
_RADIUS_RANGE = (0.003, 0.016)
# Without geometry: the tip's distance, relative to the length of the preceding link, and the radius, m.
_DEFAULT_LENGTH, _DEFAULT_RADIUS = 0.8, 0.008


class Part(NamedTuple):
    """A geometry G: its link L, its pose in a frame F, its shape, and points (N, 3) in F, m."""

    link: RigidBody
    X_FG: RigidTransform
    shape: Shape
    points: np.ndarray


def find_tip(structure: HandStructure, chain: Chain) -> tuple[RigidBody, np.ndarray, float, str]:
    """Finds the tip of a finger: the centre of its rounded end.

    The tip is the end of the finger's collision geometry, else of its visual geometry, else a guess.

    Returns:
        Link, point (3,) in its frame, m, radius, m, and words for the user on what the tip was derived from.
    """
    plant = structure.plant
    context = plant.CreateDefaultContext()
    joints = [plant.GetJointByName(name, structure.hand) for name in chain.moving]
    p_RJ = [joint.frame_on_child().CalcPoseInWorld(context).translation() for joint in joints]
    parts, kind = geometry_of(structure, chain.bodies)
    if parts:
        link, p_RT, radius, source = _end_of(parts, p_RJ[-1], kind)
    else:
        offsets = [p_RJ[-1] - p for p in reversed(p_RJ)]
        along = next((v for v in offsets if np.linalg.norm(v) > 1e-3), np.array([0.0, 0.0, 0.02]))
        link, p_RT = chain.bodies[0], p_RJ[-1] + _DEFAULT_LENGTH * along
        radius, source = _DEFAULT_RADIUS, "the positions of joints alone"
    return link, plant.EvalBodyPoseInWorld(context, link).inverse() @ p_RT, radius, source


def _end_of(parts: list[Part], p_RJ: np.ndarray, kind: str) -> tuple[RigidBody, np.ndarray, float, str]:
    """Returns what `find_tip` does, with the point p_RT, of geometries that move with the joint at p_RJ."""
    points = np.concatenate([part.points for part in parts])
    distance = np.linalg.norm(points - p_RJ, axis=1)
    along = (points[distance.argmax()] - p_RJ) / distance.max()
    owner = np.repeat(np.arange(len(parts)), [len(part.points) for part in parts])
    link, X_RG, shape, _ = parts[owner[distance.argmax()]]
    if isinstance(shape, Sphere | Capsule):
        end = np.array([0.0, 0.0, 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0])
        centre = max((X_RG @ end, X_RG @ -end), key=lambda p: float((p - p_RJ) @ along))
        return link, centre, shape.radius(), f"a sphere of the {kind}"
    depth = (points - p_RJ) @ along
    end_points = points[depth > (1 - _END_FRACTION) * depth.max()] - p_RJ
    across = end_points - np.outer(end_points @ along, along)
    _, _, axes = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)
    low, high = (across @ axes[:2].T).min(axis=0), (across @ axes[:2].T).max(axis=0)
    radius = float(np.clip(0.5 * (high - low).min(), *_RADIUS_RANGE))
    radius = min(radius, 0.5 * depth.max())
    centre = p_RJ + along * (depth.max() - radius) + axes[:2].T @ (0.5 * (low + high))
    return link, centre, radius, f"the end of the {kind}"


def surface_points(inspector: SceneGraphInspector, geometry: GeometryId) -> np.ndarray | None:
    """Returns points (N, 3) of a geometry in its frame, m: vertices of its hull, or corners of its box.

    Returns None for a mesh that Drake draws without reading it, and for unbounded shapes.
    """
    shape = inspector.GetShape(geometry)
    try:
        if isinstance(shape, Mesh | Convex):
            hull = shape.GetConvexHull()
            return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        box = CalcObb(shape)
    except RuntimeError:
        return None
    if box is None:
        return None
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1)
    return (box.pose() @ (box.half_width()[:, None] * signs)).T


def geometry_of(structure: HandStructure, links: Sequence[RigidBody]) -> tuple[list[Part], str]:
    """Returns the links' collision geometry in the root link R, or their visual geometry, and which it is."""
    for role, kind in ((Role.kProximity, "collision geometry"), (Role.kIllustration, "visual geometry")):
        frame = structure.plant.world_frame()
        if parts := parts_of(structure.plant, structure.scene_graph, links, role, frame):
            return parts, kind
    return [], ""


def parts_of(
    plant: MultibodyPlant, scene_graph: SceneGraph, links: Iterable[RigidBody], role: Role, frame: Frame
) -> list[Part]:
    """Returns the links' geometries that have a role, expressed in a frame, in the default posture."""
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    parts = []
    for link in links:
        X_FL = plant.CalcRelativeTransform(context, frame, link.body_frame())
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link.index()), role):
            p_GP = surface_points(inspector, geometry)
            if p_GP is not None:
                X_FG = X_FL @ inspector.GetPoseInFrame(geometry)
                parts.append(Part(link, X_FG, inspector.GetShape(geometry), (X_FG @ p_GP.T).T))
    return parts


# Joints bend a finger if their axes are parallel to that of its last joint up to this angle.
_PARALLEL = np.cos(np.deg2rad(35.0))
_STRETCH_GRID = 41
# A joint stays at its start where stretching lengthens the finger by less than this fraction.
_STRETCH_GAIN = 0.02
# A finger whose joints beyond the first are bent by more than this on average starts bent, rad.
_BENT = np.deg2rad(15.0)
# Fingers bend to one side if mid-range is off the stretched posture by this part of the range.
CLOSING_FRACTION = 0.25


@dataclass(frozen=True)
class FingerShape:
    """A stretched finger in the frame of the hand base.

    Attributes:
        p_base: (3,) origin of the finger's first joint, m.
        p_knuckle: (3,) origin of the first joint that bends the finger, m.
        p_tip: (3,) the fingertip, m.
        p_middle: (3,) the fingertip where all joints are in the middle of their ranges, m.
        bend: (3,) sum over the bending joints of axis times angle from stretched to mid-range, rad.
        play: the sum of half the ranges of the bending joints, rad.
    """

    p_base: np.ndarray
    p_knuckle: np.ndarray
    p_tip: np.ndarray
    p_middle: np.ndarray
    bend: np.ndarray
    play: float

    @property
    def direction(self) -> np.ndarray:
        """(3,) unit vector along the finger."""
        return unit(self.p_tip - self.p_knuckle)

    @property
    def length(self) -> float:
        """Distance of the fingertip from the first joint, m."""
        return float(np.linalg.norm(self.p_tip - self.p_base))

    @property
    def bending(self) -> np.ndarray:
        """(3,) direction in which the tip moves when the finger bends, longer the more it bends."""
        return np.cross(self.bend, self.direction)


def finger_shapes(hand: Hand, start: np.ndarray) -> list[FingerShape]:
    """Returns the shapes of a hand's stretched fingers.

    Beyond its first bending joint, the finger is as long as it can be. A spread joint before it thus has no
    influence, wherever it lies. The first bending joint itself stays at its start, where most models are
    straight; where the joints beyond it start bent, it is taken to start bent by as much.

    Args:
        hand: the hand.
        start: (n,) joint positions within the limits, rad.
    """
    kinematics, coupling = hand.kinematics().uncoupled()
    middle = 0.5 * (hand.lower + hand.upper)
    fingers = [replace(kinematics, fingers=(chain,)) for chain in kinematics.fingers]
    return [_shape(finger, coupling, start, middle) for finger in fingers]


def _shape(
    kinematics: HandKinematics, coupling: np.ndarray, start: np.ndarray, middle: np.ndarray
) -> FingerShape:
    """Returns the shape of the only finger of `kinematics`."""
    (chain,) = kinematics.fingers
    joints = list(chain.joint_indices)
    lower, upper = kinematics.lower[joints], kinematics.upper[joints]

    def pose(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the joints' axes and origins (N, m, 3) and tips (N, 3) at independent angles q (N, n)."""
        X_BJ = kinematics.joint_poses(q @ coupling.T)[:, joints]
        axes = (X_BJ[..., :3, :3] @ chain.axes[:, :, None])[..., 0]
        return axes, X_BJ[..., :3, 3], X_BJ[:, -1, :3, :3] @ chain.p_tip + X_BJ[:, -1, :3, 3]

    axes = pose(start[None])[0][0]
    bends = np.abs(axes @ axes[-1]) > _PARALLEL
    first = int(np.argmax(bends))
    beyond = [joint for joint, bent in zip(joints[first + 1 :], bends[first + 1 :], strict=True) if bent]
    movers = np.flatnonzero(coupling[beyond].any(axis=0)).tolist() if beyond else []
    q = start.copy()
    for _ in range(2):
        for joint in reversed(movers):
            trials = np.tile(q, (_STRETCH_GRID + 1, 1))
            # The first joints of `uncoupled` are those of q.
            grid = np.linspace(kinematics.lower[joint], kinematics.upper[joint], _STRETCH_GRID)
            trials[:, joint] = [start[joint], *grid]
            _, origins, tips = pose(trials)
            reach = np.linalg.norm(tips - origins[:, first], axis=1)
            longest = int(np.argmax(reach))
            q = trials[longest if reach[longest] > (1 + _STRETCH_GAIN) * reach[0] else 0]
    (mover, *others) = np.flatnonzero(coupling[joints[first]]).tolist()
    if movers and not others and mover not in movers:
        # How far the joints beyond the first were turned to stretch the finger, and from there to mid-range.
        turned, closing = (
            (angles[:, None] * axes)[bends][1:].sum(axis=0)
            for angles in ((coupling @ (q - start))[joints], 0.5 * (lower + upper) - (coupling @ q)[joints])
        )
        angle = float(turned @ axes[first]) / len(beyond) / coupling[joints[first], mover]
        # If they were turned to the side to which they close, the start was straight or bent backwards.
        if abs(angle) > _BENT and turned @ closing < 0.0:
            q[mover] = np.clip(start[mover] + angle, kinematics.lower[mover], kinematics.upper[mover])
    (axes,), (origins,), (tip,) = pose(q[None])
    angles = (coupling @ q)[joints]
    bend = ((0.5 * (lower + upper) - angles)[:, None] * axes)[bends].sum(axis=0)
    play = float(0.5 * (upper - lower)[bends].sum())
    return FingerShape(origins[0], origins[first], tip, pose(middle[None])[2][0], bend, play)


def unit(v: np.ndarray) -> np.ndarray:
    """Returns v / |v|, or zero for zero."""
    return v / max(float(np.linalg.norm(v)), 1e-12)
