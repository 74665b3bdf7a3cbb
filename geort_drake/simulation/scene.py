"""Robot, surroundings and object of a scenario in one plant, the object standing where the seed puts it."""

import dataclasses as dc

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.description import HandDescription
from geort_drake.simulation.object_shape import ObjectShape, object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import (
    ARM,
    HAND,
    add_object,
    add_robot,
    scale_friction,
    scale_stiffness,
    standing_pose,
)


@dc.dataclass(frozen=True)
class Placement:
    """Where the object stands in one trial, how heavy and how rough it is."""

    X_WO: RigidTransform
    mass_factor: float
    friction_factor: float


@dc.dataclass(frozen=True, eq=False)
class Scene:
    """A finalized plant, and what is in it.

    Attributes:
        arm, hand: models whose joints are driven by the plant's position controllers.
        placement: of the object; its mass is still the model's, because only a context can change it.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: ModelInstanceIndex
    hand: ModelInstanceIndex
    object_body: RigidBody
    object_shape: ObjectShape
    placement: Placement


def draw_placement(scenario: Scenario, lowest_at_identity: float, rng: np.random.Generator) -> Placement:
    """Draws the object's pose and the factors on mass and friction within the scenario's ranges.

    Args:
        lowest_at_identity: height in W of the object's lowest point at X_WO = identity, m.
    """
    config = scenario.object
    dx, dy = rng.uniform(-config.position_range, config.position_range, 2)
    yaw = config.yaw + rng.uniform(-config.yaw_range, config.yaw_range)
    mass = config.mass_factor * (1 + rng.uniform(-config.mass_range, config.mass_range))
    # From a generator of its own, so that what is drawn next does not depend on it.
    friction = config.friction_factor * (
        1 + rng.spawn(1)[0].uniform(-config.friction_range, config.friction_range)
    )
    return Placement(standing_pose(scenario, lowest_at_identity, dx, dy, yaw), mass, friction)


def add_scene(
    builder: DiagramBuilder, scenario: Scenario, description: HandDescription, rng: np.random.Generator
) -> Scene:
    """Adds the plant of a scenario to a diagram.

    Args:
        rng: draws the placement.

    Raises:
        ScenarioError, HandError: the scenario and the models do not fit.
    """
    plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
    add_robot(plant, scenario, description)
    body = add_object(plant, scenario.object.name)
    shape = object_shape(plant, scene_graph.model_inspector(), body)
    placement = draw_placement(scenario, shape.lowest_point(RigidTransform()), rng)
    plant.SetDefaultFloatingBaseBodyPose(body, placement.X_WO)
    scale_friction(plant, scene_graph, body, placement.friction_factor)
    arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
    scale_stiffness(plant, hand, scenario.hand_stiffness_factor)
    # The real arm's controller compensates for gravity, its own and that of what it carries; the rest
    # of the scene but the object stands still anyway.
    for number in range(plant.num_model_instances()):
        if (model := ModelInstanceIndex(number)) != body.model_instance():
            plant.set_gravity_enabled(model, False)
    plant.Finalize()
    _require_controllers(plant, hand, f"hand '{description.name}'")
    _require_controllers(plant, arm, "the arm")
    return Scene(plant, scene_graph, arm, hand, body, shape, placement)


def _require_controllers(plant: MultibodyPlant, model: ModelInstanceIndex, what: str) -> None:
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(model)]
    without = [actuator.name() for actuator in actuators if not actuator.has_controller()]
    if without or not actuators:
        raise HandError(
            f"{what} needs PD gains (drake:controller_gains) on every actuator; missing on: "
            f"{', '.join(without) or 'all, as it has no actuator'}"
        )
