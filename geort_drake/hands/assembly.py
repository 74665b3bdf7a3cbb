"""A described hand in a plant: adds it, with its base, couplings, gains and filters, and finds its parts."""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.geometry import (
    CollisionFilterDeclaration,
    Convex,
    GeometryId,
    GeometrySet,
    Mesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FixedOffsetFrame,
    Frame,
    Joint,
    ModelInstanceIndex,
    MultibodyConstraintId,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)
from pydrake.systems.framework import Context

from geort_drake.errors import HandError, listed, naming
from geort_drake.hands.description import (
    FingerDescription,
    HandDescription,
    JointCouplings,
    load_hand,
    resolved_couplings,
)
from geort_drake.hands.kinematics import FingerChain
from geort_drake.hands.model_files import check_values, find_package, read_model
from geort_drake.hands.model_search import find_model
from geort_drake.resources import PACKAGE_NAME, resource_root

# Kinds of joints with a single position.
_AXIAL = (RevoluteJoint, PrismaticJoint)


def joint_paths(plant: MultibodyPlant, model: ModelInstanceIndex) -> dict[BodyIndex, tuple[Joint, ...]]:
    """Returns the joints, including welds, from the base of a model to each of its links.

    Raises:
        HandError: two joints move one link, or joints form a loop.
    """
    inboard: dict[BodyIndex, Joint] = {}
    for joint in map(plant.get_joint, plant.GetJointIndices(model)):
        link = joint.child_body()
        other = inboard.get(link.index())
        # A weld to the robot that carries the hand, or to the world, may move a palm beside a wrist joint.
        if other is not None and joint.parent_body().model_instance() == model:
            raise HandError(f"the joints '{other.name()}' and '{joint.name()}' both move '{link.name()}'")
        inboard[link.index()] = joint
    paths: dict[BodyIndex, tuple[Joint, ...]] = {}
    for body in plant.GetBodyIndices(model):
        path: list[Joint] = []
        inner = body
        while (mover := inboard.get(inner)) is not None:
            if mover in path:
                loop = listed([f"'{joint.name()}'" for joint in reversed(path)])
                raise HandError(f"the joints {loop} form a loop; a hand must be a tree")
            path.insert(0, mover)
            inner = mover.parent_body().index()
        paths[body] = tuple(path)
    return paths


class HandInPlant:
    """A hand that is part of a plant: its joints, links, limits and fingers.

    Args:
        plant: plant with the hand.
        description: the hand.
        instance: model instance of the hand, from `add_hand_model`.
    """

    def __init__(self, plant: MultibodyPlant, description: HandDescription, instance: ModelInstanceIndex):
        self.plant, self.description, self.instance = plant, description, instance

    @property
    def joints(self) -> list[Joint]:
        """All joints of the model."""
        return [self.plant.get_joint(index) for index in self.plant.GetJointIndices(self.instance)]

    @property
    def links(self) -> list[RigidBody]:
        """All links of the model."""
        return [self.plant.get_body(index) for index in self.plant.GetBodyIndices(self.instance)]

    def joint(self, name: str, field: str, *kinds: type[Joint]) -> Joint:
        """Returns the joint of these kinds that a field of the description names.

        Raises:
            HandError: the hand has no such joint; the message lists those that it has.
        """
        words = " or ".join(kind.__name__.removesuffix("Joint").lower() for kind in kinds)
        require_name(field, f"{words} joint", name, [j.name() for j in self.joints if isinstance(j, kinds)])
        return self.plant.GetJointByName(name, self.instance)

    def link(self, name: str, field: str) -> RigidBody:
        """Returns the link that a field of the description names; raises HandError as `joint` does."""
        require_name(field, "link", name, [link.name() for link in self.links])
        return self.plant.GetBodyByName(name, self.instance)

    def frame(self, name: str, field: str) -> Frame:
        """Returns the frame or link that a field of the description names; raises as `joint` does."""
        frames = [self.plant.get_frame(index).name() for index in self.plant.GetFrameIndices(self.instance)]
        require_name(field, "frame or link", name, frames)
        return self.plant.GetFrameByName(name, self.instance)

    def finger_links(self) -> list[list[RigidBody]]:
        """Returns the links of each finger: those that its joints or their followers move."""
        fingers = self.description.fingers
        finger_of = {joint: number for number, finger in enumerate(fingers) for joint in finger.joints}
        finger_of |= {c.joint: finger_of[c.follows] for c in self.description.followers}
        links: list[list[RigidBody]] = [[] for _ in fingers]
        for index, path in joint_paths(self.plant, self.instance).items():
            movers = [finger_of[joint.name()] for joint in path if joint.name() in finger_of]
            if movers:
                links[movers[-1]].append(self.plant.get_body(index))
        return links

    def palm_links(self) -> list[RigidBody]:
        """Returns the links that no finger moves."""
        moving = {body.index() for links in self.finger_links() for body in links}
        return [link for link in self.links if link.index() not in moving]

    def collision_geometries(self) -> list[GeometryId]:
        """Returns the collision geometries of all links."""
        return [id for link in self.links for id in self.plant.GetCollisionGeometriesForBody(link)]

    def tip_geometries(
        self, inspector: SceneGraphInspector, fingers: Iterable[FingerDescription] | None = None
    ) -> list[GeometryId]:
        """Returns the collision geometries that count as tips of all fingers, or of some.

        They are those of the tip link with "tip" in their names; of a link without any, all.
        """
        tips: list[GeometryId] = []
        for finger in self.description.fingers if fingers is None else fingers:
            link = self.plant.GetFrameByName(finger.tip_link, self.instance).body()
            frame = self.plant.GetBodyFrameIdOrThrow(link.index())
            # The plant's own list would keep the plant alive.
            everything = inspector.GetGeometries(frame, Role.kProximity)
            tips += [id for id in everything if "tip" in inspector.GetName(id).split("::")[-1]] or everything
        return tips

    def position_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns lower and upper limits (n,) of q, rad, within which followers keep their own limits.

        Raises:
            HandError: a follower would exceed its limits at every angle of its leader.
        """
        names = self.description.joint_names
        joints = [self.plant.GetJointByName(name, self.instance) for name in names]
        lower = np.array([joint.position_lower_limits()[0] for joint in joints])
        upper = np.array([joint.position_upper_limits()[0] for joint in joints])
        for c in self.description.followers:
            leader, follower = names.index(c.follows), self.plant.GetJointByName(c.joint, self.instance)
            ends = np.array([follower.position_lower_limits()[0], follower.position_upper_limits()[0]])
            low, high = np.sort((ends - c.offset) / c.ratio)
            lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
            if not lower[leader] < upper[leader]:
                raise HandError(
                    f"joint '{c.joint}', which follows '{c.follows}', would exceed its limits "
                    f"[{ends[0]:g}, {ends[1]:g}] rad at every angle of that joint; correct its coupling or "
                    "its limits"
                )
        return lower, upper

    def forward_kinematics(self, joint_names: Sequence[str]) -> Callable[[np.ndarray], np.ndarray]:
        """Returns a function of joint positions q (N, n), rad: fingertip points p_BF (N, F, 3), m.

        It is not thread-safe, because it owns the context in which it computes.

        Args:
            joint_names: the n joints of the description in the order of q.
        """
        plant, couplings = self.plant, JointCouplings(self.description)
        columns = [list(joint_names).index(name) for name in self.description.joint_names]
        moving = [*self.description.joint_names, *couplings.names]
        order = [plant.GetJointByName(name, self.instance).position_start() for name in moving]
        context = plant.CreateDefaultContext()
        positions = plant.GetPositions(context).copy()
        base = plant.GetFrameByName(self.description.base_frame, self.instance)
        points = [
            (plant.GetFrameByName(finger.tip_link, self.instance), np.array(finger.tip_point, float))
            for finger in self.description.fingers
        ]

        def fingertips(q: np.ndarray) -> np.ndarray:
            p_BF = np.empty((len(q), len(points), 3))
            for row, tips in zip(couplings.with_followers(q[:, columns]), p_BF, strict=True):
                positions[order] = row
                plant.SetPositions(context, positions)
                for tip, (frame, point) in zip(tips, points, strict=True):
                    tip[:] = plant.CalcPointsPositions(context, frame, point, base)[:, 0]
            return p_BF

        return fingertips

    def finger_chain(self, finger: FingerDescription) -> FingerChain:
        """Returns the serial chain of a finger, from the hand base to its tip, in a finalized plant.

        Raises:
            HandError: the joints between base and tip are not exactly the finger's and their followers.
        """
        plant, where = self.plant, f"finger '{finger.name}'"
        couplings = {coupling.joint: coupling for coupling in self.description.followers}
        base = plant.GetFrameByName(self.description.base_frame, self.instance)
        tip = plant.GetBodyByName(finger.tip_link, self.instance)
        path = joint_paths(plant, self.instance)[tip.index()]
        moving = [joint for joint in path if joint.num_positions()]
        names = [joint.name() for joint in moving]
        independent = [name for name in names if name not in couplings]
        if independent != finger.joints:
            raise HandError(
                f"{where}: its joints must be listed base to tip; given: {', '.join(finger.joints)}; "
                f"between '{base.name()}' and '{finger.tip_link}' are: {', '.join(independent) or 'none'}"
            )
        context = plant.CreateDefaultContext()
        X_PJ = np.empty((len(moving), 4, 4))
        previous = base  # the base, then the preceding joint's frame
        for number, joint in enumerate(moving):
            X_PJ[number] = _fixed_pose(plant, context, previous, joint.frame_on_parent()).GetAsMatrix4()
            previous = joint.frame_on_child()
        p_tip = _fixed_pose(plant, context, previous, tip.body_frame()) @ np.array(finger.tip_point)
        axes = np.stack([joint.revolute_axis() for joint in moving])
        coupling = np.zeros((len(names), len(independent)))
        for row, name in enumerate(names):
            if name in independent:
                coupling[row, independent.index(name)] = 1.0
                continue
            follower = couplings[name]
            if follower.follows not in independent:
                raise HandError(
                    f"{where}: its joint '{name}' follows '{follower.follows}' of another finger; a joint "
                    "that moves several fingers can only be fixed: remove it from the fingers' joints"
                )
            coupling[row, independent.index(follower.follows)] = follower.ratio
            turned = RotationMatrix(AngleAxis(follower.offset, axes[row]))
            X_PJ[row, :3, :3] = X_PJ[row, :3, :3] @ turned.matrix()
        return FingerChain(
            name=finger.name,
            joint_names=tuple(independent),
            joint_indices=tuple(self.description.joint_names.index(name) for name in independent),
            X_PJ=X_PJ,
            axes=axes,
            p_tip=p_tip,
            all_joint_names=tuple(names),
            coupling=coupling,
        )


def add_hand_model(
    plant: MultibodyPlant, description: HandDescription | str | os.PathLike, name: str | None = None
) -> ModelInstanceIndex:
    """Adds a hand to a plant without attaching it to anything.

    Joints start at the description's default positions. Those that no finger lists and that follow no other
    are welded there. Followers have no motor; in a discrete plant, coupler constraints drive them. The hand
    base is a frame of the model instance, named as in the description.

    Args:
        plant: the plant, not finalized and registered with a scene graph.
        description: the hand's description, or its name or file.
        name: name of the model instance; by default the model's.

    Raises:
        HandError: description or model are missing or malformed, the model lacks an element that the
            description names, or the plant is finalized.
        UnknownNameError: no hand has that name.
    """
    description = load_hand(description)
    if plant.is_finalized():
        raise HandError(f"hand '{description.name}' cannot be added to a plant that is finalized")
    path = find_model(description)
    constraints, surroundings = set(plant.GetConstraintIds()), set(_world_geometries(plant))
    hand = parse_model(plant, path)
    if name is not None:
        plant.RenameModelInstance(hand, name)
    hand_in_plant = HandInPlant(plant, description, hand)
    with naming(f"hand '{description.name}' with model {path}", HandError):
        _assemble(hand_in_plant, set(plant.GetConstraintIds()) - constraints)
    # The hand must not collide with a floor in its own model file.
    if floor := set(_world_geometries(plant)) - surroundings:
        sets = GeometrySet(list(floor)), GeometrySet(hand_in_plant.collision_geometries())
        filters = CollisionFilterDeclaration().ExcludeBetween(*sets)
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)
    return hand


def _assemble(hand: HandInPlant, constraints: Iterable[MultibodyConstraintId]) -> None:
    """Changes a model to what its description says; `constraints` are the model's own."""
    plant, description = hand.plant, hand.description
    # Drake cannot remove joints while there are constraints. Couplings are added again below.
    for constraint in constraints:
        plant.RemoveConstraint(constraint)
    detach_from_world(plant, hand.instance)
    for joint in hand.joints:
        # Exporters write 0 for a speed that they do not know.
        if joint.num_velocities() == 1 and not joint.velocity_upper_limits()[0] > 0:
            joint.set_velocity_limits([-np.inf], [np.inf])
    _add_base(hand)
    _add_drawn_collisions(hand)
    for name, position in description.default_positions.items():
        hand.joint(name, "default_positions", *_AXIAL).set_default_positions([position])
    for coupling in resolved_couplings(description.couplings):
        field = f"couplings.{coupling.joint}"
        position = hand.joint(coupling.follows, field, *_AXIAL).default_positions()[0]
        follower = hand.joint(coupling.joint, field, *_AXIAL)
        follower.set_default_positions([coupling.ratio * position + coupling.offset])
    couplings = description.followers
    moving = {*description.joint_names, *(coupling.joint for coupling in couplings)}
    for joint in hand.joints:
        if joint.num_positions() and joint.name() not in moving:
            _weld_at_default(plant, joint)
    _actuate(hand)
    if plant.time_step() > 0:
        for coupling in couplings:
            joints = [
                plant.GetJointByName(name, hand.instance) for name in (coupling.joint, coupling.follows)
            ]
            plant.AddCouplerConstraint(*joints, coupling.ratio, coupling.offset)
    filters = CollisionFilterDeclaration()
    for pair in description.ignored_collisions:
        links = [hand.link(name, "ignored_collisions") for name in pair]
        filters.ExcludeBetween(*(GeometrySet(plant.GetCollisionGeometriesForBody(link)) for link in links))
    if description.ignored_collisions:
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)


def parse_model(plant: MultibodyPlant, path: Path) -> ModelInstanceIndex:
    """Adds the only model of a file; searches its packages in the folders above it.

    Raises:
        HandError: the file is not a single model that Drake can read, or contains bad values.
    """
    tree = read_model(path)
    parser = Parser(plant)
    if tree.tag == "mujoco":
        from geort_drake.hands.mjcf import add_mjcf

        return add_mjcf(plant, parser.scene_graph(), path)
    with naming(f"model {path}", HandError):
        check_values(tree)
    parser.SetAutoRenaming(True)  # several hands of one model
    packages = parser.package_map()
    packages.Add(PACKAGE_NAME, str(resource_root()))
    words = [word for element in tree.iter() for word in (element.text, *element.attrib.values()) if word]
    for name in {match[1] for word in words if (match := re.search("package://([^/]+)/", word))}:
        if not packages.Contains(name):
            packages.Add(name, str(find_package(path, name)))
    try:
        (hand,) = add_models(parser, path)
    except (RuntimeError, ValueError, SystemExit) as error:  # failed assertions in Drake exit
        raise HandError(f"model {path}: not a single readable model: {error}") from error
    return hand


def add_models(parser: Parser, path: str | os.PathLike) -> list[ModelInstanceIndex]:
    """Adds the models of a file, like `Parser.AddModels`.

    For each SDF file, libsdformat reads its whole specification again, which takes 20 ms; for a text it does
    not. A file that refers to others is added as a file, because it may name them relative to its folder.
    """
    path = Path(path)
    if path.suffix == ".sdf" and "<uri" not in (text := path.read_text(encoding="utf-8")):
        return parser.AddModelsFromString(text, "sdf")
    return parser.AddModels(path)


def detach_from_world(plant: MultibodyPlant, hand: ModelInstanceIndex) -> None:
    """Removes the joints between a model and the world, including welds and floating joints."""
    for joint in map(plant.get_joint, plant.GetJointIndices(hand)):
        if joint.parent_body().index() == plant.world_body().index():
            _remove_actuators(plant, joint)
            _remove_joint(plant, joint)


def remove_visuals(plant: MultibodyPlant, scene_graph: SceneGraph, root: Context) -> None:
    """Removes visual geometry from a diagram's context, which saves updates of its poses.

    The model keeps the geometry.
    """
    context = scene_graph.GetMyMutableContextFromRoot(root)
    inspector = scene_graph.get_query_output_port().Eval(context).inspector()
    colliding = set(inspector.GetAllGeometryIds(Role.kProximity))
    for geometry in inspector.GetAllGeometryIds():
        if geometry not in colliding:
            scene_graph.RemoveGeometry(context, plant.get_source_id(), geometry)


def require_name(field: str, kind: str, name: str, choices: Iterable[str]) -> None:
    """Raises HandError, with the choices, unless a name given in a field is among them."""
    names = [choice for choice in choices if choice]
    if name not in names:
        raise HandError(
            f"{field} names the {kind} '{name}', which the model lacks; "
            f"choose one of: {', '.join(names) or 'none'}"
        )


def _world_geometries(plant: MultibodyPlant) -> list[GeometryId]:
    return list(plant.GetCollisionGeometriesForBody(plant.world_body()))


def _add_base(hand: HandInPlant) -> None:
    base, name = hand.description.base_pose, hand.description.base_frame
    if not base.relative_to:
        return
    frame = hand.frame(base.relative_to, "base_pose.relative_to")
    if hand.plant.HasFrameNamed(name, hand.instance):
        raise HandError(
            f"base_frame '{name}' is a frame of the model, so base_pose must be left out; or give base_frame "
            "a new name"
        )
    X = RigidTransform(RollPitchYaw(np.deg2rad(base.rpy_deg)), base.translation)
    hand.plant.AddFrame(FixedOffsetFrame(name, frame, X, hand.instance))


def _add_drawn_collisions(hand: HandInPlant) -> None:
    """Gives the links of `collide_as_drawn` their visual geometry as collision geometry."""
    for name in hand.description.collide_as_drawn:
        link = hand.link(name, "collide_as_drawn")
        inspector = Parser(hand.plant).scene_graph().model_inspector()
        frame = hand.plant.GetBodyFrameIdOrThrow(link.index())
        for number, id in enumerate(inspector.GetGeometries(frame, Role.kIllustration)):
            shape, X_LG = inspector.GetShape(id), inspector.GetPoseInFrame(id)
            if isinstance(shape, Mesh):
                shape = Convex(shape.source(), shape.scale3())
            geometry = f"{name}_drawn_{number}"
            hand.plant.RegisterCollisionGeometry(link, X_LG, shape, geometry, CoulombFriction(1.0, 1.0))


def _weld_at_default(plant: MultibodyPlant, joint: Joint) -> None:
    """Replaces a joint by a weld at its default position."""
    _remove_actuators(plant, joint)
    X_FM = RigidTransform()
    position = joint.default_positions()
    if isinstance(joint, RevoluteJoint):
        X_FM = RigidTransform(AngleAxis(position[0], joint.revolute_axis()), np.zeros(3))
    elif isinstance(joint, PrismaticJoint):
        X_FM = RigidTransform(position[0] * joint.translation_axis())
    name, parent, child = joint.name(), joint.frame_on_parent(), joint.frame_on_child()
    _remove_joint(plant, joint)
    plant.AddJoint(WeldJoint(name, parent, child, X_FM))


def _remove_joint(plant: MultibodyPlant, joint: Joint) -> None:
    name = joint.name()
    try:
        plant.RemoveJoint(joint)
    except RuntimeError as error:
        raise HandError(
            f"joint '{name}' cannot be fixed, because Drake removes no joints from a plant with springs; "
            f"remove joint stiffness from the models: {error}"
        ) from error


def _actuate(hand: HandInPlant) -> None:
    """Gives the joints that fingers list motors with the description's gains; removes those of followers.

    Without gains, the model's own are kept.
    """
    plant, gains = hand.plant, hand.description.actuation
    for coupling in hand.description.followers:
        _remove_actuators(plant, plant.GetJointByName(coupling.joint, hand.instance))
    if gains.stiffness == 0:
        return
    existing = {actuator.joint().index(): actuator for actuator in _actuators(plant)}
    for name in hand.description.joint_names:
        if not plant.HasJointNamed(name, hand.instance):
            continue
        joint = plant.GetJointByName(name, hand.instance)
        actuator = existing.get(joint.index())
        if actuator is None or gains.effort_limit > 0:
            # The effort limit of an existing actuator cannot change.
            _remove_actuators(plant, joint)
            actuator = plant.AddJointActuator(f"{name}_motor", joint, gains.effort_limit or np.inf)
        actuator.set_controller_gains(PdControllerGains(p=gains.stiffness, d=gains.damping))


def _actuators(plant: MultibodyPlant) -> list:
    return [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]


def _remove_actuators(plant: MultibodyPlant, joint: Joint) -> None:
    index = joint.index()
    for actuator in _actuators(plant):
        if actuator.joint().index() == index:
            plant.RemoveJointActuator(actuator)


def _fixed_pose(plant: MultibodyPlant, context: Context, frame: Frame, other: Frame) -> RigidTransform:
    """Returns the pose of frame `other` in `frame`, rigidly connected by a link or welds."""
    if frame.body().index() == other.body().index():
        return frame.GetFixedPoseInBodyFrame().inverse() @ other.GetFixedPoseInBodyFrame()
    return plant.CalcRelativeTransform(context, frame, other)
