"""Loading robot, surroundings and object into a plant, the same way for simulation and planning."""

from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody

from geort_drake.errors import HandError, ScenarioError, UnknownNameError
from geort_drake.hands.description import HandDescription
from geort_drake.resources import PACKAGE_NAME, models_dir, resource_root
from geort_drake.simulation.scenario import Scenario, object_names

ARM, HAND = "arm", "hand"


def add_robot(plant: MultibodyPlant, scenario: Scenario, description: HandDescription) -> None:
    """Adds the scenario's models and sets the default joint positions.

    Raises:
        ScenarioError: a directive fails, a model named `arm` or `hand` is missing, or `arm_posture`
            names no joint of the arm.
    """
    parser = Parser(plant)
    parser.package_map().Add(PACKAGE_NAME, str(resource_root()))
    try:
        ProcessModelDirectives(ModelDirectives(directives=scenario.directives), parser)
    except RuntimeError as error:
        raise ScenarioError(f"scenario field directives: {error}") from error
    for name in (ARM, HAND):
        if not plant.HasModelInstanceNamed(name):
            raise ScenarioError(f"scenario field directives must add a model named '{name}'")
    arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
    _set_defaults(plant, arm, scenario.arm_posture, "scenario field arm_posture")
    _set_defaults(plant, hand, description.default_positions, f"hand '{description.name}'")


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
