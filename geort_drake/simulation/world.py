"""Loading robot, surroundings and object into a plant, the same way for simulation and planning."""

import math

import numpy as np
from pydrake.geometry import RoleAssign, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import (
    GetScopedFrameByName,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import Joint, JointIndex, ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from geort_drake.errors import HandError, ScenarioError, UnknownNameError
from geort_drake.hands.assembly import add_hand_model, position_limits
from geort_drake.hands.description import HandDescription
from geort_drake.resources import PACKAGE_NAME, models_dir, resource_root
from geort_drake.simulation.scenario import Scenario, object_names

ARM, HAND = "arm", "hand"


def add_robot(plant: MultibodyPlant, scenario: Scenario, description: HandDescription) -> None:
    """Adds the scenario's models and the hand on its mount, and sets the default joint positions.

    Raises:
        ScenarioError: a directive fails, the model `arm` or the frame `hand_parent` is missing, or an arm
            posture names no joint of the arm.
        HandError: the hand's model cannot be loaded, or lacks the frame of the mount.
    """
    parser = Parser(plant)
    parser.package_map().Add(PACKAGE_NAME, str(resource_root()))
    try:
        ProcessModelDirectives(ModelDirectives(directives=scenario.directives), parser)
    except RuntimeError as error:
        raise ScenarioError(f"scenario field directives: {error}") from error
    if not plant.HasModelInstanceNamed(ARM):
        raise ScenarioError(f"scenario field directives must add a model named '{ARM}'")
    if plant.HasModelInstanceNamed(HAND):
        hand = plant.GetModelInstanceByName(HAND)
        _set_defaults(plant, hand, description.default_positions, f"hand '{description.name}'")
    else:
        _mount_hand(plant, scenario, description)
    arm = plant.GetModelInstanceByName(ARM)
    _set_defaults(plant, arm, scenario.arm_posture, "scenario field arm_posture")
    if description.side == "left":
        _set_defaults(plant, arm, scenario.left_arm_posture, "scenario field left_arm_posture")


def add_object(plant: MultibodyPlant, name: str) -> RigidBody:
    """Adds an object of models/sdf/objects and returns its body.

    Raises:
        UnknownNameError: there is no such object.
    """
    if name not in object_names():
        raise UnknownNameError("object", name, object_names())
    models = Parser(plant).AddModels(str(models_dir() / "sdf" / "objects" / f"{name}.sdf"))
    (body,) = plant.GetBodyIndices(models[0])
    return plant.get_body(body)


def standing_pose(
    scenario: Scenario, lowest_at_identity: float, dx: float, dy: float, yaw: float
) -> RigidTransform:
    """X_WO of the object standing on its support, moved and turned from the scenario's position."""
    x, y = scenario.object.position
    z = scenario.object.support_height - lowest_at_identity
    return RigidTransform(RotationMatrix.MakeZRotation(yaw), [x + dx, y + dy, z])


def scale_friction(plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, factor: float) -> None:
    """Multiplies the friction coefficients of a body's shapes, before the plant is finalized.

    At a contact of two bodies Drake takes 2 μ₁ μ₂ / (μ₁ + μ₂).
    """
    for geometry in plant.GetCollisionGeometriesForBody(body):
        properties = scene_graph.model_inspector().GetProximityProperties(geometry)
        friction = properties.GetProperty("material", "coulomb_friction")
        scaled = CoulombFriction(factor * friction.static_friction(), factor * friction.dynamic_friction())
        properties.UpdateProperty("material", "coulomb_friction", scaled)
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def scale_stiffness(plant: MultibodyPlant, model: ModelInstanceIndex, factor: float) -> None:
    """Multiplies a model's proportional gains before the plant is finalized; damping ratios stay."""
    # Before the plant is finalized it does not know yet which actuators are the model's.
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.model_instance() == model and actuator.has_controller():
            gains = actuator.get_controller_gains()
            actuator.set_controller_gains(
                PdControllerGains(p=factor * gains.p, d=math.sqrt(factor) * gains.d)
            )


def actuated_joints(plant: MultibodyPlant, model: ModelInstanceIndex) -> list[Joint]:
    """The joints of a model that have a motor, in actuator order; the plant is finalized."""
    return [plant.get_joint_actuator(index).joint() for index in plant.GetJointActuatorIndices(model)]


def actuated_state(builder: DiagramBuilder, plant: MultibodyPlant, model: ModelInstanceIndex) -> OutputPort:
    """Positions, then velocities of a model's actuated joints; joints that follow others are left out."""
    joints = actuated_joints(plant, model)
    everything = plant.get_state_output_port(model)
    if everything.size() == 2 * len(joints):
        return everything
    q_start = min(plant.get_joint(index).position_start() for index in _moving(plant, model))
    v_start = min(plant.get_joint(index).velocity_start() for index in _moving(plant, model))
    rows = [joint.position_start() - q_start for joint in joints]
    rows += [plant.num_positions(model) + joint.velocity_start() - v_start for joint in joints]
    selector = builder.AddSystem(MatrixGain(np.eye(everything.size())[rows]))
    builder.Connect(everything, selector.get_input_port())
    return selector.get_output_port()


def _moving(plant: MultibodyPlant, model: ModelInstanceIndex) -> list[JointIndex]:
    return [index for index in plant.GetJointIndices(model) if plant.get_joint(index).num_positions()]


def _mount_hand(plant: MultibodyPlant, scenario: Scenario, description: HandDescription) -> None:
    """Adds the hand's model and welds the frame of its mount to the scenario's `hand_parent`."""
    try:
        parent = GetScopedFrameByName(plant, scenario.hand_parent)
    except RuntimeError as error:
        raise ScenarioError(f"scenario field hand_parent: {error}") from error
    hand = add_hand_model(plant, description, HAND)
    limits = position_limits(plant, description, hand, f"hand '{description.name}'")
    for name, lower, upper in zip(description.joint_names, *limits, strict=True):
        plant.GetJointByName(name, hand).set_position_limits([lower], [upper])
    mount = description.mount
    try:
        child = plant.GetFrameByName(mount.frame or description.base_frame, hand)
    except RuntimeError as error:
        raise HandError(f"hand '{description.name}': mount.frame: {error}") from error
    X_PM = RigidTransform(RollPitchYaw(np.deg2rad(mount.rpy_deg)), mount.translation)
    plant.WeldFrames(parent, child, X_PM)


def _set_defaults(
    plant: MultibodyPlant, model: ModelInstanceIndex, positions: dict[str, float], source: str
) -> None:
    names = [plant.get_joint(index).name() for index in plant.GetJointIndices(model)]
    for name, value in positions.items():
        if name not in names:
            raise ScenarioError(f"{source} names no joint '{name}'; the joints are: {', '.join(names)}")
        joint = plant.GetJointByName(name, model)
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        if not low <= value <= high:
            raise HandError(f"{source}: {name} = {value} rad is outside its limits [{low}, {high}]")
        joint.set_default_positions([value])
