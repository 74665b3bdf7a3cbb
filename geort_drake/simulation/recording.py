"""What of a grasp trial goes into its Rerun recording."""

import os
from collections.abc import Mapping

from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Demultiplexer

from geort_drake.hands.description import HandDescription
from geort_drake.hands.links import finger_links
from geort_drake.operators.state import Phase
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, actuated_joints, actuated_state
from geort_drake.systems.grasp_monitor import GraspMonitor, GraspPhase
from geort_drake.systems.rerun_recorder import (
    ContactSpec,
    HandSpec,
    RerunRecorder,
    SignalSpec,
    StateSpec,
    add_rerun_recorder,
)
from geort_drake.systems.simulated_operator import SimulatedOperator


def add_grasp_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path: str | os.PathLike,
    scenario: Scenario,
    description: HandDescription,
    monitor: GraspMonitor,
    source: LeafSystem,
    hand_source: LeafSystem,
    correction: LeafSystem,
    wrist_to_arm: Diagram,
    X_WHand: RigidTransform,
    properties: Mapping[str, str | int | float | bool],
) -> RerunRecorder:
    """Adds a recorder of robot, object, human hand, contact forces, joints and phases.

    Args:
        source: the operator or the replay.
        hand_source: where the keypoints and the wrist of the hand are that is drawn.
        correction: the system whose output the hand is asked for.
        wrist_to_arm: the system whose output the arm is asked for.
        X_WHand: where the tracker's frame stands in W, to draw the human hand beside the robot's.
    """
    arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
    finger_of = {joint: finger.name for finger in description.fingers for joint in finger.joints}
    of_arm = [joint.name() for joint in actuated_joints(plant, arm)]
    of_hand = [f"{finger_of[joint.name()]}/{joint.name()}" for joint in actuated_joints(plant, hand)]
    asked_hand, asked_arm = correction.get_output_port(), wrist_to_arm.GetOutputPort("arm_desired_state")
    signals = {}
    for key, names, asked, model in (("joints", of_hand, asked_hand, hand), ("arm", of_arm, asked_arm, arm)):
        for label, state in (("command", asked), ("measured", actuated_state(builder, plant, model))):
            # Positions and velocities share a port; only the positions are recorded.
            halves = builder.AddNamedSystem(f"{key}_{label}", Demultiplexer([len(names)] * 2))
            builder.Connect(state, halves.get_input_port())
            port = halves.get_output_port(0)
            signals[f"{key}/{label}"] = SignalSpec(port, names, label, faint=label == "command")
    states = {"grasp": StateSpec(monitor.GetOutputPort("phase"), [p.name.lower() for p in GraspPhase])}
    if isinstance(source, SimulatedOperator):
        states["operator"] = StateSpec(source.GetOutputPort("phase"), [p.name.lower() for p in Phase])
    links = dict(zip(description.finger_names, finger_links(plant, description, hand), strict=True))
    return add_rerun_recorder(
        builder,
        plant,
        scene_graph,
        path,
        period=scenario.recording.period,
        contact=ContactSpec(groups=links),
        signals=signals,
        hands={
            "human": HandSpec(
                hand_source.GetOutputPort("keypoints"),
                hand_source.GetOutputPort("wrist_pose"),
                source.GetOutputPort("valid"),
                X_WO=X_WHand,
            )
        },
        states=states,
        properties=properties,
    )
