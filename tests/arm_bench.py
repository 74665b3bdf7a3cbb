"""The arm of the Allegro hand as teleoperation drives it, by itself: wrist checks and inverse kinematics."""

import numpy as np
from faults.bench import Watch
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from system_bench import SystemBench

from geort_drake import WristToArm, load_hand, load_scenario
from geort_drake.simulation.following import RobotModel
from geort_drake.simulation.world import ARM, HAND
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.wrist_checks import WristChecks

PERIOD = 0.01
# The Panda's limits, rad/s and rad/s²: libfranka, kMaxJointVelocity and kMaxJointAcceleration.
SPEED = np.array([2.175] * 4 + [2.61] * 3)
ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])


class ArmBench(SystemBench):
    """Steps wrist checks and `WristToArm` with the settings of teleoperation, update by update."""

    def __init__(self):
        scenario = load_scenario()
        description = load_hand(scenario.hand)
        robot = RobotModel(scenario, description).standing_at({})
        plant = robot.plant()
        arm, hand = (plant.GetModelInstanceByName(name) for name in (ARM, HAND))
        base = plant.GetFrameByName(description.base_frame, hand)
        lower, upper = plant.GetPositionLowerLimits()[:7], plant.GetPositionUpperLimits()[:7]
        start = plant.GetPositions(plant.CreateDefaultContext())[:7]
        self.watch = Watch(JointLimits(lower, upper, SPEED, ACCELERATION), PERIOD, start)
        builder = DiagramBuilder()
        self.checks = builder.AddSystem(WristChecks(PERIOD))
        self.arm = builder.AddSystem(
            WristToArm(robot, arm, base, scenario.wrist_to_arm, limit_acceleration=True)
        )
        builder.Connect(self.checks.GetOutputPort("valid"), self.arm.GetInputPort("valid"))
        builder.ExportInput(self.checks.GetInputPort("wrist_pose"), "wrist_pose")
        builder.ConnectInput("wrist_pose", self.arm.GetInputPort("wrist_pose"))
        builder.ExportInput(self.checks.GetInputPort("valid"), "valid")
        super().__init__(builder.Build(), PERIOD)
        self._hand_pose = lambda q: (plant.SetPositions(scratch, arm, q), base.CalcPoseInWorld(scratch))[1]
        scratch = plant.CreateDefaultContext()

    def hand_position(self, q: np.ndarray) -> np.ndarray:
        """p_WB (3,), m, of the hand with the arm at positions q (7,), rad."""
        return self._hand_pose(q).translation().copy()

    def tick(self, X_WH: RigidTransform, valid: float = 1.0) -> tuple[np.ndarray, np.ndarray, str]:
        """One update; returns the arm's positions (rad) and velocities (rad/s), and the wrist's state."""
        self.fix(wrist_pose=X_WH, valid=valid)
        self.advance()
        desired = self.value("arm_desired_state", self.arm)
        return desired[:7], desired[7:], self.value("state", self.checks)
