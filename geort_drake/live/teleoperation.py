"""The loop: glove → engage switch → retargeting → watchdog → correction → robot, as one diagram."""

import dataclasses as dc

import numpy as np
from pydrake.planning import RobotDiagram, RobotDiagramBuilder
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, System

from geort_drake.gloves.recording import Recording
from geort_drake.hands.description import HandDescription
from geort_drake.live.joint_group import JointGroup
from geort_drake.live.latency import LatencyMeter
from geort_drake.live.watchdog import EngageSwitch, Watchdog, WatchdogConfig
from geort_drake.simulation.diagram import Retarget
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_robot
from geort_drake.systems.action_correction import make_correction
from geort_drake.systems.glove_recorder import GloveRecorder
from geort_drake.systems.hand_mirror import HandMirror
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.retargeting_system import RetargetingSystem
from geort_drake.systems.wrist_to_arm import WristToArm


class RobotModel:
    """What the loop knows of the robot: kinematics, joints and limits, without the object.

    Attributes:
        hand, arm: their joints; `start` is where the scenario and the hand's description put them.
    """

    def __init__(self, scenario: Scenario, description: HandDescription):
        self._scenario, self._description = scenario, description
        plant = self.standing_at({}).plant()
        self.hand = JointGroup.of_plant(plant, plant.GetModelInstanceByName(HAND))
        self.arm = JointGroup.of_plant(plant, plant.GetModelInstanceByName(ARM))
        self.limits = JointLimits.of_plant(
            plant,
            plant.GetModelInstanceByName(HAND),
            scenario.retargeting.max_joint_speed,
            scenario.retargeting.max_joint_acceleration,
        )

    def standing_at(self, arm_positions: dict[str, float]) -> RobotDiagram:
        """The model with joints of the arm, by name, at positions in rad by default."""
        builder = RobotDiagramBuilder(time_step=self._scenario.plant_config.time_step)
        plant = builder.plant()
        add_robot(plant, self._scenario, self._description)
        for name, position in arm_positions.items():
            joint = plant.GetJointByName(name, plant.GetModelInstanceByName(ARM))
            joint.set_default_positions([position])
        return builder.Build()


@dc.dataclass(frozen=True)
class Teleoperation:
    """The diagram and the parts of it that one asks."""

    diagram: Diagram
    watchdog: Watchdog
    meter: LatencyMeter | None
    recorder: GloveRecorder | None
    wrist_to_arm: WristToArm

    def initialize(self, root: Context) -> None:
        """Prepares a context of the diagram: disengaged, the arm's commands where the arm is."""
        self.engage(root, False)
        self.wrist_to_arm.initialize(root)

    def engage(self, root: Context, engaged: bool) -> None:
        """Lets robot and person follow each other, or parts them; the robot then brakes and holds."""
        self.diagram.GetInputPort("engaged").FixValue(root, [float(engaged)])

    def state(self, root: Context) -> str:
        """What the fingers do."""
        return self.watchdog.GetOutputPort("state").Eval(self.watchdog.GetMyContextFromRoot(root))

    def glove_recording(self, metadata: dict) -> Recording | None:
        """What the glove gave since the start, if it was recorded."""
        return None if self.recorder is None else self.recorder.recording(metadata)


def make_teleoperation(
    scenario: Scenario,
    description: HandDescription,
    model: RobotModel,
    retarget: Retarget,
    glove: LeafSystem,
    robot: System,
    start: tuple[np.ndarray, np.ndarray],
    config: WatchdogConfig,
    record: bool = False,
) -> Teleoperation:
    """Builds the loop around a glove and a robot.

    Args:
        retarget: a `Retargeter`, or anything with its `joint_names` and its call.
        glove: `GloveStream`, or `GloveReplay`, which has no stamps.
        robot: `RobotLink`, `SimulatedRobot`, or what has their ports.
        start: positions of hand (n,) and arm (na,), rad, in the model's order: where the robot is.
        record: whether to keep what the glove gives.

    Raises:
        HandError: the retargeter and the robot move different joints.
        ValueError: a value of the configuration cannot work.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("glove", glove)
    builder.AddNamedSystem("robot", robot)
    q_hand, q_arm = start
    at_start = dict(zip(model.hand.joints, q_hand.tolist(), strict=True))
    settings = scenario.retargeting

    # The person's word counts while they are engaged.
    switch = builder.AddNamedSystem("engage_switch", EngageSwitch())
    builder.Connect(glove.GetOutputPort("valid"), switch.GetInputPort("valid"))
    builder.ExportInput(switch.GetInputPort("engaged"), "engaged")

    # Fingers.
    retargeting = builder.AddNamedSystem(
        "retargeting",
        RetargetingSystem(
            retarget,
            retarget.joint_names,  # type: ignore[attr-defined]
            model.hand.joints,
            at_start,
            settings.period,
            model.limits,
            settings.latency,
            cutoff=settings.cutoff,
        ),
    )
    safe = [description.default_positions.get(name, 0.0) for name in model.hand.joints]
    watchdog = builder.AddNamedSystem(
        "watchdog", Watchdog(model.limits, np.array(safe), retargeting.period, config)
    )
    correction = builder.AddNamedSystem(
        "action_correction",
        make_correction(
            scenario.correction, description, model.hand.joints, at_start, model.limits, retargeting.period
        ),
    )
    builder.Connect(glove.GetOutputPort("keypoints"), retargeting.GetInputPort("keypoints"))
    builder.Connect(switch.GetOutputPort("valid"), retargeting.GetInputPort("valid"))
    if glove.HasOutputPort("stamp"):
        builder.Connect(glove.GetOutputPort("stamp"), retargeting.GetInputPort("stamp"))
    builder.Connect(retargeting.GetOutputPort("desired_state"), watchdog.GetInputPort("desired_state"))
    builder.Connect(retargeting.GetOutputPort("status"), watchdog.GetInputPort("status"))
    builder.ConnectInput("engaged", watchdog.GetInputPort("engaged"))
    builder.Connect(watchdog.GetOutputPort("desired_state"), correction.GetInputPort("desired_state"))
    builder.Connect(robot.GetOutputPort("hand_state"), correction.GetInputPort("hand_state"))
    builder.Connect(correction.get_output_port(), robot.GetInputPort("hand_desired_state"))

    # The arm follows the wrist while the fingers follow the hand.
    diagram = model.standing_at(dict(zip(model.arm.joints, q_arm.tolist(), strict=True)))
    arm, hand = (diagram.plant().GetModelInstanceByName(name) for name in (ARM, HAND))
    base = diagram.plant().GetFrameByName(description.base_frame, hand)
    wrist_to_arm = builder.AddNamedSystem(
        "wrist_to_arm", WristToArm(diagram, arm, base, scenario.wrist_to_arm)
    )
    wrist: LeafSystem = glove
    if description.side == "left":
        wrist = builder.AddNamedSystem("hand_mirror", HandMirror())
        for name in ("keypoints", "wrist_pose"):
            builder.Connect(glove.GetOutputPort(name), wrist.GetInputPort(name))
    builder.Connect(wrist.GetOutputPort("wrist_pose"), wrist_to_arm.GetInputPort("wrist_pose"))
    builder.Connect(watchdog.GetOutputPort("following"), wrist_to_arm.GetInputPort("valid"))
    builder.Connect(wrist_to_arm.GetOutputPort("arm_desired_state"), robot.GetInputPort("arm_desired_state"))

    meter = recorder = None
    if glove.HasOutputPort("sent"):
        meter = builder.AddNamedSystem("latency", LatencyMeter(len(safe), retargeting.period))
        builder.Connect(glove.GetOutputPort("sent"), meter.GetInputPort("sent"))
        builder.Connect(correction.get_output_port(), meter.GetInputPort("command"))
        if robot.HasOutputPort("hand_commanded"):
            builder.Connect(robot.GetOutputPort("hand_commanded"), meter.GetInputPort("echo"))
    if record:
        recorder = builder.AddNamedSystem("glove_recorder", GloveRecorder(retargeting.period))
        for name in ("keypoints", "wrist_pose", "valid"):
            builder.Connect(glove.GetOutputPort(name), recorder.GetInputPort(name))

    built = builder.Build()
    built.set_name("teleoperation")
    return Teleoperation(built, watchdog, meter, recorder, wrist_to_arm)
