"""Arm, hand and object of a scenario as one system, driven by joint targets."""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder

from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_group import JointGroup
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, actuated_state, add_scene


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
        scene = add_scene(builder, scenario, description, np.random.default_rng(scenario.random_seed))
        plant, hand, arm = scene.plant, scene.hand, scene.arm
        for model, name in ((hand, HAND), (arm, ARM)):
            builder.ExportInput(plant.get_desired_state_input_port(model), f"{name}_desired_state")
            builder.ExportOutput(actuated_state(builder, plant, model), f"{name}_state")
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, scene.scene_graph, meshcat)
        builder.BuildInto(self)
        self.hand, self.arm = JointGroup.of_plant(plant, hand), JointGroup.of_plant(plant, arm)


def show() -> Meshcat:
    """A viewer that only this machine can see."""
    return Meshcat(MeshcatParams(host="localhost"))
