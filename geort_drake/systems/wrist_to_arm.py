"""Makes the arm follow a tracked wrist: checks, clutch, inverse kinematics and motion within limits."""

import dataclasses as dc
import math

import numpy as np
from pydrake.common import Parallelism
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsSystem as DifferentialIK
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.planning import DofMask, RobotDiagram, SceneGraphCollisionChecker
from pydrake.planning import JointLimits as PlanningLimits
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    State,
)
from pydrake.systems.primitives import BusCreator, ConstantVectorSource

from geort_drake.settings import require_numbers
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.port_values import pose_to_vector
from geort_drake.systems.python_system import Freeable, PythonSystem

WRIST_JUMPED = "held: the wrist moved faster than a wrist can"
WRIST_NOT_FINITE = "held: the wrist's pose is not finite"
_WRIST_STATES = ("", WRIST_JUMPED, WRIST_NOT_FINITE)
# s; the allowed jump grows with the time between poses, up to this gap, the longest of common trackers.
_MAX_GAP = 0.04
# Faster motions are not followed; the arm could not follow them, either.
_MAX_SPEED = 3.0  # m/s
_MAX_ROTATION_SPEED = 20.0  # rad/s; a MANUS recording at 118 Hz peaks at 8
_SETTLE_TIME = 0.1  # s, for which the pose must be good before it is followed again
# m; distance of the arm's links from the surroundings, and distance from which on these count.
_SAFETY_DISTANCE, _INFLUENCE_DISTANCE = 0.01, 0.05
# s; within a time as short as the period, a link could not brake before an obstacle.
_HORIZON = 0.1
_ROUNDING = 1e-9  # s; of sums of periods


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


class WristChecks(PythonSystem):
    """Marks the wrist as lost while its pose is not finite or moves faster than a wrist can.

    After a jump, poses are compared with the new one. If the tracker stays there, it is followed again after
    the settling time; `Clutch` applies only the motion from then on.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost.
    Output ports:
        valid (1): 1 if the input `valid` is 1 and the pose can be followed.
        state (abstract str): why the pose cannot be followed, or empty, regardless of the input `valid`.

    State: a record of the last pose, when it changed, when it was last bad, and the state's number.
    """

    _FIELDS = np.dtype([("pose", float, 7), ("changed", float), ("bad_since", float), ("state", float)])

    def __init__(self, period: float):
        super().__init__()
        self._period = period
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", AbstractValue.Make(RigidTransform()))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        start = np.array([(np.full(7, math.nan), 0.0, -math.inf, 0.0)], self._FIELDS)
        self._memory = self.DeclareDiscreteState(start.view(float))
        # Computed from the present pose, so that it is checked before other systems use it.
        self.DeclareVectorOutputPort("valid", 1, self._calc_valid)
        self.DeclareAbstractOutputPort("state", lambda: AbstractValue.Make(""), self._calc_state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _judge(self, context: Context) -> np.ndarray:
        """Returns the updated record, (1,)."""
        now, X_WH = context.get_time(), self._wrist.Eval(context)
        memory = context.get_discrete_state(self._memory).value().view(self._FIELDS).copy()
        last = memory[0]
        if not np.isfinite(X_WH.GetAsMatrix34()).all():
            last["bad_since"], last["state"] = now, _WRIST_STATES.index(WRIST_NOT_FINITE)
            return memory
        pose = pose_to_vector(X_WH)
        if now - last["bad_since"] >= _SETTLE_TIME - _ROUNDING:
            last["state"] = 0
        if not np.array_equal(pose, last["pose"]):
            gap = max(min(now - last["changed"], _MAX_GAP), self._period)
            # |q · q'| is the cosine of half the angle. Before the first pose, comparisons with NaN are false.
            angle = 2.0 * math.acos(min(abs(float(pose[:4] @ last["pose"][:4])), 1.0))
            distance = float(np.linalg.norm(pose[4:] - last["pose"][4:]))
            if distance > _MAX_SPEED * gap or angle > _MAX_ROTATION_SPEED * gap:
                last["bad_since"], last["state"] = now, _WRIST_STATES.index(WRIST_JUMPED)
            last["pose"], last["changed"] = pose, now
        return memory

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.get_mutable_vector(self._memory).SetFromVector(self._judge(context).view(float))
        return EventStatus.Succeeded()

    def _state(self, context: Context) -> str:
        return _WRIST_STATES[int(self._judge(context)[0]["state"])]

    def _calc_valid(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, float(self._valid.Eval(context)[0] >= 0.5 and not self._state(context)))

    def _calc_state(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._state(context))


class Clutch(PythonSystem):
    """Applies the wrist's motion since the clutch engaged to the robot hand.

    Person and robot may start at different poses: the wrist's translation and rotation since the first valid
    sample, both measured in W, are applied to the hand's pose at that time.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH.
        valid (1): 1 tracked, 0 lost. While lost, the target is the commanded pose, from which the clutch
            engages again, so the arm never jumps after a gap.
        commanded_pose (abstract RigidTransform): X_WB commanded to the arm.
    Output port:
        hand_pose (abstract RigidTransform): X_WB, the target of the hand.
    """

    def __init__(self, X_WB_start: RigidTransform, period: float):
        super().__init__()
        pose = AbstractValue.Make(RigidTransform())
        self._wrist = self.DeclareAbstractInputPort("wrist_pose", pose)
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._commanded = self.DeclareAbstractInputPort("commanded_pose", pose)
        self._target = self.DeclareAbstractState(AbstractValue.Make(X_WB_start))
        # The poses of wrist and hand when the clutch engaged; None while it is not engaged.
        self._engagement = self.DeclareAbstractState(AbstractValue.Make(None))
        self.DeclareStateOutputPort("hand_pose", self._target)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        target = state.get_mutable_abstract_state(self._target)
        engagement = state.get_mutable_abstract_state(self._engagement)
        # Copies, because Drake overwrites the values of ports and states.
        if self._valid.Eval(context)[0] < 0.5:
            engagement.set_value(None)
            target.set_value(RigidTransform(self._commanded.Eval(context)))
            return EventStatus.Succeeded()
        X_WH = self._wrist.Eval(context)
        if engagement.get_value() is None:
            engagement.set_value((RigidTransform(X_WH), RigidTransform(self._commanded.Eval(context))))
        X_WH_start, X_WB_start = engagement.get_value()
        p_WB = X_WB_start.translation() + X_WH.translation() - X_WH_start.translation()
        R_WB = X_WH.rotation() @ X_WH_start.rotation().inverse() @ X_WB_start.rotation()
        target.set_value(RigidTransform(R_WB, p_WB))
        return EventStatus.Succeeded()


class _ArmMotion(PythonSystem):
    """Integrates joint velocities while the wrist is followed; otherwise brakes the joints and holds them.

    Input ports:
        velocity (m): velocities of the plant's active joints, rad/s.
        valid (1): 1 follow, 0 hold.
    Output ports:
        arm_desired_state (2na): the arm's commanded joint positions (rad), then velocities (rad/s).
        positions (nq): positions of all joints of the plant, rad, the arm's as commanded.
        hand_pose (abstract RigidTransform): X_WB at these positions.

    State: the values of `arm_desired_state` and `positions`.

    Args:
        plant: robot and surroundings; its default positions are the start, and inactive joints keep them.
        active: (nq,) bool, the joints of the `velocity` input.
        arm: (na,) position indices of the arm's joints; each is active.
        hand_frame: frame B of the hand.
        limits: limits of the arm's joints; braking always respects them.
        period: time between updates, s.
        limited: whether following respects the limits, too.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        active: np.ndarray,
        arm: np.ndarray,
        hand_frame: Frame,
        limits: JointLimits,
        period: float,
        limited: bool,
    ):
        super().__init__()
        self._plant, self._hand_frame = plant, hand_frame
        self._scratch = plant.CreateDefaultContext()
        positions = plant.GetPositions(self._scratch)
        self._active, self._arm = np.flatnonzero(active), arm
        self._arm_of_active = np.searchsorted(self._active, arm)
        self._limits, self._period, self._limited = limits, period, limited
        self._velocity = self.DeclareVectorInputPort("velocity", len(self._active))
        self._valid = self.DeclareVectorInputPort("valid", 1)
        self._desired = self.DeclareDiscreteState(np.concatenate([positions[arm], np.zeros(len(arm))]))
        self._positions = self.DeclareDiscreteState(positions)
        self.DeclareStateOutputPort("arm_desired_state", self._desired)
        self.DeclareStateOutputPort("positions", self._positions)
        self.DeclareAbstractOutputPort(
            "hand_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            self._calc_hand_pose,
            {self.discrete_state_ticket(self._positions)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        q, v = np.split(discrete_state.get_mutable_value(self._desired), 2)
        positions = discrete_state.get_mutable_value(self._positions)
        if self._valid.Eval(context)[0] < 0.5:
            q[:], v[:] = self._limits.step(q, v, q, q, self._period)
            positions[self._arm] = q
            return EventStatus.Succeeded()
        velocity, previous = self._velocity.Eval(context), positions[self._arm]
        positions[self._active] += self._period * velocity
        if self._limited:
            q[:], v[:] = self._limits.step(q, v, positions[self._arm], previous, self._period)
        else:
            q[:], v[:] = positions[self._arm], velocity[self._arm_of_active]
        return EventStatus.Succeeded()

    def _calc_hand_pose(self, context: Context, output: AbstractValue) -> None:
        self._plant.SetPositions(self._scratch, context.get_discrete_state(self._positions).value())
        output.set_value(self._hand_frame.CalcPoseInWorld(self._scratch))


class WristToArm(Diagram, metaclass=Freeable):
    """Turns the tracker's wrist pose into the arm's desired state.

    Input ports:
        wrist_pose (abstract RigidTransform): X_WH of the tracker; of a left hand, not mirrored.
        valid (1): 1 tracked, 0 lost: the arm brakes within its limits and holds.
    Output port:
        arm_desired_state (2·na): the arm's joint positions (rad), then velocities (rad/s), plant order.

    It consists of `Clutch`, Drake's DifferentialInverseKinematicsSystem, which keeps the arm's position and
    speed limits and its links off the surroundings, and a system that integrates its velocities from the
    robot's default positions.

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
        q_nominal = plant.GetPositions(context)
        is_arm = np.zeros(plant.num_positions(), bool)
        for index in plant.GetJointIndices(arm):
            joint = plant.get_joint(index)
            is_arm[joint.position_start() : joint.position_start() + joint.num_positions()] = True
        arm_dofs = np.flatnonzero(is_arm)
        speed = config.joint_speed_share * plant.GetVelocityUpperLimits()
        active, idle = is_arm.copy(), np.flatnonzero(~is_arm)
        if len(idle):
            # OSQP prints a line to stdout for every solution without an active limit (OSQP issue 785). A
            # joint that should move but has zero speed keeps one limit active, with no other effect.
            active[idle[0]] = True
            speed[idle[0]] = 0.0
            q_nominal[idle[0]] += 1.0
        inverse_kinematics = DifferentialIK(
            recipe=_recipe(config, plant, active, speed),
            task_frame=plant.world_frame().scoped_name().get_full(),
            collision_checker=_collision_checker(robot, arm, hand_frame),
            active_dof=DofMask(active.tolist()),
            time_step=_HORIZON,
            K_VX=config.pose_gain * _HORIZON / config.period,
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
            _ArmMotion(plant, active, arm_dofs, hand_frame, limits, config.period, limit_acceleration),
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


def _collision_checker(
    robot: RobotDiagram, arm: ModelInstanceIndex, hand_frame: Frame
) -> SceneGraphCollisionChecker:
    """Returns a checker of collisions between the arm's moving links and what does not move with the arm."""
    plant, hand = robot.plant(), hand_frame.model_instance()
    checker = SceneGraphCollisionChecker(
        model=robot,
        robot_model_instances=[arm, hand],
        edge_step_size=0.1,
        implicit_context_parallelism=Parallelism(False),
    )
    moving = plant.GetBodiesKinematicallyAffectedBy(plant.GetJointIndices(arm))
    filters = checker.GetFilteredCollisionMatrix().copy()  # set at once, as a call takes 2 ms
    for index in [*plant.GetBodyIndices(arm), *plant.GetBodyIndices(hand)]:
        # The person sees what the hand meets.
        is_checked = index in moving and plant.get_body(index).model_instance() != hand
        others = list(map(int, moving)) if is_checked else slice(None)
        filters[int(index), others] = filters[others, int(index)] = 1
    np.fill_diagonal(filters, -1)  # of each body with itself, as Drake wants
    checker.SetCollisionFilterMatrix(filters)
    return checker


def _recipe(
    config: WristToArmConfig, plant: MultibodyPlant, active: np.ndarray, speed: np.ndarray
) -> DifferentialIK.Recipe:
    """Returns a recipe that follows the pose and, in its null space, the nominal posture, within limits.

    The arm's links stay clear of the surroundings; the hand may touch things.
    """
    recipe = DifferentialIK.Recipe()
    follow = DifferentialIK.LeastSquaresCost.Config(cartesian_qp_weight=100.0)
    recipe.AddIngredient(DifferentialIK.LeastSquaresCost(follow))
    centre = DifferentialIK.JointCenteringCost.Config(posture_gain=config.posture_gain)
    recipe.AddIngredient(DifferentialIK.JointCenteringCost(centre))
    # A joint slows down within 0.1 rad of its position limit and stops 0.01 rad before it.
    margins = DifferentialIK.JointVelocityLimitConstraint.Config(min_margin=0.01, influence_margin=0.1)
    unlimited = np.full(int(active.sum()), np.inf)
    limits = PlanningLimits(
        position_lower=plant.GetPositionLowerLimits()[active],
        position_upper=plant.GetPositionUpperLimits()[active],
        velocity_lower=-speed[active],
        velocity_upper=speed[active],
        acceleration_lower=-unlimited,
        acceleration_upper=unlimited,
    )
    recipe.AddIngredient(DifferentialIK.JointVelocityLimitConstraint(margins, limits))
    distances = DifferentialIK.CollisionConstraint.Config(
        safety_distance=_SAFETY_DISTANCE, influence_distance=_INFLUENCE_DISTANCE
    )
    recipe.AddIngredient(DifferentialIK.CollisionConstraint(distances))
    return recipe
