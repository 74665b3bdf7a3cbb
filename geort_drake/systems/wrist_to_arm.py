"""Makes the arm follow a tracked wrist."""

import dataclasses as dc

import numpy as np
from pydrake.common import Parallelism
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsSystem
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.planning import DofMask, RobotDiagram, SceneGraphCollisionChecker
from pydrake.planning import JointLimits as PlanningLimits
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import BusCreator, ConstantVectorSource

from geort_drake.settings import require_numbers
from geort_drake.systems.arm_motion import ArmMotion
from geort_drake.systems.clutch import Clutch
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.python_system import Freeable


@dc.dataclass
class WristToArmConfig:
    """Gains and limits with which the arm follows the wrist."""

    # Period of the differential inverse kinematics, s.
    period: float = 0.01
    # Fraction of the pose error that is corrected in one period; below 1 it smooths the tracker's noise.
    pose_gain: float = 0.3
    # Largest commanded speed of the hand, m/s and rad/s.
    max_translation_speed: float = 0.6
    max_rotation_speed: float = 2.5
    # Usable fraction of the arm's joint speed limits.
    joint_speed_share: float = 0.9
    # Gain towards the starting posture in the arm's null space, 1/s.
    posture_gain: float = 0.5

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        require_numbers(self, "wrist_to_arm")
        if self.joint_speed_share > 1:
            raise ValueError(
                f"wrist_to_arm.joint_speed_share must be at most 1, not {self.joint_speed_share}"
            )


class WristToArm(Diagram, metaclass=Freeable):
    """Turns the tracker's wrist pose into the arm's desired state.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH of the tracker; of a left hand, not mirrored.
        valid (1): 1 tracked, 0 lost: the arm brakes within its limits and holds.
    Output port:
        arm_desired_state (2·na): the arm's joint positions (rad), then velocities (rad/s), plant order.

    It consists of `Clutch`, Drake's DifferentialInverseKinematicsSystem, which keeps the arm's position and
    speed limits, and `ArmMotion`, which starts at the robot's default positions.

    Args:
        robot: robot and surroundings; its default positions are the start and the nominal posture.
        arm: the model in `robot` whose joints move; other joints stay at their default.
        hand_frame: the frame B of `robot` that follows the wrist.
        config: gains and limits, such as `geort_drake.systems.wrist_to_arm.WristToArmConfig()`.
        limit_acceleration: whether following respects the model's acceleration limits too; real robots need
            that.
    """

    def __init__(
        self,
        robot: RobotDiagram,
        arm: ModelInstanceIndex,
        hand_frame: Frame,
        config: WristToArmConfig,
        limit_acceleration: bool = False,
    ):
        super().__init__()
        config.validate()
        plant = robot.plant()
        context = plant.CreateDefaultContext()
        q_start = plant.GetPositions(context)
        is_arm = np.zeros(plant.num_positions(), bool)
        for index in plant.GetJointIndices(arm):
            joint = plant.get_joint(index)
            is_arm[joint.position_start() : joint.position_start() + joint.num_positions()] = True
        arm_dofs = np.flatnonzero(is_arm)
        q_nominal = q_start.copy()
        speed = config.joint_speed_share * plant.GetVelocityUpperLimits()
        active, idle = is_arm.copy(), np.flatnonzero(~is_arm)
        if len(idle):
            # OSQP prints a line to stdout for every solution without an active limit (OSQP issue 785). A
            # joint that should move but has zero speed keeps one limit active, with no other effect.
            active[idle[0]] = True
            speed[idle[0]] = 0.0
            q_nominal[idle[0]] += 1.0
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

        # A model without acceleration limits can stop from full speed within a period.
        limits = JointLimits(
            plant.GetPositionLowerLimits()[arm_dofs],
            plant.GetPositionUpperLimits()[arm_dofs],
            speed[arm_dofs],
            np.minimum(plant.GetAccelerationUpperLimits()[arm_dofs], speed[arm_dofs] / config.period),
        )

        builder = DiagramBuilder()
        clutch = builder.AddNamedSystem("clutch", Clutch(hand_frame.CalcPoseInWorld(context), config.period))
        # Drake's inverse kinematics takes a bus of frame name → X_WB.
        poses = builder.AddNamedSystem("desired_poses", BusCreator())
        target = poses.DeclareAbstractInputPort(
            hand_frame.scoped_name().get_full(), AbstractValue.Make(RigidTransform())
        )
        builder.AddNamedSystem("differential_inverse_kinematics", inverse_kinematics)
        nominal = builder.AddNamedSystem("nominal_posture", ConstantVectorSource(q_nominal))
        motion = builder.AddNamedSystem(
            "arm_motion",
            ArmMotion(
                plant,
                q_start,
                active,
                arm_dofs,
                hand_frame,
                limits,
                config.period,
                limit_acceleration,
            ),
        )
        builder.Connect(clutch.get_output_port(), target)
        builder.Connect(poses.get_output_port(), inverse_kinematics.GetInputPort("desired_cartesian_poses"))
        builder.Connect(nominal.get_output_port(), inverse_kinematics.GetInputPort("nominal_posture"))
        builder.Connect(motion.GetOutputPort("positions"), inverse_kinematics.GetInputPort("position"))
        builder.Connect(inverse_kinematics.get_output_port(), motion.GetInputPort("velocity"))
        builder.Connect(motion.GetOutputPort("hand_pose"), clutch.GetInputPort("commanded_pose"))
        builder.ExportInput(clutch.GetInputPort("wrist_pose"), "wrist_pose")
        builder.ExportInput(clutch.GetInputPort("valid"), "valid")
        builder.ConnectInput("valid", motion.GetInputPort("valid"))
        builder.ExportOutput(motion.GetOutputPort("arm_desired_state"), "arm_desired_state")
        builder.BuildInto(self)


def _recipe(
    config: WristToArmConfig, plant: MultibodyPlant, active: np.ndarray, speed: np.ndarray
) -> DifferentialInverseKinematicsSystem.Recipe:
    """Returns a recipe that follows the pose and, in its null space, the nominal posture, within limits."""
    ik = DifferentialInverseKinematicsSystem
    recipe = ik.Recipe()
    recipe.AddIngredient(ik.LeastSquaresCost(ik.LeastSquaresCost.Config(cartesian_qp_weight=100.0)))
    recipe.AddIngredient(
        ik.JointCenteringCost(ik.JointCenteringCost.Config(posture_gain=config.posture_gain))
    )
    # A joint slows down within 0.1 rad of its position limit and stops 0.01 rad before it.
    margins = ik.JointVelocityLimitConstraint.Config(min_margin=0.01, influence_margin=0.1)
    unlimited = np.full(int(active.sum()), np.inf)
    limits = PlanningLimits(
        position_lower=plant.GetPositionLowerLimits()[active],
        position_upper=plant.GetPositionUpperLimits()[active],
        velocity_lower=-speed[active],
        velocity_upper=speed[active],
        acceleration_lower=-unlimited,
        acceleration_upper=unlimited,
    )
    recipe.AddIngredient(ik.JointVelocityLimitConstraint(margins, limits))
    return recipe
