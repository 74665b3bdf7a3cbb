"""Adding a hand to a plant as its description says: base, couplings, what is held, gains, filters."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Joint,
    JointIndex,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    WeldJoint,
)

from geort_drake.errors import HandError
from geort_drake.hands.couplings import JointCouplings, leaders_range, root
from geort_drake.hands.description import HandDescription
from geort_drake.hands.model_files import model_files
from geort_drake.hands.model_values import check_model_values
from geort_drake.resources import PACKAGE_NAME, resolve_uri, resource_root


def add_hand_model(
    plant: MultibodyPlant, description: HandDescription, name: str | None = None
) -> ModelInstanceIndex:
    """Adds a hand that nothing carries yet to a plant that is not finalized.

    A joint that no finger lists and that follows none is welded at its default position. Joints that follow
    others have no motor; in a discrete plant a constraint drives them. The hand base is a frame of the
    model's instance with the description's name for it.

    Args:
        name: of the model instance; by default the model's.

    Raises:
        HandError: the model is missing or malformed, or lacks what the description names.
    """
    path = resolve_uri(description.model)
    source = f"hand '{description.name}' with model {path}"
    if not os.path.isfile(path):  # no more can be said of a name that is too long
        raise HandError(f"hand '{description.name}': the model file {path} is missing")
    constraints, scenery = set(plant.GetConstraintIds()), set(_scenery(plant))
    hand = parse_model(plant, path, source)
    if name is not None:
        plant.RenameModelInstance(hand, name)
    # Joints cannot be removed while there are constraints, and of these only couplings are known.
    for constraint in set(plant.GetConstraintIds()) - constraints:
        plant.RemoveConstraint(constraint)
    free_from_world(plant, hand)
    _add_base(plant, hand, description, source)
    followers = _set_default_positions(plant, hand, description, source)
    moving = {*description.joint_names, *followers}
    for joint in _joints(plant, hand):
        if joint.num_positions() and joint.name() not in moving:
            _hold(plant, joint)
    _actuate(plant, hand, description, followers)
    if plant.time_step() > 0:
        for follower, (leader, ratio, offset) in followers.items():
            joints = [plant.GetJointByName(joint, hand) for joint in (follower, leader)]
            plant.AddCouplerConstraint(*joints, ratio, offset)
    _ignore_collisions(plant, hand, description, source)
    # A floor that comes with the hand is not where the hand will be.
    if added := set(_scenery(plant)) - scenery:
        bodies = [plant.get_body(index) for index in plant.GetBodyIndices(hand)]
        own = [id for body in bodies for id in plant.GetCollisionGeometriesForBody(body)]
        filters = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(list(added)), GeometrySet(own))
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)
    return hand


def position_limits(
    plant: MultibodyPlant, description: HandDescription, hand: ModelInstanceIndex, source: str
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lower and upper limits of the joints that fingers list, rad, within which followers keep theirs.

    Args:
        hand: the model instance of the hand in `plant`, as `add_hand_model` adds it.
        source: what errors begin with.

    Raises:
        HandError: a joint that follows would leave its limits at every angle of its leader.
    """
    joints = [plant.GetJointByName(name, hand) for name in description.joint_names]
    lower = np.array([joint.position_lower_limits()[0] for joint in joints])
    upper = np.array([joint.position_upper_limits()[0] for joint in joints])
    couplings = JointCouplings.of(description)
    for row, name in enumerate(couplings.names):
        leader, follower = couplings.leaders[row], plant.GetJointByName(name, hand)
        ends = np.array([follower.position_lower_limits()[0], follower.position_upper_limits()[0]])
        low, high = leaders_range(ends, couplings.ratio[row, leader], couplings.offset[row])
        lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
        if not lower[leader] < upper[leader]:
            raise HandError(
                f"{source}: joint '{name}', which follows '{description.joint_names[leader]}', "
                f"would leave its limits [{ends[0]:g}, {ends[1]:g}] rad at every angle of that joint; "
                "correct its couplings or its limits"
            )
    return lower, upper


def _scenery(plant: MultibodyPlant) -> list[GeometryId]:
    return list(plant.GetCollisionGeometriesForBody(plant.world_body()))


def parse_model(plant: MultibodyPlant, path: Path, source: str) -> ModelInstanceIndex:
    """Adds the one model of a file; what it says of packages is looked for in the folders above it.

    Raises:
        HandError: the file is not one model that Drake reads, or holds values that no hand has.
    """
    parser = Parser(plant)
    packages = parser.package_map()
    packages.Add(PACKAGE_NAME, str(resource_root()))
    _add_packages(packages, path)
    try:
        (hand,) = parser.AddModels(path)
    except (RuntimeError, ValueError, SystemExit) as error:  # a failed assertion of Drake exits
        raise HandError(f"{source}: not one readable model: {error}") from error
    scenery = parser.scene_graph()
    inspector = None if scenery is None else scenery.model_inspector()
    check_model_values(model_files(plant, inspector, hand, path), source)
    return hand


def free_from_world(plant: MultibodyPlant, hand: ModelInstanceIndex) -> None:
    """Removes what ties a model to the world: some formats weld it there, or let it float."""
    for joint in _joints(plant, hand):
        if joint.parent_body().index() == plant.world_body().index():
            _remove_joint(plant, joint)


def joint_names(plant: MultibodyPlant, hand: ModelInstanceIndex, kind: type[Joint] = Joint) -> list[str]:
    """Names of a model's joints of a kind."""
    return [joint.name() for joint in _joints(plant, hand) if isinstance(joint, kind)]


def _joints(plant: MultibodyPlant, hand: ModelInstanceIndex) -> list[Joint]:
    return [plant.get_joint(index) for index in plant.GetJointIndices(hand)]


def _add_packages(packages: PackageMap, path: Path) -> None:
    text = path.read_text(encoding="utf-8", errors="replace")
    for name in set(re.findall(r"package://([^/\"'<]+)/", text)):
        for folder in path.resolve().parents:
            place = folder if folder.name == name else folder / name
            if not packages.Contains(name) and place.is_dir():
                packages.Add(name, str(place))


def _add_base(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription, source: str
) -> None:
    base = description.base_pose
    if not base.relative_to:
        return
    if not plant.HasFrameNamed(base.relative_to, hand):
        frames = [plant.get_frame(i).name() for i in plant.GetFrameIndices(hand)]
        raise HandError(
            f"{source}: base_pose.relative_to names the frame or link '{base.relative_to}', which the model "
            f"lacks; choose one of: {', '.join(frame for frame in frames if frame)}"
        )
    if plant.HasFrameNamed(description.base_frame, hand):
        raise HandError(
            f"{source}: base_frame '{description.base_frame}' is a frame of the model, so base_pose must be "
            "left out; or give base_frame a new name"
        )
    X = RigidTransform(RollPitchYaw(np.deg2rad(base.rpy_deg)), base.translation)
    frame = plant.GetFrameByName(base.relative_to, hand)
    plant.AddFrame(FixedOffsetFrame(description.base_frame, frame, X, hand))


def _set_default_positions(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription, source: str
) -> dict[str, tuple[str, float, float]]:
    """Sets them, and returns which joints follow one that a finger lists: leader, ratio, offset."""
    for name, position in description.default_positions.items():
        _axial_joint(plant, hand, name, f"{source}: default_positions").set_default_positions([position])
    followers = {}
    for coupling in description.couplings:
        where = f"{source}: couplings.{coupling.joint}"
        leader, ratio, offset = root(description.couplings, coupling)
        head = _axial_joint(plant, hand, leader, where)
        follower = _axial_joint(plant, hand, coupling.joint, where)
        follower.set_default_positions([ratio * head.default_positions()[0] + offset])
        if leader in description.joint_names:
            followers[coupling.joint] = (leader, ratio, offset)
    return followers


def _hold(plant: MultibodyPlant, joint: Joint) -> None:
    """Puts a weld in a joint's place, at its default position."""
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
            f"joint '{name}' cannot be held, as Drake takes no joint out of a plant with springs; take the "
            f"stiffness of joints out of the models: {error}"
        ) from error


def _actuate(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription, followers: Iterable[str]
) -> None:
    """Motors on the joints that fingers list and on no others, with the description's gains."""
    for name in followers:
        _remove_actuators(plant, plant.GetJointByName(name, hand))
    wanted = description.actuation
    if wanted.stiffness == 0:
        return
    existing = {actuator.joint().index(): actuator for actuator in _actuators(plant)}
    for name in description.joint_names:
        if not plant.HasJointNamed(name, hand):
            continue
        joint = plant.GetJointByName(name, hand)
        actuator = existing.get(joint.index())
        if actuator is None or wanted.effort_limit > 0:
            # An actuator's effort limit is fixed when it is made.
            _remove_actuators(plant, joint)
            limit = wanted.effort_limit or np.inf
            actuator = plant.AddJointActuator(f"{name}_motor", joint, limit)
        actuator.set_controller_gains(PdControllerGains(p=wanted.stiffness, d=wanted.damping))


def _actuators(plant: MultibodyPlant) -> list:
    return [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]


def _remove_actuators(plant: MultibodyPlant, joint: Joint) -> None:
    index: JointIndex = joint.index()
    for actuator in _actuators(plant):
        if actuator.joint().index() == index:
            plant.RemoveJointActuator(actuator)


def _axial_joint(plant: MultibodyPlant, hand: ModelInstanceIndex, name: str, where: str) -> Joint:
    """A joint with one position."""
    choices = [joint.name() for joint in _joints(plant, hand) if joint.num_positions() == 1]
    if name not in choices:
        raise HandError(
            f"{where} names the revolute or prismatic joint '{name}', which the model lacks; choose one of: "
            f"{', '.join(choices) or 'none'}"
        )
    return plant.GetJointByName(name, hand)


def _ignore_collisions(
    plant: MultibodyPlant, hand: ModelInstanceIndex, description: HandDescription, source: str
) -> None:
    names = [str(plant.get_body(index).name()) for index in plant.GetBodyIndices(hand)]
    filters = CollisionFilterDeclaration()
    for pair in description.ignored_collisions:
        for link in pair:
            if link not in names:
                raise HandError(
                    f"{source}: ignored_collisions names the link '{link}', which the model lacks; "
                    f"choose one of: {', '.join(names)}"
                )
        links = [plant.GetBodyByName(link, hand) for link in pair]
        filters.ExcludeBetween(*(GeometrySet(plant.GetCollisionGeometriesForBody(link)) for link in links))
    if description.ignored_collisions:
        Parser(plant).scene_graph().collision_filter_manager().Apply(filters)
