"""From the tracker on a person's wrist to the arm that carries the robot hand."""

import dataclasses as dc

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsController,
    DifferentialInverseKinematicsSystem,
)
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.planning import (
    DofMask,
    JointLimits,
    RobotDiagram,
    SceneGraphCollisionChecker,
)
from pydrake.systems.framework import (
    BusValue,
    Context,
    Diagram,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
)
from pydrake.systems.primitives import AffineSystem, ConstantVectorSource, Multiplexer


@dc.dataclass
class WristToArmConfig:
    """How the arm follows the wrist."""

    # Period of the differential inverse kinematics, s.
    period: float = 0.01
    # Share of the pose error that one step takes back; below 1 it smooths the tracker's noise.
    pose_gain: float = 0.3
    # Largest commanded speed of the hand, m/s and rad/s.
    max_translation_speed: float = 0.6
    max_rotation_speed: float = 2.0
    # Gain of the pull towards the nominal posture in the arm's null space, 1/s.
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
        desired_poses (abstract BusValue): frame name → X_WB.
    """

    def __init__(self, frame_name: str, X_WB_start: RigidTransform, period: float):
        super().__init__()
        self._frame_name = frame_name
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._target = self.DeclareAbstractState(AbstractValue.Make(X_WB_start))
        # None until engaged, else the wrist's and the hand's pose at that moment.
        self._engaged = self.DeclareAbstractState(AbstractValue.Make(_Engagement()))
        self.DeclareAbstractOutputPort(
            "desired_poses",
            lambda: AbstractValue.Make(BusValue()),
            self._calc,
            {self.abstract_state_ticket(self._target)},
        )
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

    def _calc(self, context: Context, output) -> None:
        bus = output.get_mutable_value()
        target = context.get_abstract_state(self._target).get_value()
        bus.Set(self._frame_name, AbstractValue.Make(target))


@dc.dataclass(frozen=True)
class _Engagement:
    X_WH: RigidTransform | None = None
    X_WB: RigidTransform | None = None


def make_wrist_to_arm(
    robot: RobotDiagram,
    arm: ModelInstanceIndex,
    hand_frame: Frame,
    config: WristToArmConfig,
) -> Diagram:
    """Builds the diagram from the tracker's wrist pose to the arm's desired state.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH of the tracker.
        valid (1): 1 tracked, 0 lost.
        arm_state (2·na): the arm's measured positions (rad) and velocities (rad/s), plant order.
    Output port:
        arm_desired_state (2·na): joint positions (rad), then velocities (rad/s), plant order.

    Inside: `Clutch` → Drake's DifferentialInverseKinematicsController, which respects the arm's
    position and velocity limits.

    Args:
        robot: robot and surroundings; its default positions are the start and the nominal posture.
        arm: the model in `robot` whose joints move; everything else stays at its default.
        hand_frame: the frame of `robot` that follows the wrist, the hand base B.
    """
    plant = robot.plant()
    q_start = plant.GetPositions(plant.CreateDefaultContext())
    context = plant.CreateDefaultContext()
    X_WB = hand_frame.CalcPoseInWorld(context)
    frame_name = hand_frame.scoped_name().get_full()
    moves = [False] * plant.num_positions()
    for index in plant.GetJointIndices(arm):
        joint = plant.get_joint(index)
        for dof in range(joint.position_start(), joint.position_start() + joint.num_positions()):
            moves[dof] = True
    active = np.flatnonzero(moves)
    num_arm = len(active)

    ik = DifferentialInverseKinematicsSystem
    recipe = ik.Recipe()
    recipe.AddIngredient(ik.LeastSquaresCost(ik.LeastSquaresCost.Config(cartesian_qp_weight=100.0)))
    recipe.AddIngredient(
        ik.JointCenteringCost(ik.JointCenteringCost.Config(posture_gain=config.posture_gain))
    )
    recipe.AddIngredient(
        ik.JointVelocityLimitConstraint(
            ik.JointVelocityLimitConstraint.Config(min_margin=0.01, influence_margin=0.1),
            JointLimits(plant=plant, active_dof=DofMask(moves)),
        )
    )
    speed = SpatialVelocity(
        w=np.full(3, config.max_rotation_speed), v=np.full(3, config.max_translation_speed)
    )
    checker = SceneGraphCollisionChecker(
        model=robot, robot_model_instances=[arm, hand_frame.model_instance()], edge_step_size=0.1
    )
    system = ik(
        recipe=recipe,
        task_frame=plant.world_frame().scoped_name().get_full(),
        collision_checker=checker,
        active_dof=DofMask(moves),
        time_step=config.period,
        K_VX=config.pose_gain,
        Vd_TG_limit=speed,
    )
    builder = DiagramBuilder()
    clutch = builder.AddNamedSystem("clutch", Clutch(frame_name, X_WB, config.period))
    controller = builder.AddNamedSystem(
        "differential_inverse_kinematics",
        DifferentialInverseKinematicsController(system, planar_rotation_dof_indices=[]),
    )
    nominal = builder.AddNamedSystem("nominal_posture", ConstantVectorSource(q_start))
    # The controller wants the whole robot's state: the arm's as measured, the rest at its default.
    selector = np.zeros((2 * len(moves), 2 * num_arm))
    selector[active, np.arange(num_arm)] = 1
    selector[len(moves) + active, num_arm + np.arange(num_arm)] = 1
    default = np.concatenate([np.where(moves, 0.0, q_start), np.zeros(len(moves))])
    none = np.zeros((0, 0))
    state = builder.AddNamedSystem(
        "robot_state",
        AffineSystem(
            A=none,
            B=np.zeros((0, 2 * num_arm)),
            f0=np.zeros(0),
            C=np.zeros((2 * len(moves), 0)),
            D=selector,
            y0=default,
        ),
    )
    both = builder.AddNamedSystem("desired_state", Multiplexer([num_arm, num_arm]))
    builder.Connect(clutch.GetOutputPort("desired_poses"), controller.GetInputPort("desired_poses"))
    builder.Connect(nominal.get_output_port(), controller.GetInputPort("nominal_posture"))
    builder.Connect(controller.GetOutputPort("commanded_position"), both.get_input_port(0))
    builder.Connect(controller.GetOutputPort("commanded_velocity"), both.get_input_port(1))
    builder.ExportInput(clutch.GetInputPort("wrist_pose"), "wrist_pose")
    builder.ExportInput(clutch.GetInputPort("valid"), "valid")
    builder.Connect(state.get_output_port(), controller.GetInputPort("estimated_state"))
    builder.ExportInput(state.get_input_port(), "arm_state")
    builder.ExportOutput(both.get_output_port(), "arm_desired_state")
    diagram = builder.Build()
    diagram.set_name("wrist_to_arm")
    return diagram
