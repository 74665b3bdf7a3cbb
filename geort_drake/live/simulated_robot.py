"""Arm, hand and object of a scenario as one system, driven by joint targets."""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_group import JointGroup
from geort_drake.simulation.diagram import draw_placement
from geort_drake.simulation.object_shape import object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_object, add_robot, scale_stiffness


class SimulatedRobot(Diagram):
    """The plant of a scenario with its object standing where the seed puts it.

    Input ports:
        hand_desired_state (2n), arm_desired_state (2na): joint positions (rad), then velocities (rad/s),
            in the plant's actuator order.
    Output ports:
        hand_state (2n), arm_state (2na): measured, same order.

    Attributes:
        hand, arm: their joints.

    Args:
        meshcat: where to show it; nowhere without it.

    Raises:
        ScenarioError, HandError: scenario and models do not fit.
    """

    def __init__(self, scenario: Scenario, description: HandDescription, meshcat: Meshcat | None = None):
        super().__init__()
        builder = DiagramBuilder()
        plant: MultibodyPlant
        scene_graph: SceneGraph
        plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        add_robot(plant, scenario, description)
        body = add_object(plant, scenario.object.name)
        shape = object_shape(plant, scene_graph.model_inspector(), body)
        placement = draw_placement(
            scenario, shape.lowest_point(RigidTransform()), np.random.default_rng(scenario.random_seed)
        )
        plant.SetDefaultFloatingBaseBodyPose(body, placement.X_WO)
        arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
        scale_stiffness(plant, hand, scenario.hand_stiffness_factor)
        # The arm's controller compensates for gravity, its own and that of what it carries.
        for number in range(plant.num_model_instances()):
            if (model := ModelInstanceIndex(number)) != body.model_instance():
                plant.set_gravity_enabled(model, False)
        plant.Finalize()
        for model, name in ((hand, HAND), (arm, ARM)):
            builder.ExportInput(plant.get_desired_state_input_port(model), f"{name}_desired_state")
            builder.ExportOutput(plant.get_state_output_port(model), f"{name}_state")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
        builder.BuildInto(self)
        self.hand, self.arm = JointGroup.of_plant(plant, hand), JointGroup.of_plant(plant, arm)


def show() -> Meshcat:
    """A viewer that only this machine can see."""
    return Meshcat(MeshcatParams(host="localhost"))
