"""What of a grasp trial goes into its Rerun recording."""

import os
from collections.abc import Mapping

from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Demultiplexer

from geort_drake.hands.description import HandDescription
from geort_drake.hands.links import finger_links
from geort_drake.operators.behavior import Phase
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import HAND, actuated_state
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
    X_WHand: RigidTransform,
    properties: Mapping[str, str | int | float | bool],
) -> RerunRecorder:
    """Adds a recorder of robot, object, human hand, contact forces, joints and phases.

    Args:
        source: the operator or the replay.
        hand_source: where the keypoints and the wrist of the hand are that is drawn.
        correction: the system whose output the hand is asked for.
        X_WHand: where the tracker's frame stands in W, to draw the human hand beside the robot's.
    """
    hand = plant.GetModelInstanceByName(HAND)
    actuated = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(hand)]
    finger_of = {joint: finger.name for finger in description.fingers for joint in finger.joints}
    names = [f"{finger_of[joint]}/{joint}" for joint in actuated]
    # Positions and velocities share a port; only the positions are plotted.
    n = len(actuated)
    halves = {}
    for key, port in (
        ("command", correction.get_output_port()),
        ("measured", actuated_state(builder, plant, hand)),
    ):
        halves[key] = builder.AddNamedSystem(f"{key}_positions", Demultiplexer([n, n]))
        builder.Connect(port, halves[key].get_input_port())
    signals = {
        "joints/command": SignalSpec(halves["command"].get_output_port(0), names, "command", faint=True),
        "joints/measured": SignalSpec(halves["measured"].get_output_port(0), names, "measured"),
    }
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
