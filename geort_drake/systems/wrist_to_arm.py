"""From the tracker on a person's wrist to the arm that carries the robot hand."""

import dataclasses as dc
import math

import numpy as np
from pydrake.common import Parallelism
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsController,
    DifferentialInverseKinematicsSystem,
)
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.planning import DofMask, JointLimits, RobotDiagram, SceneGraphCollisionChecker
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import (
    BusCreator,
    ConstantVectorSource,
    MatrixGain,
    Multiplexer,
    ZeroOrderHold,
)

from geort_drake.systems.unchanging import Unchanging


@dc.dataclass
class WristToArmConfig:
    """How the arm follows the wrist."""

    # Period of the differential inverse kinematics, s.
    period: float = 0.01
    # Share of the pose error that one period takes back; below 1 it smooths the tracker's noise.
    pose_gain: float = 0.3
    # Largest commanded speed of the hand, m/s and rad/s.
    max_translation_speed: float = 0.6
    max_rotation_speed: float = 2.5
    # Share of the arm's joint speed limits that is used.
    joint_speed_share: float = 0.9
    # Gain of the pull towards the starting posture in the arm's null space, 1/s.
    posture_gain: float = 0.5

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"wrist_to_arm.{field.name} must be positive and finite, not {value}")
        if self.joint_speed_share > 1:
            raise ValueError(
                f"wrist_to_arm.joint_speed_share must be at most 1, not {self.joint_speed_share}"
            )


class Clutch(LeafSystem):
    """Moves the robot hand by what the wrist has moved since the clutch engaged.

    The person and the robot need not start at the same place: translation and rotation since the first
    valid sample are added to where the hand was then, both measured in W.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost. While lost, the last target stands; afterwards the wrist's
            motion is taken on from there, so that a gap never makes the arm jump.
    Output port:
        hand_pose (abstract RigidTransform): X_WB, where the hand shall be.
    """

    def __init__(self, X_WB_start: RigidTransform, period: float):
        super().__init__()
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._target = self.DeclareAbstractState(AbstractValue.Make(X_WB_start))
        # None until engaged, else the wrist's and the hand's pose at that moment.
        self._engaged = self.DeclareAbstractState(AbstractValue.Make(_Engagement()))
        self.DeclareStateOutputPort("hand_pose", self._target)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state) -> EventStatus:
        X_WB = context.get_abstract_state(self._target).get_value()
        engaged = context.get_abstract_state(self._engaged).get_value()
        if self._valid.Eval(context)[0] < 0.5:
            state.get_mutable_abstract_state(self._engaged).set_value(_Engagement())
            return EventStatus.Succeeded()
        X_WH = self._wrist.Eval(context)
        if engaged.X_WH is None:
            # Copies, because ports and states are written over.
            engaged = _Engagement(RigidTransform(X_WH), RigidTransform(X_WB))
            state.get_mutable_abstract_state(self._engaged).set_value(engaged)
        p_WB = engaged.X_WB.translation() + X_WH.translation() - engaged.X_WH.translation()
        R_WB = X_WH.rotation() @ engaged.X_WH.rotation().inverse() @ engaged.X_WB.rotation()
        state.get_mutable_abstract_state(self._target).set_value(RigidTransform(R_WB, p_WB))
        return EventStatus.Succeeded()


@dc.dataclass(frozen=True)
class _Engagement(Unchanging):
    X_WH: RigidTransform | None = None
    X_WB: RigidTransform | None = None


class WristToArm(Diagram):
    """From the tracker's wrist pose to the arm's desired state.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH of the tracker.
        valid (1): 1 tracked, 0 lost.
    Output port:
        arm_desired_state (2·na): the arm's joint positions (rad), then velocities (rad/s), plant order.

    Inside: `Clutch` → Drake's DifferentialInverseKinematicsController, which keeps to the arm's position
    and speed limits and starts at the robot's default positions. Give the root context of the diagram to
    `initialize` before simulating.

    Args:
        robot: robot and surroundings; its default positions are the start and the nominal posture.
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
        q_start = plant.GetPositions(context)
        arm_dofs, idle_dof = _dofs(plant, arm)
        q_nominal = q_start.copy()
        speed = config.joint_speed_share * plant.GetVelocityUpperLimits()
        active = np.zeros(len(q_start), bool)
        active[arm_dofs] = True
        if idle_dof is not None:
            # OSQP prints a line to stdout for every solution that meets no limit (OSQP issue 785). A
            # joint that is asked to move but held at zero speed keeps one limit met, at no effect.
            active[idle_dof] = True
            speed[idle_dof] = 0.0
            q_nominal[idle_dof] += 1.0
        inverse_kinematics = DifferentialInverseKinematicsSystem(
            recipe=_recipe(config, plant, active, speed),
            task_frame=plant.world_frame().scoped_name().get_full(),
            collision_checker=SceneGraphCollisionChecker(
                model=robot,
                robot_model_instances=[arm, hand_frame.model_instance()],
                edge_step_size=0.1,
                implicit_context_parallelism=Parallelism(False),
            ),
            active_dof=DofMask(active.tolist()),
            time_step=config.period,
            K_VX=config.pose_gain,
            Vd_TG_limit=SpatialVelocity(
                w=np.full(3, config.max_rotation_speed), v=np.full(3, config.max_translation_speed)
            ),
        )

        builder = DiagramBuilder()
        clutch = builder.AddNamedSystem("clutch", Clutch(hand_frame.CalcPoseInWorld(context), config.period))
        # Frame name → X_WB, as Drake's inverse kinematics wants it.
        poses = builder.AddNamedSystem("desired_poses", BusCreator())
        wanted = poses.DeclareAbstractInputPort(
            hand_frame.scoped_name().get_full(), AbstractValue.Make(RigidTransform())
        )
        controller = builder.AddNamedSystem(
            "differential_inverse_kinematics",
            DifferentialInverseKinematicsController(inverse_kinematics, planar_rotation_dof_indices=[]),
        )
        nominal = builder.AddNamedSystem("nominal_posture", ConstantVectorSource(q_nominal))
        start = builder.AddNamedSystem(
            "start_state", ConstantVectorSource(np.concatenate([q_start, np.zeros(plant.num_velocities())]))
        )
        to_arm = np.eye(len(q_start))[arm_dofs][:, active]
        positions = builder.AddNamedSystem("arm_positions", MatrixGain(to_arm))
        velocities = builder.AddNamedSystem("arm_velocities", MatrixGain(to_arm))
        # Without the hold, every step of the plant would solve the inverse kinematics again.
        hold = builder.AddNamedSystem("velocity_hold", ZeroOrderHold(config.period, int(active.sum())))
        both = builder.AddNamedSystem("desired_state", Multiplexer([len(arm_dofs)] * 2))
        builder.Connect(clutch.get_output_port(), wanted)
        builder.Connect(poses.get_output_port(), controller.GetInputPort("desired_poses"))
        builder.Connect(nominal.get_output_port(), controller.GetInputPort("nominal_posture"))
        builder.Connect(start.get_output_port(), controller.GetInputPort("estimated_state"))
        builder.Connect(controller.GetOutputPort("commanded_position"), positions.get_input_port())
        builder.Connect(controller.GetOutputPort("commanded_velocity"), hold.get_input_port())
        builder.Connect(hold.get_output_port(), velocities.get_input_port())
        builder.Connect(positions.get_output_port(), both.get_input_port(0))
        builder.Connect(velocities.get_output_port(), both.get_input_port(1))
        builder.ExportInput(clutch.GetInputPort("wrist_pose"), "wrist_pose")
        builder.ExportInput(clutch.GetInputPort("valid"), "valid")
        builder.ExportOutput(both.get_output_port(), "arm_desired_state")
        builder.BuildInto(self)
        self._controller, self._q_start = controller, q_start

    def initialize(self, root: Context) -> None:
        """Starts the commanded positions at the robot's default, in the root context of the diagram."""
        context = self._controller.GetMyMutableContextFromRoot(root)
        self._controller.set_initial_position(context, self._q_start)


def _dofs(plant: MultibodyPlant, arm: ModelInstanceIndex) -> tuple[np.ndarray, int | None]:
    """Positions of the arm's joints in the plant, and one position that is not the arm's, if any."""
    is_arm = np.zeros(plant.num_positions(), bool)
    for index in plant.GetJointIndices(arm):
        joint = plant.get_joint(index)
        is_arm[joint.position_start() : joint.position_start() + joint.num_positions()] = True
    others = np.flatnonzero(~is_arm)
    return np.flatnonzero(is_arm), int(others[0]) if len(others) else None


def _recipe(
    config: WristToArmConfig, plant: MultibodyPlant, active: np.ndarray, speed: np.ndarray
) -> DifferentialInverseKinematicsSystem.Recipe:
    """Follow the pose before all else, drift to the nominal posture, stay within the limits."""
    ik = DifferentialInverseKinematicsSystem
    recipe = ik.Recipe()
    recipe.AddIngredient(ik.LeastSquaresCost(ik.LeastSquaresCost.Config(cartesian_qp_weight=100.0)))
    recipe.AddIngredient(
        ik.JointCenteringCost(ik.JointCenteringCost.Config(posture_gain=config.posture_gain))
    )
    # A joint slows down over the last 0.1 rad and stops 0.01 rad before its position limit.
    margins = ik.JointVelocityLimitConstraint.Config(min_margin=0.01, influence_margin=0.1)
    unlimited = np.full(int(active.sum()), np.inf)
    limits = JointLimits(
        position_lower=plant.GetPositionLowerLimits()[active],
        position_upper=plant.GetPositionUpperLimits()[active],
        velocity_lower=-speed[active],
        velocity_upper=speed[active],
        acceleration_lower=-unlimited,
        acceleration_upper=unlimited,
    )
    recipe.AddIngredient(ik.JointVelocityLimitConstraint(margins, limits))
    return recipe
