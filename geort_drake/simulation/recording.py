"""What of a grasp trial goes into its Rerun recording."""

import importlib.metadata
import math
import os
from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, OutputPort

from geort_drake import __version__
from geort_drake.colours import FINGER_COLOURS, rgb
from geort_drake.hands.description import HandDescription
from geort_drake.hands.links import finger_links
from geort_drake.hands.plant_fingertips import PlantFingertips
from geort_drake.rerun.recorder import (
    CloseUpSpec,
    ContactSpec,
    HandSpec,
    PointsSpec,
    RerunRecorder,
    SignalSpec,
    StateSpec,
    add_rerun_recorder,
)
from geort_drake.simulation.operators.simulated_operator import SimulatedOperator
from geort_drake.simulation.operators.state import Phase
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.tasks.grasp.monitor import GraspMonitor, GraspPhase
from geort_drake.simulation.world import ARM, HAND, actuated_joints, actuated_state
from geort_drake.systems.retargeting_system import RetargetingSystem

# Tabs of the plots.
_FINGERS, _ANGLES, _TORQUES, _DELAYS = "fingers", "joint angles", "joint torques", "delays"
_GHOST, _PATH = (255, 255, 255, 110), (235, 235, 235)
_PERSON = 0.18  # m; length of a hand
_PACKAGES = {"drake": "drake", "rerun": "rerun-sdk", "numpy": "numpy", "torch": "torch"}


def add_grasp_recorder(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    path: str | os.PathLike,
    scenario: Scenario,
    description: HandDescription,
    object_body: RigidBody,
    monitor: GraspMonitor,
    seen: Mapping[str, OutputPort],
    source: LeafSystem,
    hand_source: LeafSystem,
    retargeting: RetargetingSystem,
    correction: LeafSystem,
    wrist_to_arm: Diagram,
    X_WHand: RigidTransform,
    properties: Mapping[str, str | int | float | bool],
) -> RerunRecorder:
    """Adds a recorder of robot, object, human hand, contact forces, joints, phases and delays.

    Args:
        seen: what the operator gets of a `SceneView`'s ports, late, by name; empty where nobody looks.
        source: the operator or the replay.
        hand_source: where the keypoints and the wrist of the hand are that is drawn.
        correction: the system whose output the hand is asked for.
        wrist_to_arm: the system whose output the arm is asked for.
        X_WHand: where the tracker's frame stands in W, to draw the human hand beside the robot's.
        properties: what the recording says of itself beside what the scenario and the software say.
    """
    arm, hand = plant.GetModelInstanceByName(ARM), plant.GetModelInstanceByName(HAND)
    finger_of = {joint: finger.name for finger in description.fingers for joint in finger.joints}
    of_arm = [joint.name() for joint in actuated_joints(plant, arm)]
    of_hand = [f"{finger_of[joint.name()]}/{joint.name()}" for joint in actuated_joints(plant, hand)]
    asked = {
        "joints": correction.GetOutputPort("desired_state"),
        "arm": wrist_to_arm.GetOutputPort("arm_desired_state"),
    }
    measured = {key: actuated_state(builder, plant, m) for key, m in (("joints", hand), ("arm", arm))}
    fingertips = PlantFingertips(plant, description, hand, [name.rpartition("/")[2] for name in of_hand])
    fingers, n = description.finger_names, len(of_hand)
    colors = [rgb(FINGER_COLOURS[name]) for name in fingers]

    def distance(states: np.ndarray) -> np.ndarray:
        """(T, F) mm, from (T, 4n): what the joints are asked for and what they do, each q and v."""
        return 1e3 * np.linalg.norm(fingertips(states[:, 2 * n : 3 * n]) - fingertips(states[:, :n]), axis=2)

    signals = {
        "fingertips/distance": SignalSpec(
            [asked["joints"], measured["joints"]], fingers, title="fingertip from its command", unit="mm",
            page=_FINGERS, colors=colors, derive=distance,
        ),
        **_joints(plant, hand, "joints", of_hand, asked["joints"], measured["joints"]),
        **_joints(plant, arm, "arm", of_arm, asked["arm"], measured["arm"]),
        **_delays(monitor.GetOutputPort("phase"), scenario, retargeting, bool(seen)),
    }  # fmt: skip
    states = {"grasp": StateSpec(monitor.GetOutputPort("phase"), [p.name.lower() for p in GraspPhase])}
    if isinstance(source, SimulatedOperator):
        states["operator"] = StateSpec(source.GetOutputPort("phase"), [p.name.lower() for p in Phase])
    links = dict(zip(fingers, finger_links(plant, description, hand), strict=True))
    return add_rerun_recorder(
        builder,
        plant,
        scene_graph,
        path,
        period=scenario.recording.period,
        # So long that the few newtons of a grasp stand out from the fingers.
        contact=ContactSpec(groups=links, metres_per_newton=0.04, max_length=0.2),
        signals=signals,
        hands={
            "human": HandSpec(
                hand_source.GetOutputPort("keypoints"),
                hand_source.GetOutputPort("wrist_pose"),
                # The operator's hand is never lost.
                None if isinstance(source, SimulatedOperator) else source.GetOutputPort("valid"),
                X_WO=X_WHand,
            )
        },
        points={
            # Of glass, and a little larger than the fingertips that are in them while they obey.
            "fingertips/commanded": PointsSpec(
                asked["joints"],
                plant.GetFrameByName(description.base_frame, hand),
                radius=1.25 * max(finger.tip_radius for finger in description.fingers),
                color=[(*color, 130) for color in colors],
                derive=lambda states: fingertips(states[:, :n]).reshape(len(states), -1),
            ),
            "object/path": _path(plant, object_body),
            **_what_is_seen(scenario, seen),
        },
        states=states,
        close_ups=_close_ups(plant, description, object_body, fingertips),
        # From the thumb's side, from where nothing hides what the hand holds.
        view_from=(0.62, 0.62 if description.side == "left" else -0.62, 0.48),
        properties={**_facts(scenario, description, retargeting), **properties},
    )


def _joints(
    plant: MultibodyPlant,
    model: ModelInstanceIndex,
    key: str,
    names: Sequence[str],
    asked: OutputPort,
    measured: OutputPort,
) -> dict[str, SignalSpec]:
    """Positions, and torques as shares of their limits; or in N m, where a joint of the model has no limit.

    Args:
        key: entity path.
        names: of the n joints, after a slash and their finger's, if they have one.
        asked, measured: (2n) joint positions, then velocities, which are not recorded.
    """
    n = len(names)
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices(model))
    limits = np.array([actuator.effort_limit() for actuator in actuators])
    torque = plant.get_net_actuation_output_port(model)
    signals = {
        f"{key}/{label}": SignalSpec(
            port, names, label, faint=label == "command", unit="rad", page=_ANGLES, derive=lambda x: x[:, :n]
        )
        for label, port in (("command", asked), ("measured", measured))
    }
    if not np.isfinite(limits).all():
        return signals | {f"{key}/torque": SignalSpec(torque, names, "torque", unit="N m", page=_TORQUES)}
    signals[f"{key}/torque_share"] = SignalSpec(
        torque, names, "torque_share", unit="of limit", page=_TORQUES, limits=(-1.15, 1.15),
        derive=lambda torques: torques / limits,
    )  # fmt: skip
    groups: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        groups.setdefault(name.rpartition("/")[0], []).append(number)
    if "" not in groups:
        signals[f"{key}/largest_torque_share"] = SignalSpec(
            torque, list(groups), title="largest joint torque", unit="of limit", page=_FINGERS,
            limits=(-0.05, 1.1), colors=[rgb(FINGER_COLOURS[name]) for name in groups],
            derive=lambda torques: np.stack(
                [np.abs(torques / limits)[:, group].max(axis=1) for group in groups.values()], axis=1
            ),
        )  # fmt: skip
    return signals


def _delays(
    port: OutputPort, scenario: Scenario, retargeting: RetargetingSystem, sees: bool
) -> dict[str, SignalSpec]:
    """The delays, which are the same at all times; of `port` nothing but the times is used."""
    delays = {"retargeting": retargeting.delay} | ({"sight": scenario.operator.visual_delay} if sees else {})
    values = 1e3 * np.array(list(delays.values()))
    spec = SignalSpec(
        port, list(delays), title="delay", unit="ms", page=_DELAYS, legend=True,
        derive=lambda rows: np.tile(values, (len(rows), 1)),
    )  # fmt: skip
    return {"delays/assumed": spec}


def _path(plant: MultibodyPlant, body: RigidBody) -> PointsSpec:
    """Where a free body has been: of the plant's state, as nothing needs to be computed for it."""
    model = body.model_instance()
    names = plant.GetPositionNames(model, add_model_instance_prefix=False)
    xyz = [names.index(f"{body.name()}_{axis}") for axis in "xyz"]
    state = plant.get_state_output_port(model)
    return PointsSpec(state, radius=0.002, color=_PATH, trail=math.inf, derive=lambda x: x[:, xyz])


def _what_is_seen(scenario: Scenario, seen: Mapping[str, OutputPort]) -> dict[str, PointsSpec]:
    """Ghosts of the fingertips and the object where the operator sees them."""
    if not seen:
        return {}
    start = scenario.operator.visual_delay
    return {
        "seen/fingertips": PointsSpec(seen["fingertips"], radius=0.008, color=_GHOST, start=start),
        "seen/object": PointsSpec(
            seen["object_pose"], radius=0.015, color=_GHOST, start=start, derive=_position
        ),
    }


def _position(poses: np.ndarray) -> np.ndarray:
    """The last three of a pose's seven numbers: (T, 3) of (T, 7)."""
    return poses[:, 4:]


def _close_ups(
    plant: MultibodyPlant, description: HandDescription, object_body: RigidBody, fingertips: PlantFingertips
) -> dict[str, CloseUpSpec]:
    """Both hands from where the index finger is, so that one sees thumb, fingers and what they hold."""
    hand = plant.GetModelInstanceByName(HAND)
    rest = np.array([joint.default_positions()[0] for joint in actuated_joints(plant, hand)])
    reach = np.linalg.norm(fingertips(rest[None]), axis=2).max()
    # Of a right hand: x out of the palm, y to the index finger, z along the fingers.
    direction = np.array([-0.35, 1.0, 0.2])
    person, robot = _PERSON * np.array([0.2, 0.0, 0.5]), reach * np.array([0.35, 0.0, 0.3])
    views = person + 1.2 * _PERSON * direction, person, robot + 1.75 * reach * direction, robot
    if description.side == "left":
        # Of a left robot hand y points away from the index finger, of a left human hand x into the palm.
        views = *(view * [-1, 1, 1] for view in views[:2]), *(view * [1, -1, 1] for view in views[2:])
    base = plant.GetFrameByName(description.base_frame, hand)
    return {
        "person's hand": CloseUpSpec("human", *views[:2]),
        "robot hand": CloseUpSpec(base, *views[2:], see_through=[object_body]),
    }


def _facts(
    scenario: Scenario, description: HandDescription, retargeting: RetargetingSystem
) -> dict[str, str | float]:
    """What was simulated, and with which software."""
    return {
        "hand": description.name,
        "object": scenario.object.name,
        "retargeting_delay_ms": 1e3 * retargeting.delay,
        "visual_delay_ms": 1e3 * scenario.operator.visual_delay,
        "geort_drake": __version__,
        **{name: _version(package) for name, package in _PACKAGES.items()},
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"  # Drake may be installed without pip
