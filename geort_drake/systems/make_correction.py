"""Makes the correction that a configuration selects."""

from collections.abc import Sequence

from geort_drake.hands.description import HandDescription
from geort_drake.hands.model import HandModel
from geort_drake.systems.action_correction import ActionCorrection, CorrectionConfig
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.policy_correction import PolicyCorrection, load_policy
from geort_drake.systems.self_collision_guard import SelfCollisionGuard


def make_correction(
    config: CorrectionConfig,
    description: HandDescription,
    actuated_joints: Sequence[str],
    initial_positions: dict[str, float],
    limits: JointLimits,
    period: float,
) -> ActionCorrection:
    """Returns the selected correction for a hand; for the other arguments see `SelfCollisionGuard`.

    Raises:
        HandError: the guard cannot be used with this hand, see `SelfCollisionGuard`.
        PolicyError: the policy cannot be run.
    """
    if config.kind == "guard":
        hand = HandModel(description)
        return SelfCollisionGuard(hand, actuated_joints, initial_positions, limits, period, config.clearance)
    if config.kind == "policy":
        policy = load_policy(config.policy, len(actuated_joints))
        return PolicyCorrection(policy, actuated_joints, initial_positions, limits, period)
    return ActionCorrection(len(actuated_joints))
