"""Adds a described hand to a plant: hand base, couplings, held joints, gains and collision filters."""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
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
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    ModelInstanceIndex,
    MultibodyConstraintId,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    WeldJoint,
)
from pydrake.systems.framework import Context

from geort_drake.errors import HandError, naming
from geort_drake.hands.description import HandDescription, load_hand, resolved_couplings
from geort_drake.hands.mjcf import add_mjcf
from geort_drake.hands.model_files import check_values, find_package, read_model
from geort_drake.hands.model_search import find_model
from geort_drake.resources import PACKAGE_NAME, resource_root


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
    with naming(f"hand '{description.name}' with model {path}", HandError):
        _apply_description(plant, hand, description, set(plant.GetConstraintIds()) - constraints)
    # The hand must not collide with a floor in its own model file.
    if added := set(_world_geometries(plant)) - surroundings:
        bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
        own = [id for body in bodies for id in plant.GetCollisionGeometriesForBody(body)]
        filters = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(list(added)), GeometrySet(own))
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)
    return hand


def _apply_description(
    plant: MultibodyPlant,
    hand: ModelInstanceIndex,
    description: HandDescription,
    constraints: Iterable[MultibodyConstraintId],
) -> None:
    """Changes a model to what its description says; `constraints` are the model's own."""
    # Drake cannot remove joints while there are constraints. Couplings are added again below.
    for constraint in constraints:
        plant.RemoveConstraint(constraint)
    detach_from_world(plant, hand)
    for joint in _joints(plant, hand):
        # Exporters write 0 for a speed that they do not know.
        if joint.num_velocities() == 1 and not joint.velocity_upper_limits()[0] > 0:
            joint.set_velocity_limits([-np.inf], [np.inf])
    _add_base(plant, hand, description)
    _add_drawn_collisions(plant, hand, description)
    _set_default_positions(plant, hand, description)
    couplings = description.followers
    moving = {*description.joint_names, *(coupling.joint for coupling in couplings)}
    for joint in _joints(plant, hand):
        if joint.num_positions() and joint.name() not in moving:
            _weld_at_default(plant, joint)
    _actuate(plant, hand, description)
    if plant.time_step() > 0:
        for coupling in couplings:
            joints = [plant.GetJointByName(name, hand) for name in (coupling.joint, coupling.follows)]
            plant.AddCouplerConstraint(*joints, coupling.ratio, coupling.offset)
    _filter_collisions(plant, hand, description)


def parse_model(plant: MultibodyPlant, path: Path) -> ModelInstanceIndex:
    """Adds the only model of a file; searches its packages in the folders above it.

    Raises:
        HandError: the file is not a single model that Drake can read, or contains bad values.
    """
    tree = read_model(path)
    parser = Parser(plant)
    if tree.tag == "mujoco":
        return add_mjcf(plant, parser.scene_graph(), path)
    with naming(f"model {path}", HandError):
        check_values(tree)
    parser.SetAutoRenaming(True)  # several hands of one model
    packages = parser.package_map()
    packages.Add(PACKAGE_NAME, str(resource_root()))
    for name in set(re.findall(r"package://([^/\"'<]+)/", ET.tostring(tree, encoding="unicode"))):
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
    for joint in _joints(plant, hand):
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
    listed = [choice for choice in choices if choice]
    if name not in listed:
        raise HandError(
            f"{field} names the {kind} '{name}', which the model lacks; "
            f"choose one of: {', '.join(listed) or 'none'}"
        )


def find_frame(plant: MultibodyPlant, hand: ModelInstanceIndex, name: str, field: str) -> Frame:
    """Returns the frame or link of a hand that a field of its description names.

    Raises:
        HandError: the hand has no frame or link of this name.
    """
    frames = [plant.get_frame(index).name() for index in plant.GetFrameIndices(hand)]
    require_name(field, "frame or link", name, frames)
    return plant.GetFrameByName(name, hand)


def _world_geometries(plant: MultibodyPlant) -> list[GeometryId]:
    return list(plant.GetCollisionGeometriesForBody(plant.world_body()))


def _joints(plant: MultibodyPlant, hand: ModelInstanceIndex) -> list[Joint]:
    return [plant.get_joint(index) for index in plant.GetJointIndices(hand)]


def _add_base(plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription) -> None:
    base = description.base_pose
    if not base.relative_to:
        return
    frame = find_frame(plant, hand, base.relative_to, "base_pose.relative_to")
    if plant.HasFrameNamed(description.base_frame, hand):
        raise HandError(
            f"base_frame '{description.base_frame}' is a frame of the model, so base_pose must be "
            "left out; or give base_frame a new name"
        )
    X = RigidTransform(RollPitchYaw(np.deg2rad(base.rpy_deg)), base.translation)
    plant.AddFrame(FixedOffsetFrame(description.base_frame, frame, X, hand))


def _add_drawn_collisions(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription
) -> None:
    """Gives the links of `collide_as_drawn` their visual geometry as collision geometry."""
    names = [plant.get_body(index).name() for index in plant.GetBodyIndices(hand)]
    for name in description.collide_as_drawn:
        require_name("collide_as_drawn", "link", name, names)
        link, inspector = plant.GetBodyByName(name, hand), Parser(plant).scene_graph().model_inspector()
        frame = plant.GetBodyFrameIdOrThrow(link.index())
        for number, id in enumerate(inspector.GetGeometries(frame, Role.kIllustration)):
            shape, X_LG = inspector.GetShape(id), inspector.GetPoseInFrame(id)
            if isinstance(shape, Mesh):
                shape = Convex(shape.source(), shape.scale3())
            geometry = f"{name}_drawn_{number}"
            plant.RegisterCollisionGeometry(link, X_LG, shape, geometry, CoulombFriction(1.0, 1.0))


def _set_default_positions(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription
) -> None:
    """Sets the description's default positions, and matching ones of followers."""
    for name, position in description.default_positions.items():
        _axial_joint(plant, hand, name, "default_positions").set_default_positions([position])
    for coupling in resolved_couplings(description.couplings):
        field = f"couplings.{coupling.joint}"
        position = _axial_joint(plant, hand, coupling.follows, field).default_positions()[0]
        follower = _axial_joint(plant, hand, coupling.joint, field)
        follower.set_default_positions([coupling.ratio * position + coupling.offset])


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


def _actuate(plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription) -> None:
    """Gives the joints that fingers list motors with the description's gains; removes those of followers.

    Without gains, the model's own are kept, and servos of followers are added to those of their leaders.
    """
    gains, couplings = description.actuation, description.followers
    for coupling in couplings:
        joint = plant.GetJointByName(coupling.joint, hand)
        if gains.stiffness == 0:
            _add_servo(plant, joint, plant.GetJointByName(coupling.follows, hand), abs(coupling.ratio))
        _remove_actuators(plant, joint)
    if gains.stiffness == 0:
        return
    existing = {actuator.joint().index(): actuator for actuator in _actuators(plant)}
    for name in description.joint_names:
        if not plant.HasJointNamed(name, hand):
            continue
        joint = plant.GetJointByName(name, hand)
        actuator = existing.get(joint.index())
        if actuator is None or gains.effort_limit > 0:
            # The effort limit of an existing actuator cannot change.
            _remove_actuators(plant, joint)
            actuator = plant.AddJointActuator(f"{name}_motor", joint, gains.effort_limit or np.inf)
        actuator.set_controller_gains(PdControllerGains(p=gains.stiffness, d=gains.damping))


def _add_servo(plant: MultibodyPlant, joint: Joint, leader: Joint, ratio: float) -> None:
    """Adds a follower's servo to that of its leader, which moves the follower by `ratio`."""
    servos = {a.joint().index(): a for a in _actuators(plant) if a.has_controller()}
    if not {joint.index(), leader.index()} <= servos.keys():
        return
    own, moving = servos[joint.index()], servos[leader.index()]
    given, added = moving.get_controller_gains(), own.get_controller_gains()
    name, gear, inertia = moving.name(), moving.default_gear_ratio(), moving.default_rotor_inertia()
    limit = moving.effort_limit() + ratio * own.effort_limit()
    plant.RemoveJointActuator(moving)  # the effort limit of an existing actuator cannot change
    servo = plant.AddJointActuator(name, leader, limit)
    servo.set_default_gear_ratio(gear)
    servo.set_default_rotor_inertia(inertia)
    servo.set_controller_gains(
        PdControllerGains(p=given.p + ratio**2 * added.p, d=given.d + ratio**2 * added.d)
    )


def _actuators(plant: MultibodyPlant) -> list:
    return [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]


def _remove_actuators(plant: MultibodyPlant, joint: Joint) -> None:
    index = joint.index()
    for actuator in _actuators(plant):
        if actuator.joint().index() == index:
            plant.RemoveJointActuator(actuator)


def _axial_joint(plant: MultibodyPlant, hand: ModelInstanceIndex, name: str, field: str) -> Joint:
    """Returns a joint with a single position."""
    choices = [joint.name() for joint in _joints(plant, hand) if joint.num_positions() == 1]
    require_name(field, "revolute or prismatic joint", name, choices)
    return plant.GetJointByName(name, hand)


def _filter_collisions(plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription) -> None:
    names = [plant.get_body(index).name() for index in plant.GetBodyIndices(hand)]
    filters = CollisionFilterDeclaration()
    for pair in description.ignored_collisions:
        for link in pair:
            require_name("ignored_collisions", "link", link, names)
        links = [plant.GetBodyByName(link, hand) for link in pair]
        filters.ExcludeBetween(*(GeometrySet(plant.GetCollisionGeometriesForBody(link)) for link in links))
    if description.ignored_collisions:
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)
