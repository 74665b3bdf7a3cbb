"""Loads a scenario's robot, surroundings and object into a plant."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    Convex,
    Mesh,
    RoleAssign,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import (
    GetScopedFrameByName,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from geort_drake.errors import HandError, ScenarioError, naming
from geort_drake.hands.assembly import HandInPlant, add_hand_model, add_models, joint_paths
from geort_drake.hands.description import HandDescription
from geort_drake.hands.geometry import hull_vertices
from geort_drake.resources import PACKAGE_NAME, resource_root
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.scenario import Scenario, object_file
from geort_drake.systems.joint_limits import actuated_joints

ARM, HAND = "arm", "hand"  # names of model instances
_MESH_SIZE = 0.008  # m; edges of hydroelastic meshes, two thirds of a fingertip's radius
# m; vertices of fingertip meshes are rounded to a lattice of this spacing, or finer in thin meshes. Every
# triangle on it has an area, which Drake needs. A published hull of a thousand vertices keeps about 110.
_LATTICE = 0.001


def add_placed_object(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scenario: Scenario,
    description: HandDescription,
    rng: np.random.Generator,
) -> tuple[RigidBody, ObjectShape, float]:
    """Adds the scenario's object to a plant with a robot, at a pose and with a friction that `rng` draws.

    Returns:
        The body, its shape, and the factor on its mass, which only a context can hold.

    Raises:
        ScenarioError: the object has no usable geometry.
    """
    body = add_object(plant, scenario.object.name)
    shape = ObjectShape(plant, scene_graph.model_inspector(), body)
    X_WO, mass_factor, friction_factor = draw_placement(scenario, shape.lowest_point(RigidTransform()), rng)
    plant.SetDefaultFloatingBaseBodyPose(body, X_WO)
    _scale_friction(plant, scene_graph, body, friction_factor)
    if scenario.fingertip_modulus:
        _soften_fingertips(plant, scene_graph, description, body, scenario.fingertip_modulus)
    return body, shape, mass_factor


def finalize(
    plant: MultibodyPlant, scenario: Scenario, description: HandDescription, free: ModelInstanceIndex | None
) -> None:
    """Finalizes a plant with the scenario's robot; gravity acts on the free model alone.

    A real arm's controller compensates gravity for arm and hand, and everything else is fixed.

    Args:
        free: the model of the free body; None if there is none.

    Raises:
        HandError: an actuator of arm or hand has no PD gains.
    """
    hand = plant.GetModelInstanceByName(HAND)
    for model in map(ModelInstanceIndex, range(plant.num_model_instances())):
        if model != free:
            plant.set_gravity_enabled(model, False)
    plant.Finalize()
    _require_controllers(plant, hand, f"hand '{description.name}'")
    _require_controllers(plant, plant.GetModelInstanceByName(ARM), "the arm")


def add_robot(plant: MultibodyPlant, scenario: Scenario, description: HandDescription) -> None:
    """Adds the scenario's models and the hand on its mount, and sets the default joint positions.

    Raises:
        ScenarioError: a directive fails, the model `arm` or the frame `hand_parent` is missing, or an arm
            posture names an unknown joint.
        HandError: the hand's model cannot be loaded, or lacks masses or the mount's frame.
    """
    parser = Parser(plant)
    parser.package_map().Add(PACKAGE_NAME, str(resource_root()))
    try:
        ProcessModelDirectives(ModelDirectives(directives=scenario.directives), parser)
    except RuntimeError as error:
        raise ScenarioError(f"scenario field directives: {error}") from error
    if not plant.HasModelInstanceNamed(ARM):
        raise ScenarioError(f"scenario field directives must add a model named '{ARM}'")
    _mount_hand(plant, scenario, description)
    arm = plant.GetModelInstanceByName(ARM)
    _set_defaults(plant, arm, scenario.arm_posture, "scenario field arm_posture")
    if description.side == "left":
        _set_defaults(plant, arm, scenario.left_arm_posture, "scenario field left_arm_posture")


def add_object(plant: MultibodyPlant, name: str) -> RigidBody:
    """Adds an object, see `object_file`, and returns its body.

    Raises:
        UnknownNameError: there is no such object.
    """
    models = add_models(Parser(plant), object_file(name))
    (body,) = plant.GetBodyIndices(models[0])
    return plant.get_body(body)


def draw_placement(
    scenario: Scenario, lowest_at_identity: float, rng: np.random.Generator
) -> tuple[RigidTransform, float, float]:
    """Draws the object's pose X_WO, and factors on its mass and its friction, in the scenario's ranges.

    Args:
        lowest_at_identity: height in W of the object's lowest point at X_WO = identity, m.
    """
    config = scenario.object
    dx, dy = rng.uniform(-config.position_range, config.position_range, 2)
    yaw = config.yaw + rng.uniform(-config.yaw_range, config.yaw_range)
    mass = config.mass_factor * (1 + rng.uniform(-config.mass_range, config.mass_range))
    # A separate generator for friction, so that later draws do not depend on it.
    friction = config.friction_factor * (
        1 + rng.spawn(1)[0].uniform(-config.friction_range, config.friction_range)
    )
    return standing_pose(scenario, lowest_at_identity, dx, dy, yaw), mass, friction


def standing_pose(
    scenario: Scenario, lowest_at_identity: float, dx: float = 0.0, dy: float = 0.0, yaw: float = 0.0
) -> RigidTransform:
    """Returns X_WO of the object on its support, displaced by dx, dy (m) and turned by yaw (rad)."""
    x, y = scenario.object.position
    z = scenario.object.support_height - lowest_at_identity
    return RigidTransform(RotationMatrix.MakeZRotation(yaw), [x + dx, y + dy, z])


def actuated_state(builder: DiagramBuilder, plant: MultibodyPlant, model: ModelInstanceIndex) -> OutputPort:
    """Returns a port with positions, then velocities of a model's actuated joints, in actuator order."""
    return joint_state(builder, plant, actuated_joints(plant, model))


def joint_state(builder: DiagramBuilder, plant: MultibodyPlant, joints: Sequence[Joint]) -> OutputPort:
    """Returns a port with positions, then velocities of some joints of one model in a finalized plant."""
    state = plant.get_state_output_port(joints[0].model_instance())
    if state.size() == 2 * len(joints):
        return state
    selector = builder.AddSystem(MatrixGain(plant.MakeStateSelectorMatrix([j.index() for j in joints])))
    builder.Connect(plant.get_state_output_port(), selector.get_input_port())
    return selector.get_output_port()


def _mount_hand(plant: MultibodyPlant, scenario: Scenario, description: HandDescription) -> None:
    """Adds the hand's model and welds its mount frame to the scenario's `hand_parent`."""
    try:
        parent = GetScopedFrameByName(plant, scenario.hand_parent)
    except RuntimeError as error:
        raise ScenarioError(f"scenario field hand_parent: {error}") from error
    hand = add_hand_model(plant, description, HAND)
    parts, mount = HandInPlant(plant, description, hand), description.mount
    with naming(f"hand '{description.name}'", HandError):
        _require_masses(parts)
        limits = parts.position_limits()
        child = parts.frame(mount.frame or description.base_frame, "mount.frame")
    for name, lower, upper in zip(description.joint_names, *limits, strict=True):
        plant.GetJointByName(name, hand).set_position_limits([lower], [upper])
    X_PM = RigidTransform(RollPitchYaw(np.deg2rad(mount.rpy_deg)), mount.translation)
    plant.WeldFrames(parent, child, X_PM)


def _set_defaults(
    plant: MultibodyPlant, model: ModelInstanceIndex, positions: dict[str, float], source: str
) -> None:
    names = [plant.get_joint(index).name() for index in plant.GetJointIndices(model)]
    for name, value in positions.items():
        if name not in names:
            raise ScenarioError(f"{source}: no joint '{name}'; the joints are: {', '.join(names)}")
        joint = plant.GetJointByName(name, model)
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        if not low <= value <= high:
            raise HandError(f"{source}: {name} = {value} rad is outside its limits [{low}, {high}]")
        joint.set_default_positions([value])


def _scale_friction(plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, factor: float) -> None:
    """Multiplies the friction coefficients of a body's shapes; the plant is not finalized.

    For a contact of two bodies Drake uses 2 μ₁ μ₂ / (μ₁ + μ₂).
    """
    for geometry in plant.GetCollisionGeometriesForBody(body):
        properties = scene_graph.model_inspector().GetProximityProperties(geometry)
        friction = properties.GetProperty("material", "coulomb_friction")
        scaled = CoulombFriction(factor * friction.static_friction(), factor * friction.dynamic_friction())
        properties.UpdateProperty("material", "coulomb_friction", scaled)
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _soften_fingertips(
    plant: MultibodyPlant, scene_graph: SceneGraph, description: HandDescription, body: RigidBody, E: float
) -> None:
    """Makes fingertips compliant hydroelastic with modulus E (Pa), and the body rigid hydroelastic."""
    inspector, hand = scene_graph.model_inspector(), plant.GetModelInstanceByName(HAND)
    tips = HandInPlant(plant, description, hand).tip_geometries(inspector)
    for geometry in [*tips, *plant.GetCollisionGeometriesForBody(body)]:
        properties = inspector.GetProximityProperties(geometry)
        if geometry in tips:
            shape = inspector.GetShape(geometry)
            if isinstance(shape, Convex | Mesh):
                coarse = _on_lattice(shape, inspector.GetName(geometry))
                scene_graph.ChangeShape(plant.get_source_id(), geometry, coarse)
            AddCompliantHydroelasticProperties(_MESH_SIZE, E, properties)
        else:
            AddRigidHydroelasticProperties(_MESH_SIZE, properties)
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _on_lattice(shape: Convex | Mesh, name: str) -> Convex:
    """Returns the convex hull of a shape's vertices, rounded to a lattice finer than its thickness."""
    vertices = hull_vertices(shape)
    axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2]
    spacing = min(_LATTICE, np.ptp(vertices @ axes.T, axis=0).min() / 4)
    return Convex(spacing * np.unique(np.round(vertices / spacing), axis=0).T, name)


def _require_masses(hand: HandInPlant) -> None:
    """Raises HandError if a joint of the hand moves no mass; the plant is not finalized."""
    moved_mass = {joint.name(): 0.0 for joint in hand.joints if joint.num_velocities()}
    for link, path in joint_paths(hand.plant, hand.instance).items():
        for name in moved_mass.keys() & {joint.name() for joint in path}:
            moved_mass[name] += hand.plant.get_body(link).default_mass()
    idle = [name for name, mass in moved_mass.items() if not mass > 0]
    if idle:
        raise HandError(
            f"joints that move no mass cannot be simulated: {', '.join(idle)}; give their links inertia in "
            f"{hand.description.model}"
        )


def _require_controllers(plant: MultibodyPlant, model: ModelInstanceIndex, owner: str) -> None:
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(model)]
    without = [actuator.name() for actuator in actuators if not actuator.has_controller()]
    if without or not actuators:
        raise HandError(
            f"{owner} needs PD gains (drake:controller_gains) on every actuator; missing on: "
            f"{', '.join(without) or 'all, as it has no actuator'}"
        )
