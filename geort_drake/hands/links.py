"""Links, joint limits, chains and fingertips of a hand in any Drake plant."""

from collections.abc import Iterable, Sequence

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.geometry import GeometryId, Role, SceneGraphInspector
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, Joint, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Context

from geort_drake.errors import HandError
from geort_drake.hands.description import FingerDescription, HandDescription, JointCouplings
from geort_drake.hands.kinematics import FingerChain


def joint_paths(plant: MultibodyPlant, model: ModelInstanceIndex) -> dict[BodyIndex, tuple[Joint, ...]]:
    """Returns the joints, including welds, from the base of a model to each of its links."""
    joints = map(plant.get_joint, plant.GetJointIndices(model))
    inboard = {joint.child_body().index(): joint for joint in joints}
    paths: dict[BodyIndex, tuple[Joint, ...]] = {}

    def path(body: BodyIndex) -> tuple[Joint, ...]:
        if body not in paths:
            joint = inboard.get(body)
            paths[body] = () if joint is None else (*path(joint.parent_body().index()), joint)
        return paths[body]

    return {body: path(body) for body in plant.GetBodyIndices(model)}


def finger_links(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> list[list[RigidBody]]:
    """Returns the links of each finger: those that its joints or their followers move.

    Args:
        plant: plant with the hand.
        description: the hand.
        hand: model instance of the hand, from `add_hand_model`.
    """
    finger_of = {
        joint: number for number, finger in enumerate(description.fingers) for joint in finger.joints
    }
    finger_of |= {c.joint: finger_of[c.follows] for c in description.followers}
    links: list[list[RigidBody]] = [[] for _ in description.fingers]
    for index, path in joint_paths(plant, hand).items():
        fingers = [finger_of[joint.name()] for joint in path if joint.name() in finger_of]
        if fingers:
            links[fingers[-1]].append(plant.get_body(index))
    return links


def palm_links(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> list[RigidBody]:
    """Returns the links that no finger moves; arguments as for `finger_links`."""
    moved = {body.index() for links in finger_links(plant, description, hand) for body in links}
    return [plant.get_body(index) for index in plant.GetBodyIndices(hand) if index not in moved]


def tip_geometries(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    hand: ModelInstanceIndex,
    fingers: Iterable[FingerDescription],
) -> list[GeometryId]:
    """Returns the collision geometries of tip links with "tip" in their names; all of a link without any."""
    tips: list[GeometryId] = []
    for finger in fingers:
        link = plant.GetFrameByName(finger.tip_link, hand).body()
        frame = plant.GetBodyFrameIdOrThrow(link.index())
        everything = inspector.GetGeometries(frame, Role.kProximity)  # the plant's list would keep it alive
        tips += [id for id in everything if "tip" in inspector.GetName(id).split("::")[-1]] or everything
    return tips


def position_limits(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex
) -> tuple[np.ndarray, np.ndarray]:
    """Returns lower and upper limits (n,) of q, rad, within which followers keep their own limits.

    Args:
        plant: plant with the hand.
        description: the hand.
        hand: model instance of the hand, from `add_hand_model`.

    Raises:
        HandError: a follower would exceed its limits at every angle of its leader.
    """
    joints = [plant.GetJointByName(name, hand) for name in description.joint_names]
    lower = np.array([joint.position_lower_limits()[0] for joint in joints])
    upper = np.array([joint.position_upper_limits()[0] for joint in joints])
    for c in description.followers:
        leader, follower = description.joint_names.index(c.follows), plant.GetJointByName(c.joint, hand)
        ends = np.array([follower.position_lower_limits()[0], follower.position_upper_limits()[0]])
        low, high = np.sort((ends - c.offset) / c.ratio)
        lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
        if not lower[leader] < upper[leader]:
            raise HandError(
                f"joint '{c.joint}', which follows '{c.follows}', would exceed its limits "
                f"[{ends[0]:g}, {ends[1]:g}] rad at every angle of that joint; correct its coupling or its "
                "limits"
            )
    return lower, upper


class PlantFingertips:
    """Forward kinematics of a hand that is part of a plant.

    Not thread-safe: the object owns the context in which it computes.

    Args:
        plant: finalized plant with the hand.
        description: the hand.
        hand: model instance of the hand.
        joint_names: the n joints of the description in the order of q.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        description: HandDescription,
        hand: ModelInstanceIndex,
        joint_names: Sequence[str],
    ):
        names = list(joint_names)
        self._columns = [names.index(name) for name in description.joint_names]
        self._couplings = JointCouplings(description)
        moving = [*description.joint_names, *self._couplings.names]
        self._order = [plant.GetJointByName(name, hand).position_start() for name in moving]
        self._plant, self._context = plant, plant.CreateDefaultContext()
        self._positions = plant.GetPositions(self._context).copy()
        self._base = plant.GetFrameByName(description.base_frame, hand)
        self._tips = [
            (plant.GetFrameByName(finger.tip_link, hand), np.array(finger.tip_point, float))
            for finger in description.fingers
        ]

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Computes fingertip points p_BF (N, F, 3), m, at joint positions q (N, n), rad."""
        rows = self._couplings.with_followers(q[:, self._columns])
        p_BF = np.empty((len(rows), len(self._tips), 3))
        for row, tips in zip(rows, p_BF, strict=True):
            self._positions[self._order] = row
            self._plant.SetPositions(self._context, self._positions)
            for tip, (frame, point) in zip(tips, self._tips, strict=True):
                tip[:] = self._plant.CalcPointsPositions(self._context, frame, point, self._base)[:, 0]
        return p_BF


def finger_chain(
    plant: MultibodyPlant, base: Frame, finger: FingerDescription, description: HandDescription
) -> FingerChain:
    """Makes the serial chain of a finger, from the hand base to its tip.

    Args:
        plant: finalized plant with the hand.
        base: the hand base B.
        finger: the finger in the description.
        description: the hand.

    Raises:
        HandError: the joints between base and tip are not exactly the finger's and their followers.
    """
    where = f"finger '{finger.name}'"
    couplings = {coupling.joint: coupling for coupling in description.followers}
    tip = plant.GetBodyByName(finger.tip_link, base.model_instance())
    moving = [
        joint for joint in joint_paths(plant, base.model_instance())[tip.index()] if joint.num_positions()
    ]
    names = [joint.name() for joint in moving]
    own = [name for name in names if name not in couplings]
    if own != finger.joints:
        raise HandError(
            f"{where}: its joints must be listed base to tip; given: {', '.join(finger.joints)}; "
            f"between '{base.name()}' and '{finger.tip_link}' are: {', '.join(own) or 'none'}"
        )
    context = plant.CreateDefaultContext()
    X_PJ = np.empty((len(moving), 4, 4))
    previous = base  # the base, then the preceding joint's frame
    for number, joint in enumerate(moving):
        X_PJ[number] = _fixed_pose(plant, context, previous, joint.frame_on_parent()).GetAsMatrix4()
        previous = joint.frame_on_child()
    p_tip = _fixed_pose(plant, context, previous, tip.body_frame()) @ np.array(finger.tip_point)
    axes = np.stack([joint.revolute_axis() for joint in moving])
    coupling = np.zeros((len(names), len(own)))
    for row, name in enumerate(names):
        if name in own:
            coupling[row, own.index(name)] = 1.0
            continue
        follower = couplings[name]
        if follower.follows not in own:
            raise HandError(
                f"{where}: its joint '{name}' follows '{follower.follows}' of another finger; a joint that "
                "moves several fingers can only be fixed: remove it from the fingers' joints"
            )
        coupling[row, own.index(follower.follows)] = follower.ratio
        turned = RotationMatrix(AngleAxis(follower.offset, axes[row]))
        X_PJ[row, :3, :3] = X_PJ[row, :3, :3] @ turned.matrix()
    return FingerChain(
        name=finger.name,
        joint_names=tuple(own),
        joint_indices=tuple(description.joint_names.index(name) for name in own),
        X_PJ=X_PJ,
        axes=axes,
        p_tip=p_tip,
        all_joint_names=tuple(names),
        coupling=coupling,
    )


def _fixed_pose(plant: MultibodyPlant, context: Context, frame: Frame, other: Frame) -> RigidTransform:
    """Returns the pose of frame `other` in `frame`, rigidly connected by a link or welds."""
    if frame.body().index() == other.body().index():
        return frame.GetFixedPoseInBodyFrame().inverse() @ other.GetFixedPoseInBodyFrame()
    return plant.CalcRelativeTransform(context, frame, other)
