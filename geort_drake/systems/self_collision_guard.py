"""Moves commanded positions of the hand out of self-collision."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus
from scipy.optimize import nnls

from geort_drake.errors import HandError
from geort_drake.hands.collision import HandClearance
from geort_drake.hands.hand import Hand
from geort_drake.systems.action_correction import CorrectionConfig, PeriodicCorrection
from geort_drake.systems.joint_limits import JointLimits

_SLACK = 2e-4  # m; corrections aim at the clearance plus this
_ITERATIONS = 4
# Number of nearest pairs that are moved apart at once; most other near pairs open with them.
_PAIRS = 4


class SelfCollisionGuard(PeriodicCorrection):
    """Passes commands that are free of self-collision and moves others to nearby positions that are.

    Every output is checked: the distance between all parts of the hand that `HandClearance` compares is at
    least `clearance`. Outputs respect the limits of position and speed. If no correction is found, the
    fingers in conflict, or all fingers, keep their last positions. Acceleration is not limited: fingers may
    stop within one period. Nothing is guaranteed for the hand's measured positions, nor between two commanded
    ones, which are at most speed · period apart.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        hand_state (2n): not read.
    Output port:
        desired_state (2n): the command to the hand, same order.

    State: the positions commanded at the last update, which are clear.

    Args:
        hand: the model of the hand.
        actuated_joints: its joints in actuator order.
        initial_positions: joint name → rad, the command before the first update; by default 0.
        limits: limits of the joints, in actuator order.
        period: time between updates of the command, s.
        clearance: smallest allowed distance between parts of the hand, m, not negative.

    Raises:
        HandError: the joints are not the hand's, its collision geometry is of an unsupported kind, or the
            hand's clearance is too small at the initial positions.
        ValueError: the period or the clearance is out of range.
    """

    def __init__(
        self,
        hand: Hand,
        actuated_joints: Sequence[str],
        initial_positions: Mapping[str, float],
        limits: JointLimits,
        period: float = 0.01,
        clearance: float = 0.002,
    ):
        if set(hand.joint_names) != set(actuated_joints):
            raise HandError(
                f"the hand's joints are {', '.join(sorted(hand.joint_names))}; given: "
                f"{', '.join(sorted(actuated_joints))}"
            )
        super().__init__(actuated_joints, initial_positions, limits, period)
        CorrectionConfig("guard", clearance).validate()
        self._hand_clearance, self._clearance = HandClearance(hand, clearance, actuated_joints), clearance
        self._reach = limits.speed * period
        if (near := self._hand_clearance.near(self._q_start)).pairs:
            closest = int(near.gap.argmin())
            first, second = map(hand.link_of, near.pairs[closest])
            raise HandError(
                f"the hand must start with {1e3 * clearance:g} mm between its parts; at the initial "
                f"positions it has {1e3 * near.gap[closest]:.1f} mm between '{first}' and '{second}' (a mesh "
                "counts as its convex hull); lower the clearance or, in the hand's description, change "
                "default_positions or list the two under ignored_collisions"
            )

    def guarded(self, command: np.ndarray, clear: np.ndarray) -> np.ndarray:
        """Returns clear positions near `command`, within one step of `clear`; (n,) rad, actuator order."""
        if not np.isfinite(command).all():
            return clear
        low = np.maximum(self._limits.lower, clear - self._reach)
        high = np.minimum(self._limits.upper, clear + self._reach)
        target = np.clip(command, low, high)
        q, conflict = target, self._hand_clearance.near(target, _PAIRS)
        if not conflict.pairs:
            return q
        J, openings = conflict.gradient, self._clearance + _SLACK - conflict.gap
        for _ in range(_ITERATIONS):
            change = _smallest_change(J, openings, low - target, high - target)
            if change is None:
                break
            q = np.clip(target + change, low, high)
            near = self._hand_clearance.near(q, _PAIRS)
            if not near.pairs:
                return q
            # Pairs that come near on the way are added, linearised at the target.
            J = np.concatenate([J, near.gradient])
            opening = self._clearance + _SLACK - near.gap + near.gradient @ (q - target)
            openings = np.concatenate([openings, opening])
        # Hold the fingers in conflict, then those that would collide with the held ones.
        held = np.zeros(len(q), dtype=bool)
        while conflict.pairs:
            in_conflict = self._hand_clearance.joints_between(conflict.pairs).any(axis=0)
            if not (in_conflict & ~held).any():
                return clear
            held |= in_conflict
            q = np.where(held, clear, target)
            conflict = self._hand_clearance.near(q, _PAIRS)
        return q

    def _prerequisites(self) -> set:
        return super()._prerequisites() | {self._desired.ticket()}

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        n = len(desired) // 2
        clear = context.get_discrete_state(self._positions).value()
        q = self.guarded(desired[:n], clear)
        if np.array_equal(q, desired[:n]):
            output.SetFromVector(desired)
        else:
            output.SetFromVector(np.concatenate([q, (q - clear) / self._period]))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        output = self.get_output_port().Eval(context)
        discrete_state.get_mutable_vector(self._positions).SetFromVector(output[: len(output) // 2])
        return EventStatus.Succeeded()


def _smallest_change(
    J: np.ndarray, opening: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray | None:
    """Returns the x (n,) of least norm with J x ≥ opening (K,), or None if there is none.

    The bounds low ≤ x ≤ high are imposed where the solution without them violates them.
    """
    x = _least_norm(J, opening)
    if x is None or not ((under := x < low) | (over := x > high)).any():
        return x
    eye = np.eye(len(low))
    return _least_norm(
        np.concatenate([J, eye[under], -eye[over]]), np.concatenate([opening, low[under], -high[over]])
    )


def _least_norm(A: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Returns the x (n,) of least norm with A x ≥ b (K,), K > 0, or None if there is none.

    Least-distance programming by non-negative least squares: Lawson and Hanson 1974, "Solving Least
    Squares Problems", chapter 23.
    """
    E = np.concatenate([A.T, b[None]])
    f = np.zeros(len(E))
    f[-1] = 1.0
    try:
        u, _ = nnls(E, f)
    except RuntimeError:  # it did not converge
        return None
    r = E @ u - f
    return -r[:-1] / r[-1] if abs(r[-1]) > 1e-9 else None
