"""Models a scenario's robot, and adds the systems by which it follows a human hand."""

import copy
import dataclasses as dc

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.planning import RobotDiagram, RobotDiagramBuilder
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from geort_drake.errors import HandError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand
from geort_drake.retargeting.base import Retarget
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ARM, HAND, add_robot
from geort_drake.systems.corrections import (
    ActionCorrection,
    PolicyCorrection,
    SelfCollisionGuard,
    load_policy,
)
from geort_drake.systems.glove import HandMirror
from geort_drake.systems.joint_limits import JointLimits, actuated_joints
from geort_drake.systems.retargeting_system import RetargetingSystem
from geort_drake.systems.wrist_to_arm import WristToArm


@dc.dataclass(frozen=True, eq=False)
class JointGroup:
    """The n actuated joints of one model, in actuator order.

    Attributes:
        name: name of the model.
        joints: names of the joints.
        start, lower, upper: (n,) default positions and position limits, rad.
    """

    name: str
    joints: list[str]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, model: ModelInstanceIndex) -> "JointGroup":
        """Returns the joints of a model in a finalized plant."""
        joints = actuated_joints(plant, model)
        return cls(
            plant.GetModelInstanceName(model),
            [joint.name() for joint in joints],
            np.array([joint.default_positions()[0] for joint in joints]),
            np.array([joint.position_lower_limit() for joint in joints]),
            np.array([joint.position_upper_limit() for joint in joints]),
        )


class RobotModel:
    """Kinematics, joints and limits of a scenario's robot, without the object.

    Attributes:
        description: description of the hand.
        diagram: the robot at its initial position.
        hand, arm: the joints of each; scenario and hand description give their `start`.
        limits: limits of the hand's joints, in actuator order.
        X_WB: initial pose of the hand's base.
    """

    def __init__(self, scenario: Scenario, description: HandDescription):
        self._scenario, self.description = scenario, description
        self.diagram = self.standing_at({})
        plant = self.diagram.plant()
        self.hand = JointGroup.of_plant(plant, plant.GetModelInstanceByName(HAND))
        self.arm = JointGroup.of_plant(plant, plant.GetModelInstanceByName(ARM))
        base = plant.GetFrameByName(description.base_frame, plant.GetModelInstanceByName(HAND))
        self.X_WB = base.CalcPoseInWorld(plant.CreateDefaultContext())
        self.limits = JointLimits.of_plant(
            plant,
            plant.GetModelInstanceByName(HAND),
            scenario.retargeting.max_joint_speed,
            scenario.retargeting.max_joint_acceleration,
        )

    def standing_at(self, arm_positions: dict[str, float]) -> RobotDiagram:
        """Returns the model with default positions (rad) of the arm's joints, by name."""
        builder = RobotDiagramBuilder(time_step=self._scenario.plant_config.time_step)
        plant = builder.plant()
        add_robot(plant, self._scenario, self.description)
        for name, position in arm_positions.items():
            joint = plant.GetJointByName(name, plant.GetModelInstanceByName(ARM))
            joint.set_default_positions([position])
        return builder.Build()


# Fields of a scenario that determine its robot; and the robot of this process's last trial.
ROBOT_FIELDS = "plant_config", "directives", "hand_parent", "arm_posture", "left_arm_posture"
_last: dict[str, RobotModel] = {}


def robot_model(scenario: Scenario, description: HandDescription) -> RobotModel:
    """Returns a model of the scenario's robot: the one of the last call, if the robot is the same."""
    limits = scenario.retargeting.max_joint_speed, scenario.retargeting.max_joint_acceleration
    key = repr(([getattr(scenario, name) for name in ROBOT_FIELDS], limits, description))
    if key not in _last:
        model = RobotModel(copy.deepcopy(scenario), description)
        _last.clear()
        _last[key] = model
    return _last[key]


def add_fingers(
    builder: DiagramBuilder,
    scenario: Scenario,
    model: RobotModel,
    retarget: Retarget,
    start: np.ndarray,
    glove: LeafSystem,
    valid: OutputPort,
    latency: float,
    ease_at_start: bool = True,
) -> tuple[RetargetingSystem, ActionCorrection]:
    """Adds retargeting, connected to the glove, and correction, not connected.

    Args:
        retarget: a `Retargeter`, or a similar callable with `joint_names`.
        start: initial positions of the hand's joints (n,), rad, in the model's order.
        glove: a system with the output port `keypoints` and, optionally, `stamp`.
        valid: port that tells whether the keypoints are tracked.
        latency, ease_at_start: see `RetargetingSystem`.

    Raises:
        HandError: the retargeter was trained for another hand or moves other joints than the robot has, or
            the guard cannot be used.
        PolicyError: the policy that corrects commands cannot be run.
    """
    hands = getattr(retarget, "robot_hands", ())
    if hands and model.description.name not in hands:
        names = ", ".join(hands)
        raise HandError(f"the retargeter is for {names}, not for the robot hand {model.description.name}")
    settings, config, joints = scenario.retargeting, scenario.correction, model.hand.joints
    at_start = dict(zip(joints, start.tolist(), strict=True))
    robot = model.diagram.plant()
    retargeting = builder.AddNamedSystem(
        "retargeting",
        RetargetingSystem(
            retarget,
            robot,
            robot.GetModelInstanceByName(HAND),
            initial_positions=at_start,
            period=settings.period,
            limits=model.limits,
            latency=latency,
            ease_at_start=ease_at_start,
            cutoff=settings.cutoff,
        ),
    )
    joint_settings = (joints, at_start, model.limits, settings.period)
    correction = ActionCorrection(len(joints))
    if config.kind == "guard":
        correction = SelfCollisionGuard(Hand(model.description), *joint_settings, config.clearance)
    elif config.kind == "policy":
        correction = PolicyCorrection(load_policy(config.policy, len(joints)), *joint_settings)
    builder.AddNamedSystem("action_correction", correction)
    builder.Connect(glove.GetOutputPort("keypoints"), retargeting.GetInputPort("keypoints"))
    builder.Connect(valid, retargeting.GetInputPort("valid"))
    if glove.HasOutputPort("stamp"):
        builder.Connect(glove.GetOutputPort("stamp"), retargeting.GetInputPort("stamp"))
    return retargeting, correction


def add_arm(
    builder: DiagramBuilder,
    scenario: Scenario,
    model: RobotModel,
    glove: LeafSystem,
    arm_positions: dict[str, float] | None = None,
    limit_acceleration: bool = False,
) -> tuple[WristToArm, LeafSystem]:
    """Adds the system that moves the arm, and connects it to the wrist's pose.

    The glove of a left hand outputs the mirror image of the hand, so a system mirrors it back.

    Args:
        glove: a system with the output ports `keypoints` and `wrist_pose`.
        arm_positions: initial positions of the arm's joints by name, rad; by default those of the model.
        limit_acceleration: see `WristToArm`.

    Returns:
        The system that moves the arm, and the system that outputs the hand's true keypoints and wrist pose.
    """
    robot = model.standing_at(arm_positions) if arm_positions else model.diagram
    arm, hand = (robot.plant().GetModelInstanceByName(name) for name in (ARM, HAND))
    base = robot.plant().GetFrameByName(model.description.base_frame, hand)
    wrist_to_arm = builder.AddNamedSystem(
        "wrist_to_arm", WristToArm(robot, arm, base, scenario.wrist_to_arm, limit_acceleration)
    )
    source = glove
    if model.description.side == "left":
        source = builder.AddNamedSystem("hand_mirror", HandMirror())
        for name in ("keypoints", "wrist_pose"):
            builder.Connect(glove.GetOutputPort(name), source.GetInputPort(name))
    builder.Connect(source.GetOutputPort("wrist_pose"), wrist_to_arm.GetInputPort("wrist_pose"))
    return wrist_to_arm, source
