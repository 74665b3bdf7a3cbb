"""From the tracker on a person's wrist to the arm that carries the robot hand."""

import dataclasses as dc

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.planning import RobotDiagram
from pydrake.solvers import OsqpSolver
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import MatrixGain, StateInterpolatorWithDiscreteDerivative


@dc.dataclass
class WristToArmConfig:
    """How the arm follows the wrist."""

    # Period of the differential inverse kinematics, s.
    period: float = 0.01
    # Largest commanded speed of the hand, m/s and rad/s.
    max_translation_speed: float = 0.6
    max_rotation_speed: float = 2.0
    # Share of the arm's joint speed limits that is used.
    joint_speed_share: float = 0.9
    # Gain of the pull towards the starting posture in the arm's null space, 1/s.
    posture_gain: float = 0.5

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            if not getattr(self, field.name) > 0:
                raise ValueError(f"wrist_to_arm.{field.name} must be positive")


class Clutch(LeafSystem):
    """Moves the robot hand by what the wrist has moved since the clutch engaged.

    The person and the robot need not start at the same place: translation and rotation since the first
    valid sample are added to where the hand was then, both measured in W.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost. While lost, the last target stands; afterwards the wrist's
            motion is taken on from there, so that a gap never makes the arm jump.
    Output port:
        desired_pose (abstract RigidTransform): X_WB.
    """

    def __init__(self, X_WB_start: RigidTransform, period: float):
        super().__init__()
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._target = self.DeclareAbstractState(AbstractValue.Make(X_WB_start))
        # None until engaged, else the wrist's and the hand's pose at that moment.
        self._engaged = self.DeclareAbstractState(AbstractValue.Make(_Engagement()))
        self.DeclareStateOutputPort("desired_pose", self._target)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state) -> EventStatus:
        X_WB = context.get_abstract_state(self._target).get_value()
        engaged = context.get_abstract_state(self._engaged).get_value()
        if self._valid.Eval(context)[0] < 0.5:
            state.get_mutable_abstract_state(self._engaged).set_value(_Engagement())
            return EventStatus.Succeeded()
        X_WH = self._wrist.Eval(context)
        if engaged.X_WH is None:
            engaged = _Engagement(X_WH, X_WB)
            state.get_mutable_abstract_state(self._engaged).set_value(engaged)
        p_WB = engaged.X_WB.translation() + X_WH.translation() - engaged.X_WH.translation()
        R_WB = X_WH.rotation() @ engaged.X_WH.rotation().inverse() @ engaged.X_WB.rotation()
        state.get_mutable_abstract_state(self._target).set_value(RigidTransform(R_WB, p_WB))
        return EventStatus.Succeeded()


@dc.dataclass(frozen=True)
class _Engagement:
    X_WH: RigidTransform | None = None
    X_WB: RigidTransform | None = None


class WristToArm(Diagram):
    """From the tracker's wrist pose to the arm's desired state.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH of the tracker.
        valid (1): 1 tracked, 0 lost.
    Output port:
        arm_desired_state (2·na): the arm's joint positions (rad), then velocities (rad/s), plant order.

    Inside: `Clutch` → Drake's DifferentialInverseKinematicsIntegrator, which keeps to the arm's position
    and speed limits and starts at the robot's default positions → velocities by differences. Give its
    root context to `initialize` before simulating.

    Args:
        robot: robot and surroundings, in discrete time; its default positions are the start and the
            nominal posture.
        arm: the model in `robot` whose joints move; everything else stays at its default.
        hand_frame: the frame of `robot` that follows the wrist, the hand base B.
    """

    def __init__(
        self, robot: RobotDiagram, arm: ModelInstanceIndex, hand_frame: Frame, config: WristToArmConfig
    ):
        super().__init__()
        config.validate()
        plant = robot.plant()
        context = plant.CreateDefaultContext()
        moving = np.zeros(plant.num_positions(), bool)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if joint.model_instance() == arm:
                moving[joint.position_start() : joint.position_start() + joint.num_positions()] = True
            elif joint.num_velocities():
                joint.Lock(context)
        q_start = plant.GetPositions(context)
        num_arm = int(moving.sum())

        parameters = DifferentialInverseKinematicsParameters(plant.num_positions(), plant.num_velocities())
        parameters.set_joint_position_limits((plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()))
        share = config.joint_speed_share
        parameters.set_joint_velocity_limits(
            (share * plant.GetVelocityLowerLimits(), share * plant.GetVelocityUpperLimits())
        )
        parameters.set_nominal_joint_position(q_start)
        parameters.set_joint_centering_gain(config.posture_gain * np.diag(moving.astype(float)))
        parameters.set_end_effector_angular_speed_limit(config.max_rotation_speed)
        parameters.set_end_effector_translational_velocity_limits(
            np.full(3, -config.max_translation_speed), np.full(3, config.max_translation_speed)
        )
        # OSQP's polishing prints to stdout whenever no limit is active (OSQP issue 785).
        parameters.get_mutable_solver_options().SetOption(OsqpSolver.id(), "polishing", 0)
        builder = DiagramBuilder()
        clutch = builder.AddNamedSystem("clutch", Clutch(hand_frame.CalcPoseInWorld(context), config.period))
        inverse_kinematics = builder.AddNamedSystem(
            "differential_inverse_kinematics",
            DifferentialInverseKinematicsIntegrator(
                plant, plant.world_frame(), hand_frame, config.period, parameters, context
            ),
        )
        arm_only = builder.AddNamedSystem("arm_positions", MatrixGain(np.eye(len(moving))[moving]))
        differences = builder.AddNamedSystem(
            "desired_state",
            StateInterpolatorWithDiscreteDerivative(num_arm, config.period, suppress_initial_transient=True),
        )
        builder.Connect(clutch.GetOutputPort("desired_pose"), inverse_kinematics.GetInputPort("X_AE_desired"))
        builder.Connect(inverse_kinematics.GetOutputPort("joint_positions"), arm_only.get_input_port())
        builder.Connect(arm_only.get_output_port(), differences.get_input_port())
        builder.ExportInput(clutch.GetInputPort("wrist_pose"), "wrist_pose")
        builder.ExportInput(clutch.GetInputPort("valid"), "valid")
        builder.ExportOutput(differences.get_output_port(), "arm_desired_state")
        builder.BuildInto(self)
        self._robot = robot  # owns the plant that the inverse kinematics refers to
        self._inverse_kinematics, self._differences = inverse_kinematics, differences
        self._q_start, self._moving = q_start, moving

    def initialize(self, root: Context) -> None:
        """Starts the commands at the robot's default positions, in the root context of the diagram."""
        self._inverse_kinematics.SetPositions(
            self._inverse_kinematics.GetMyMutableContextFromRoot(root), self._q_start
        )
        self._differences.set_initial_position(
            self._differences.GetMyMutableContextFromRoot(root), self._q_start[self._moving]
        )
