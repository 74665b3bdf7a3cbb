"""Corrects commands between retargeting and the hand."""

import dataclasses as dc
import math
from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.errors import HandError
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.python_system import PythonSystem
from geort_drake.systems.update_timing import check_timing

CORRECTIONS = ("none", "guard", "policy")


@dc.dataclass
class CorrectionConfig:
    """Selects the correction between retargeting and the hand."""

    # `none` passes commands unchanged; `guard`: `SelfCollisionGuard`; `policy`: `PolicyCorrection`.
    kind: str = "none"
    # Smallest distance between parts of the hand that the guard allows, m.
    clearance: float = 0.002
    # TorchScript (.pt) or ONNX (.onnx) file of the policy.
    policy: str = ""

    def validate(self) -> None:
        """Raises ValueError for a value out of range."""
        if self.kind not in CORRECTIONS:
            raise ValueError(f"correction.kind must be one of {', '.join(CORRECTIONS)}, not '{self.kind}'")
        if not (math.isfinite(self.clearance) and self.clearance >= 0):
            raise ValueError(f"correction.clearance must be finite and not negative, not {self.clearance}")
        if (self.kind == "policy") != bool(self.policy):
            raise ValueError("correction.policy must be given for kind policy, and for no other kind")


class ActionCorrection(PythonSystem):
    """Passes the desired state through; override `correct` to change it.

    A subclass could be the foundation controller of DexterityGen (Yin et al. 2025, section IV), a policy that
    turns coarse targets into safe ones. The package's own corrections have the same ports and override
    `_calc`.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        hand_state (2n): measured positions and velocities, same order; read only by an overridden `correct`.
    Output port:
        desired_state (2n): the command to the hand, same order.

    Args:
        num_joints: n.

    Raises:
        HandError: while it runs, `correct` returned another shape.
    """

    def __init__(self, num_joints: int):
        super().__init__()
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * num_joints)
        self._measured = self.DeclareVectorInputPort("hand_state", 2 * num_joints)
        self.DeclareVectorOutputPort("desired_state", 2 * num_joints, self._calc, self._prerequisites())

    def correct(self, desired_state: np.ndarray, hand_state: np.ndarray) -> np.ndarray:
        """Returns the corrected desired state (2n,) for the desired and the measured state (2n,)."""
        return desired_state

    def _prerequisites(self) -> set:
        """Returns the dependency tickets of the output port."""
        # Time is not among them, so that the output is not recomputed at each step of the plant.
        ports = [self._desired]
        if type(self).correct is not ActionCorrection.correct:
            ports.append(self._measured)
        return {port.ticket() for port in ports}

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        # Skips the hand's state, which takes time to compute, unless `correct` needs it.
        if type(self).correct is not ActionCorrection.correct:
            desired = np.asarray(self.correct(desired, self._measured.Eval(context)))
            if desired.shape != (output.size(),):
                raise HandError(f"correct must return shape ({output.size()},); it returned {desired.shape}")
        output.SetFromVector(desired)


class PeriodicCorrection(ActionCorrection):
    """Base of corrections that update at a fixed period and remember positions; override `_update`.

    State: n positions (rad), initially `initial_positions`.

    Args:
        actuated_joints: joints in actuator order.
        initial_positions: joint name → rad, the command before the first update; by default 0.
        limits: limits of the joints, in actuator order.
        period: time between updates, s, from 1e-5 to 10.

    Raises:
        HandError: the limits do not fit the joints or the initial positions.
        ValueError: the period is out of range.
    """

    def __init__(
        self,
        actuated_joints: Sequence[str],
        initial_positions: Mapping[str, float],
        limits: JointLimits,
        period: float,
    ):
        super().__init__(len(actuated_joints))
        check_timing(period)
        self._limits, self._period = limits, period
        self._q_start = limits.start(initial_positions, actuated_joints)
        self._positions = self.DeclareDiscreteState(self._q_start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _prerequisites(self) -> set:
        return {self.xd_ticket()}

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        raise NotImplementedError
