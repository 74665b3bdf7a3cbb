"""The seam between retargeting and the hand, where a controller may correct what is asked of it."""

import dataclasses as dc
import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.update_timing import check_timing

CORRECTIONS = ("none", "guard", "policy")


@dc.dataclass
class CorrectionConfig:
    """What stands between retargeting and the hand."""

    # none passes commands on; guard keeps the hand clear of itself (SelfCollisionGuard); policy asks the
    # model in `policy` (PolicyCorrection).
    kind: str = "none"
    # Least distance between the hand's parts that the guard allows, m.
    clearance: float = 0.002
    # TorchScript (.pt) or ONNX (.onnx) file of the policy.
    policy: str = ""

    def validate(self) -> None:
        """Raises ValueError for values that cannot work."""
        if self.kind not in CORRECTIONS:
            raise ValueError(f"correction.kind must be one of {', '.join(CORRECTIONS)}, not '{self.kind}'")
        if not (math.isfinite(self.clearance) and self.clearance >= 0):
            raise ValueError(f"correction.clearance must be finite and not negative, not {self.clearance}")
        if (self.kind == "policy") != bool(self.policy):
            raise ValueError("correction.policy must be given with kind policy, and only then")


class ActionCorrection(LeafSystem):
    """Passes the desired state on; a subclass overrides `correct`.

    It stands where DexterityGen puts its foundation controller (Yin et al. 2025, section IV): a policy
    that sees the hand and turns coarse targets into safe, dexterous ones. `NoCorrection`,
    `SelfCollisionGuard` and `PolicyCorrection` have the same ports; they override `_calc` in place of
    `correct`, and say in `_depends_on` what their output is made of.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        hand_state (2n): the hand's measured positions and velocities, same order.
    Output port:
        desired_state (2n): what the hand is asked for, same order.
    """

    def __init__(self, num_joints: int):
        super().__init__()
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * num_joints)
        self._measured = self.DeclareVectorInputPort("hand_state", 2 * num_joints)
        self.DeclareVectorOutputPort("desired_state", 2 * num_joints, self._calc, self._depends_on())

    def correct(self, desired_state: np.ndarray, hand_state: np.ndarray) -> np.ndarray:
        """Returns the corrected desired state (2n,); the base class changes nothing."""
        return desired_state

    def _depends_on(self) -> set:
        """The tickets of what the output has to be computed anew for."""
        return {self.all_sources_ticket()}

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.correct(self._desired.Eval(context), self._measured.Eval(context)))


class NoCorrection(ActionCorrection):
    """Passes commands on without a look at the hand, so not anew at each step of the plant.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        hand_state (2n): not read; every correction has it.
    Output port:
        desired_state (2n): the same as comes in.
    """

    def _depends_on(self) -> set:
        return {self.input_port_ticket(self._desired.get_index())}

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._desired.Eval(context))


class PeriodicCorrection(ActionCorrection):
    """Sets up what corrects at a fixed period and remembers positions; a subclass adds `_update`.

    State: n positions (rad), the initial ones at first.

    Args:
        actuated_joints: joints in actuator order.
        initial_positions: joint name → rad, the command before the first update.
        limits: of the joints, in the order of `actuated_joints`.
        period: time between updates, s, from 1e-5 to 10.

    Raises:
        ValueError: the period is none of these.
    """

    def __init__(
        self,
        actuated_joints: Sequence[str],
        initial_positions: dict[str, float],
        limits: JointLimits,
        period: float,
    ):
        super().__init__(len(actuated_joints))
        check_timing(period)
        self._limits, self._period = limits, period
        self._q_start = np.array([initial_positions[name] for name in actuated_joints])
        self._positions = self.DeclareDiscreteState(self._q_start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _depends_on(self) -> set:
        return {self.xd_ticket()}

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        raise NotImplementedError


def make_correction(
    config: CorrectionConfig,
    description: HandDescription,
    actuated_joints: Sequence[str],
    initial_positions: dict[str, float],
    limits: JointLimits,
    period: float,
) -> ActionCorrection:
    """The correction that `config` asks for; the arguments are those of `SelfCollisionGuard`.

    Raises:
        HandError: the guard cannot keep this hand clear; see there.
        PolicyError: the policy cannot be run.
    """
    # Only here, because these modules build on this one.
    if config.kind == "guard":
        from geort_drake.systems.self_collision_guard import SelfCollisionGuard

        hand = HandModel(description)
        return SelfCollisionGuard(hand, actuated_joints, initial_positions, limits, period, config.clearance)
    if config.kind == "policy":
        from geort_drake.systems.policy_correction import PolicyCorrection, load_policy

        policy = load_policy(config.policy, len(actuated_joints))
        return PolicyCorrection(policy, actuated_joints, initial_positions, limits, period)
    return NoCorrection(len(actuated_joints))
