"""The seam between retargeting and the hand, where a controller may correct what is asked of it."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem


class ActionCorrection(LeafSystem):
    """Passes the desired state on; a subclass overrides `correct`.

    It stands where DexterityGen puts its foundation controller (Yin et al. 2025, section IV): a policy
    that sees the hand and turns coarse targets into safe, dexterous ones.

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
        self.DeclareVectorOutputPort("desired_state", 2 * num_joints, self._calc)

    def correct(self, desired_state: np.ndarray, hand_state: np.ndarray) -> np.ndarray:
        """Returns the corrected desired state (2n,); the base class changes nothing."""
        return desired_state

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.correct(self._desired.Eval(context), self._measured.Eval(context)))
