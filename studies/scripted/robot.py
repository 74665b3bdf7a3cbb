"""Runs a script in place of person, glove, map and arm controller."""

from collections.abc import Callable

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.simulation.person.goal import Goal
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import HAND, add_robot
from geort_drake.systems.joint_limits import actuated_joints


def run_script(
    scenario: Scenario, goal: Goal, seed: int, script_for: Callable[[Stage, HandDescription], LeafSystem]
) -> float:
    """Returns the score of a script in one trial, 0 without success.

    Args:
        script_for: makes the script. Its input ports are ports of `Stage.percepts`, without delay or noise.
            Its output `desired_state` drives the hand, and `arm_desired_state`, if it exists, the arm.
    """
    description = load_hand(scenario.hand)
    robot, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    add_robot(robot, scenario, description)
    robot.Finalize()
    base = robot.GetFrameByName(description.base_frame, robot.GetModelInstanceByName(HAND))
    X_WB = base.CalcPoseInWorld(robot.CreateDefaultContext())
    builder = DiagramBuilder()
    rng = np.random.default_rng(seed)
    stage = find_task(scenario.task).add_stage(builder, scenario, description, goal, X_WB, rng)
    plant, hand, arm = stage.plant, stage.hand, stage.arm
    script = builder.AddSystem(script_for(stage, description))
    for index in range(script.num_input_ports()):
        port = script.get_input_port(index)
        builder.Connect(stage.percepts[port.get_name()], port)
    builder.Connect(script.GetOutputPort("desired_state"), plant.get_desired_state_input_port(hand))
    if script.HasOutputPort("arm_desired_state"):
        arm_target = script.GetOutputPort("arm_desired_state")
    else:
        q = [joint.default_positions()[0] for joint in actuated_joints(plant, arm)]
        still = builder.AddSystem(ConstantVectorSource(np.concatenate([q, np.zeros(len(q))])))
        arm_target = still.get_output_port()
    builder.Connect(arm_target, plant.get_desired_state_input_port(arm))
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    stage.initialize(root)
    simulator.AdvanceTo(scenario.timeout)
    outcome = stage.outcome(root)
    return outcome.score if outcome.success else 0.0


def hand_order(stage: Stage, description: HandDescription) -> list[int]:
    """Returns the index among the description's joints of each actuated joint, in actuator order."""
    return [description.joint_names.index(joint.name()) for joint in actuated_joints(stage.plant, stage.hand)]
