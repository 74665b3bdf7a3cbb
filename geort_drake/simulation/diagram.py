"""Builds the diagram of a trial from a scenario."""

import dataclasses as dc
import math
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import DiscreteTimeDelay, Gain

from geort_drake.hands.assembly import remove_visuals
from geort_drake.hands.description import HandDescription, load_hand
from geort_drake.people.recording import Recording
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.following import add_arm, add_fingers, robot_model
from geort_drake.simulation.person.engine import Person
from geort_drake.simulation.person.simulated_operator import SimulatedOperator
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.task import Stage
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.world import actuated_state
from geort_drake.simulation.worn_glove import WornGlove, WornGloveConfig
from geort_drake.systems.glove import GloveRecorder, GloveReplay
from geort_drake.systems.port_values import POINT_MIRROR, POSE_MIRROR, mirrored_pose
from geort_drake.systems.retargeting_system import RetargetingSystem

if TYPE_CHECKING:
    from geort_drake.rerun import RerunRecorder


@dc.dataclass(frozen=True)
class TrialDiagram:
    """The diagram of a trial, and the parts of it that hold results."""

    diagram: Diagram
    plant: MultibodyPlant
    description: HandDescription
    stage: Stage
    retargeting: RetargetingSystem
    glove_recorder: GloveRecorder
    operator: SimulatedOperator | None
    recorder: "RerunRecorder | None"

    def initialize(self, root: Context) -> None:
        """Prepares the task's stage in a context, and removes visual geometry.

        The recorder no longer needs that geometry: it read it when the diagram was built.
        """
        remove_visuals(self.plant, self.stage.scene_graph, root)
        self.stage.initialize(root)


def make_trial_diagram(
    scenario: Scenario,
    retarget: Retarget,
    human: tuple[HumanHand, Any] | Recording,
    rerun_path: str | os.PathLike | None = None,
    properties: Mapping[str, str | int | float | bool] | None = None,
) -> TrialDiagram:
    """Builds the diagram: glove → retargeting → hand, wrist → arm, and the plant.

    Args:
        scenario: what to simulate.
        retarget: a `Retargeter`, or a similar callable with `joint_names`.
        human: a hand and a goal for the simulated operator, or a glove recording with wrist poses to replay.
            `geort_drake.simulation.tasks.find_task(scenario.task).plans(scenario, load_hand(scenario.hand))`
            returns goals, best first.
        rerun_path: file of the Rerun recording; None for none.
        properties: properties of the Rerun recording.

    Raises:
        ScenarioError, HandError: scenario, hand and retargeter do not fit together.
    """
    rng = np.random.default_rng(scenario.random_seed)
    description = load_hand(scenario.hand)
    builder = DiagramBuilder()

    # The robot alone, for the inverse kinematics.
    model = robot_model(scenario, description)
    X_WB_start = model.X_WB

    # The plant and the judge of the task.
    task = find_task(scenario.task)
    goal = None if isinstance(human, Recording) else human[1]
    stage = task.add_stage(builder, scenario, description, goal, X_WB_start, rng)
    plant, arm, hand = stage.plant, stage.arm, stage.hand

    # A left hand is operated by the mirror image of a right-handed person, who sees the mirrored scene.
    in_mirror = description.side == "left"

    # The human: an operator who sees the scene with a delay, or a recording.
    source: LeafSystem
    operator = None
    operator_inputs: dict[str, OutputPort] = {}
    if isinstance(human, Recording):
        source = builder.AddNamedSystem("glove_replay", GloveReplay(human))
    else:
        # The person starts with the hand oriented like the robot's. The tracker's frame is parallel to W and
        # has its origin at the wrist's initial position.
        X_WB_seen = mirrored_pose(X_WB_start) if in_mirror else X_WB_start
        noise = np.random.default_rng(int(rng.integers(2**31)))
        intended = human[1].mirrored() if in_mirror else human[1]
        settings = task.placing or task.settings_of(scenario)
        behaviour = task.phases, scenario.kind, scenario.operator, settings
        person = Person(human[0], intended, *behaviour, noise, task.begins_straight)
        X_WH_start = RigidTransform(X_WB_seen.rotation(), np.zeros(3))
        sizes = {name: port.size() for name, port in stage.percepts.items()}
        operator = source = builder.AddNamedSystem("operator", SimulatedOperator(person, X_WH_start, sizes))
        signs = dict.fromkeys(("hand_pose", "object_pose", "place_pose"), POSE_MIRROR)
        signs["fingertips"] = np.tile(POINT_MIRROR, len(description.fingers))
        for name, port in stage.percepts.items():
            operator_inputs[name] = output = _delayed(builder, name, port, scenario)
            if in_mirror and name in signs:
                mirror = builder.AddNamedSystem(f"{name}_mirrored", Gain(signs[name]))
                builder.Connect(output, mirror.get_input_port())
                output = mirror.get_output_port()
            builder.Connect(output, operator.GetInputPort(name))
    if scenario.glove != WornGloveConfig():
        # A separate generator, so that placement and the person's noise do not depend on the faults.
        faults = np.random.default_rng([scenario.random_seed, 1])
        glove = builder.AddNamedSystem("worn_glove", WornGlove(scenario.glove, scenario.timeout, faults))
        for name in ("keypoints", "wrist_pose", "valid"):
            builder.Connect(source.GetOutputPort(name), glove.GetInputPort(name))
        source = glove

    # Fingers: keypoints → joint targets → (correction) → the hand's PD controllers.
    step = scenario.plant_config.time_step
    latency = step * math.ceil(scenario.retargeting.latency / step - 1e-6)
    valid = source.GetOutputPort("valid")
    retargeting, correction = add_fingers(
        builder, scenario, model, retarget, model.hand.start, source, valid, latency, ease_at_start=False
    )
    builder.Connect(retargeting.GetOutputPort("desired_state"), correction.GetInputPort("desired_state"))
    builder.Connect(actuated_state(builder, plant, hand), correction.GetInputPort("hand_state"))
    builder.Connect(correction.GetOutputPort("desired_state"), plant.get_desired_state_input_port(hand))

    # Wrist: tracker pose → differential inverse kinematics → the arm's PD controllers.
    wrist_to_arm, hand_source = add_arm(builder, scenario, model, source)
    builder.Connect(valid, wrist_to_arm.GetInputPort("valid"))
    builder.Connect(wrist_to_arm.GetOutputPort("arm_desired_state"), plant.get_desired_state_input_port(arm))

    # Results: the glove's data, and the recording for the viewer.
    glove_recorder = builder.AddNamedSystem("glove_recorder", GloveRecorder(scenario.operator.period))
    for name in ("keypoints", "wrist_pose", "valid"):
        builder.Connect(source.GetOutputPort(name), glove_recorder.GetInputPort(name))
    recorder = None
    if rerun_path is not None:
        # Imported here, so that a simulation without a recording does not load Rerun.
        from geort_drake.simulation.recording import add_trial_recorder

        recorder = add_trial_recorder(
            builder, stage, rerun_path, scenario, description, operator_inputs, hand_source, properties or {}
        )

    diagram = builder.Build()
    diagram.set_name(task.name)
    return TrialDiagram(
        diagram=diagram,
        plant=plant,
        description=description,
        stage=stage,
        retargeting=retargeting,
        glove_recorder=glove_recorder,
        operator=operator,
        recorder=recorder,
    )


def _delayed(builder: DiagramBuilder, name: str, port: OutputPort, scenario: Scenario) -> OutputPort:
    config = scenario.operator
    steps = round(config.visual_delay / config.period)
    if steps == 0:
        return port
    # A system that samples the delay's output reads it before the delay's update at the same time, which
    # adds one period.
    delay = builder.AddNamedSystem(
        f"{name}_seen_late", DiscreteTimeDelay(config.period, steps - 1, port.size())
    )
    builder.Connect(port, delay.get_input_port())
    return delay.get_output_port()
