"""Adds the Rerun recorder of a trial."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from geort_drake import __version__
from geort_drake.colours import finger_colors
from geort_drake.files import atomic_path
from geort_drake.hands.assembly import HandInPlant
from geort_drake.hands.description import HandDescription
from geort_drake.rerun import (
    CloseUpSpec,
    ContactSpec,
    HandSpec,
    PointsSpec,
    RerunRecorder,
    SignalSpec,
    Spec,
    StateSpec,
    add_rerun_recorder,
)
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage, TrialResult
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import HAND, actuated_state
from geort_drake.systems.joint_limits import actuated_joints
from geort_drake.versions import version_of

HUMAN = "human"  # key of the person's hand
# Tabs of the plots.
_FINGERS, _ANGLES, _TORQUES = "fingers", "joint angles", "joint torques"
_SEEN_COLOR, _PATH_COLOR = (255, 255, 255, 110), (235, 235, 235)
_HUMAN_HAND_LENGTH = 0.18  # m
_TEXT = """\
# {title}

| | |
|---|---|
| task | {task} |
| method | {method} |
| robot hand | {hand} |
| seed | {seed} |
| outcome | **{outcome}** |

**Scene.** Translucent coloured spheres are the fingertips' targets; the robot's fingertips are inside of them
while they follow. Yellow arrows are contact forces, and white dots are the path of the object. Grey spheres
are what the simulated person sees, {delay:.0f} ms late.

**Below.** Phases of the task, and plots on tabs: fingers, joint angles (pale: commanded, strong: measured)
and joint torques.
"""


def add_trial_recorder(
    builder: DiagramBuilder,
    stage: Stage,
    path: str | os.PathLike,
    scenario: Scenario,
    description: HandDescription,
    operator_inputs: Mapping[str, OutputPort],
    hand_source: LeafSystem,
    properties: Mapping[str, str | int | float | bool],
) -> RerunRecorder:
    """Adds a recorder of robot, object, human hand, contact forces, joint signals and phases.

    Args:
        stage: the task's stage.
        operator_inputs: name → delayed port that the operator reads; empty for a replay.
        hand_source: provides keypoints and wrist pose of the hand that is drawn.
        properties: properties of the recording besides hand, object, delays and software versions.
    """
    plant, arm, hand = stage.plant, stage.arm, stage.hand
    system = builder.GetSubsystemByName
    glove = "worn_glove" if builder.HasSubsystemNamed("worn_glove") else "glove_replay"
    source = system("operator" if operator_inputs else glove)
    finger_of = {joint: finger.name for finger in description.fingers for joint in finger.joints}
    hand_joints = [joint.name() for joint in actuated_joints(plant, hand)]
    commanded = system("action_correction").GetOutputPort("desired_state")
    measured = actuated_state(builder, plant, hand)
    parts = HandInPlant(plant, description, hand)
    fingertips = parts.forward_kinematics(hand_joints)
    fingers, n = description.finger_names, len(hand_joints)
    colors = finger_colors(fingers)

    def distance(states: np.ndarray) -> np.ndarray:
        """Returns distances (T, F), mm, from states (T, 4n): commanded q and v, then measured q and v."""
        return 1e3 * np.linalg.norm(fingertips(states[:, 2 * n : 3 * n]) - fingertips(states[:, :n]), axis=2)

    specs: dict[str, Spec] = {
        "fingertips/distance": SignalSpec(
            [commanded, measured], fingers, title="fingertip from its command", unit="mm",
            page=_FINGERS, colors=colors, derive=distance,
        ),
    }  # fmt: skip
    names = [f"{finger_of[joint]}/{joint}" for joint in hand_joints]
    specs |= _joint_signals(plant, hand, "joints", names, commanded, measured)
    names = [joint.name() for joint in actuated_joints(plant, arm)]
    arm_commanded = system("wrist_to_arm").GetOutputPort("arm_desired_state")
    arm_measured = actuated_state(builder, plant, arm)
    specs |= _joint_signals(plant, arm, "arm", names, arm_commanded, arm_measured)
    handled, judge = stage.handled, stage.judge
    if handled.joints:
        key, (entries, unit) = f"{scenario.task}/positions", handled.positions
        positions = judge.GetOutputPort("positions")
        specs[key] = SignalSpec(positions, entries, title=key, unit=unit, page=_FINGERS)
    specs[scenario.task] = StateSpec(judge.GetOutputPort("phase"), handled.states)
    if operator_inputs:
        specs["operator"] = StateSpec(source.GetOutputPort("phase"), source.phases)
    links = dict(zip(fingers, parts.finger_links(), strict=True))
    base = plant.GetFrameByName(description.base_frame, hand)
    X_WB = base.CalcPoseInWorld(plant.CreateDefaultContext())
    specs[HUMAN] = HandSpec(
        hand_source.GetOutputPort("keypoints"),
        hand_source.GetOutputPort("wrist_pose"),
        # The operator's hand is never lost.
        None if operator_inputs else source.GetOutputPort("valid"),
        # Drawn next to the robot's, towards the camera.
        X_WO=RigidTransform(X_WB.translation() + [-0.05, -0.42, -0.10]),
    )
    # Translucent and slightly larger than the fingertips, which are inside while they follow.
    specs["fingertips/commanded"] = PointsSpec(
        commanded,
        base,
        radius=1.25 * max(finger.tip_radius for finger in description.fingers),
        color=[(*color, 130) for color in colors],
        derive=lambda states: fingertips(states[:, :n]).reshape(len(states), -1),
    )
    free_bodies = [] if handled.mass_factor is None else [handled.body]
    if free_bodies:
        specs["object/path"] = PointsSpec(
            stage.percepts["object_pose"], radius=0.002, color=_PATH_COLOR, trail=math.inf, derive=_origin
        )
    if operator_inputs:
        start = scenario.operator.visual_delay
        specs["seen/fingertips"] = PointsSpec(
            operator_inputs["fingertips"], None, 0.008, _SEEN_COLOR, start=start
        )
    if "object_pose" in operator_inputs:
        specs["seen/object"] = PointsSpec(
            operator_inputs["object_pose"], None, 0.015, _SEEN_COLOR, start=start, derive=_origin
        )
    return add_rerun_recorder(
        builder,
        plant,
        stage.scene_graph,
        path,
        specs,
        period=scenario.recording_period,
        # Long arrows, so that the few newtons of a grasp are visible.
        contact=ContactSpec(groups=links, metres_per_newton=0.04, max_length=0.2),
        close_ups=_close_ups(plant, description, free_bodies, fingertips),
        # From the thumb's side, where nothing hides what the hand holds.
        view_from=(0.62, 0.62 if description.side == "left" else -0.62, 0.48),
        text=_text(scenario, properties, "unknown: the trial did not end"),
        properties={
            "hand": description.name,
            "object": find_task(scenario.task).case_of(scenario),
            "retargeting_delay_ms": 1e3 * system("retargeting").delay,
            "visual_delay_ms": 1e3 * scenario.operator.visual_delay,
            "geort_drake": __version__,
            "rerun": version_of("rerun-sdk"),
            **{name: version_of(name) for name in ("drake", "numpy", "torch")},
            **properties,
        },
    )


def describe_result(
    recorder: RerunRecorder, scenario: Scenario, properties: Mapping[str, object], result: TrialResult
) -> None:
    """Adds the outcome to a trial's recording, and writes its samples as a table for exports."""
    when = result.completion_time if result.success else result.simulated_time
    outcome = f"{result.outcome}, {when:.1f} s after the start"
    method = f", {properties['method']}" if "method" in properties else ""
    recorder.set_properties({"outcome": result.outcome})
    recorder.describe(
        f"{result.object} {scenario.random_seed}{method}: {result.outcome}",
        _text(scenario, properties, outcome),
    )
    if recorder.path is not None:
        with atomic_path(recorder.path.with_suffix(".parquet")) as draft:
            pq.write_table(recorder.table(), draft)


def _text(scenario: Scenario, properties: Mapping[str, object], outcome: str) -> str:
    """Returns the Markdown of the panel that says what a trial's recording shows.

    Args:
        properties: properties of the recording, of which `method` is shown.
        outcome: how the trial ended, and when.
    """
    case = find_task(scenario.task).case_of(scenario)
    return _TEXT.format(
        title=f"{case.replace('_', ' ')}: {outcome.partition(',')[0]}",
        task=scenario.task,
        method=properties.get("method", "unknown"),
        hand=Path(scenario.hand).stem,
        seed=scenario.random_seed,
        outcome=outcome,
        delay=1e3 * scenario.operator.visual_delay,
    )


def _joint_signals(
    plant: MultibodyPlant,
    model: ModelInstanceIndex,
    key: str,
    names: Sequence[str],
    commanded: OutputPort,
    measured: OutputPort,
) -> dict[str, SignalSpec]:
    """Returns signals of joint positions, and of torques as fractions of their limits, or else in N m.

    Args:
        key: entity path of the signals.
        names: names of the n joints; for a hand as "finger/joint".
        commanded, measured: ports of n joint positions, then velocities, which are not recorded.
    """
    n = len(names)
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices(model))
    limits = np.array([actuator.effort_limit() for actuator in actuators])
    torque = plant.get_net_actuation_output_port(model)
    signals = {
        f"{key}/{label}": SignalSpec(
            port, names, label, faint=label == "command", unit="rad", page=_ANGLES, derive=lambda x: x[:, :n]
        )
        for label, port in (("command", commanded), ("measured", measured))
    }
    if not np.isfinite(limits).all():
        return signals | {f"{key}/torque": SignalSpec(torque, names, "torque", unit="N m", page=_TORQUES)}
    signals[f"{key}/torque_share"] = SignalSpec(
        torque, names, "torque_share", unit="of limit", page=_TORQUES, limits=(-1.15, 1.15),
        derive=lambda torques: torques / limits,
    )  # fmt: skip
    return signals


def _origin(poses: np.ndarray) -> np.ndarray:
    """Returns the origins (T, 3) of poses (T, 7)."""
    return poses[:, 4:]


def _close_ups(
    plant: MultibodyPlant,
    description: HandDescription,
    bodies: Sequence[RigidBody],
    fingertips: Callable[[np.ndarray], np.ndarray],
) -> dict[str, CloseUpSpec]:
    """Returns close-ups of both hands from the index finger's side, with the held object in view."""
    hand = plant.GetModelInstanceByName(HAND)
    rest = np.array([joint.default_positions()[0] for joint in actuated_joints(plant, hand)])
    reach = np.linalg.norm(fingertips(rest[None]), axis=2).max()
    # For a right hand: x out of the palm, y to the index finger, z along the fingers.
    direction = np.array([-0.35, 1.0, 0.2])
    person, robot = _HUMAN_HAND_LENGTH * np.array([0.2, 0.0, 0.5]), reach * np.array([0.35, 0.0, 0.3])
    views = person + 1.2 * _HUMAN_HAND_LENGTH * direction, person, robot + 1.75 * reach * direction, robot
    if description.side == "left":
        # A left robot hand's y points away from the index finger, a left human hand's x into the palm.
        views = *(view * [-1, 1, 1] for view in views[:2]), *(view * [1, -1, 1] for view in views[2:])
    base = plant.GetFrameByName(description.base_frame, hand)
    return {
        "person's hand": CloseUpSpec(HUMAN, *views[:2]),
        "robot hand": CloseUpSpec(base, *views[2:], see_through=list(bodies)),
    }
