"""The fingers of a hand in a Drake plant as serial chains."""

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, RigidBody, WeldJoint

from geort_drake.errors import HandError
from geort_drake.hands.couplings import JointCouplings
from geort_drake.hands.description import FingerDescription, HandDescription
from geort_drake.hands.links import inboard_joints
from geort_drake.retargeting.training.kinematics import FingerChain


def finger_chain(
    plant: MultibodyPlant,
    base: Frame,
    finger: FingerDescription,
    couplings: JointCouplings,
    description: HandDescription,
    source: str,
) -> FingerChain:
    """Walks from a finger's tip link to the hand base: joints must be the finger's or follow them.

    Args:
        plant: finalized, with the hand.
        base: the hand base B.
        source: what errors begin with.

    Raises:
        HandError: the finger's list is not what lies between base and tip.
    """
    where = f"{source}: finger '{finger.name}'"
    moving: list[Joint] = []
    poses: list[RigidTransform] = []
    tip = plant.GetBodyByName(finger.tip_link, base.model_instance())
    X = RigidTransform()  # the part below, in the current body
    p_tip = np.array(finger.tip_point)
    body = tip
    for joint in _inboard(plant, tip, base, where):
        X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        if isinstance(joint, WeldJoint):
            X = X_PF @ joint.X_FM() @ X_MC @ X
        else:
            # What lies below the joint is the next joint's frame or, at the end, the tip.
            if moving:
                poses.append(X_MC @ X)
            else:
                p_tip = X_MC @ X @ p_tip
            moving.append(joint)
            X = X_PF
        body = joint.parent_body()
    X_BaseB = base.GetFixedPoseInBodyFrame()
    if body.index() != base.body().index():
        # The palm may be of several links that are welded together.
        context = plant.CreateDefaultContext()
        X = plant.CalcRelativeTransform(context, base.body().body_frame(), body.body_frame()) @ X
    poses.append(X_BaseB.inverse() @ X)
    names = [joint.name() for joint in moving[::-1]]
    own = [name for name in names if name not in couplings.names]
    if own != finger.joints:
        raise HandError(
            f"{where}: its joints must be listed base to tip; given: {', '.join(finger.joints)}; "
            f"between '{base.name()}' and '{finger.tip_link}' are: {', '.join(own) or 'none'}"
        )
    X_PJ = np.stack([pose.GetAsMatrix4() for pose in poses[::-1]])
    axes = np.stack([joint.revolute_axis() for joint in moving[::-1]])
    coupling = np.zeros((len(names), len(own)))
    for row, name in enumerate(names):
        if name in own:
            coupling[row, own.index(name)] = 1.0
            continue
        number = couplings.names.index(name)
        leader = description.joint_names[couplings.leaders[number]]
        if leader not in own:
            raise HandError(
                f"{where}: joint '{name}', which moves it, follows '{leader}' of another finger; what moves "
                f"several fingers can only be held: take '{leader}' out of the fingers' joints"
            )
        coupling[row, own.index(leader)] = couplings.ratio[number, couplings.leaders[number]]
        turned = RotationMatrix(AngleAxis(couplings.offset[number], axes[row]))
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


def _inboard(plant: MultibodyPlant, tip: RigidBody, base: Frame, where: str) -> list[Joint]:
    """The joints between a link and what is welded to the base, from the link on."""
    inboard = inboard_joints(plant)
    still = {body.index() for body in plant.GetBodiesWeldedTo(base.body())}
    path: list[Joint] = []
    body = tip
    while body.index() not in still:
        joint = inboard.get(body.index())
        if joint is None:
            raise HandError(f"{where}: link '{tip.name()}' does not hang on '{base.name()}'")
        path.append(joint)
        body = joint.parent_body()
    return path
