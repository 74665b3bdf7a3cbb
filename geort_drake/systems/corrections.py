"""Corrects commands between retargeting and the hand: by a policy, or by a guard against self-collision."""

import dataclasses as dc
import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus
from scipy.optimize import nnls

from geort_drake.errors import HandError, PolicyError
from geort_drake.hands.collision import HandClearance
from geort_drake.hands.hand import Hand
from geort_drake.systems.joint_limits import JointLimits, check_timing
from geort_drake.systems.python_system import PythonSystem

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

    def guard(self, command: np.ndarray, clear: np.ndarray) -> np.ndarray:
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
        is_held = np.zeros(len(q), dtype=bool)
        while conflict.pairs:
            in_conflict = self._hand_clearance.joints_between(conflict.pairs).any(axis=0)
            if not (in_conflict & ~is_held).any():
                return clear
            is_held |= in_conflict
            q = np.where(is_held, clear, target)
            conflict = self._hand_clearance.near(q, _PAIRS)
        return q

    def _prerequisites(self) -> set:
        return super()._prerequisites() | {self._desired.ticket()}

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        n = len(desired) // 2
        clear = context.get_discrete_state(self._positions).value()
        q = self.guard(desired[:n], clear)
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
    if x is None or not ((is_under := x < low) | (is_over := x > high)).any():
        return x
    eye = np.eye(len(low))
    return _least_norm(
        np.concatenate([J, eye[is_under], -eye[is_over]]),
        np.concatenate([opening, low[is_under], -high[is_over]]),
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


# Maps the hand's state (2n,) and the commanded positions (n,) to positions (n,); rad and rad/s.
Policy = Callable[[np.ndarray, np.ndarray], np.ndarray]

POLICY_FAILED = "held: the policy failed"


class PolicyCorrection(PeriodicCorrection):
    """Calls a policy at a fixed period and keeps its output finite and within the joint limits.

    `JointLimits.step` limits position, speed and acceleration. When the policy raises an exception, or
    returns another shape or values that are not finite, the joints brake and hold; the first failure issues a
    warning. Each output is computed from command and hand state just before the update, which delays commands
    by one update.

    Input ports:
        desired_state (2n): joint positions (rad), then velocities (rad/s), actuator order.
        hand_state (2n): the hand's measured positions and velocities, same order.
    Output ports:
        desired_state (2n): the command to the hand, same order.
        status (abstract str): `POLICY_FAILED` while the joints are held, else empty.

    State: the policy's last output (n), the desired state (2n), and whether the policy failed (1).

    Args:
        policy: result of `load_policy`, or any `Policy` function.
        actuated_joints: joints in the order of actuators and policy.
        initial_positions: joint name → rad, the command before the first update; by default 0.
        limits: limits of the joints, in actuator order.
        period: time between calls of the policy, s.

    Raises:
        HandError, ValueError: see `PeriodicCorrection`.
    """

    def __init__(
        self,
        policy: Policy,
        actuated_joints: Sequence[str],
        initial_positions: Mapping[str, float],
        limits: JointLimits,
        period: float = 0.01,
    ):
        super().__init__(actuated_joints, initial_positions, limits, period)
        self._n, self._policy = len(actuated_joints), policy
        self._output = self.DeclareDiscreteState(np.concatenate([self._q_start, np.zeros(self._n)]))
        self._failed = self.DeclareDiscreteState(1)
        self._warned = False
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(""),
            lambda context, output: output.set_value(
                POLICY_FAILED if context.get_discrete_state(self._failed).value()[0] else ""
            ),
            {self.discrete_state_ticket(self._failed)},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._output).value())

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        state = context.get_discrete_state(self._output).value()
        q, v = state[: self._n], state[self._n :]
        output = self._call_policy(self._measured.Eval(context), self._desired.Eval(context)[: self._n])
        if output is None:
            target = target_before = q
        else:
            target = np.clip(output, self._limits.lower, self._limits.upper)
            target_before = context.get_discrete_state(self._positions).value()
        q, v = self._limits.step(q, v, target, target_before, self._period)
        discrete_state.get_mutable_vector(self._output).SetFromVector(np.concatenate([q, v]))
        discrete_state.get_mutable_vector(self._positions).SetFromVector(target)
        discrete_state.get_mutable_vector(self._failed).SetFromVector([float(output is None)])
        return EventStatus.Succeeded()

    def _call_policy(self, hand_state: np.ndarray, target: np.ndarray) -> np.ndarray | None:
        """Returns the policy's output (n,), rad, or None if it cannot be used."""
        try:
            output = np.asarray(self._policy(hand_state, target), dtype=float)
            if output.shape != (self._n,):
                raise ValueError(f"it returned the shape {output.shape}, not {(self._n,)}")
            if not np.isfinite(output).all():
                raise ValueError("it returned values that are not finite")
        except Exception as error:  # a user's code may raise anything
            if not self._warned:
                warnings.warn(f"{POLICY_FAILED}: {error}", RuntimeWarning, stacklevel=2)
            self._warned = True
            return None
        return output


def load_policy(path: str | os.PathLike, num_joints: int) -> Policy:
    """Loads a policy from a TorchScript file (.pt, .pts) or an ONNX model (.onnx), and calls it once.

    The model takes two float32 tensors, the hand's state (1, 2n), positions then velocities, and the
    commanded positions (1, n). It returns the positions to command (1, n). Units are rad and rad/s.
    TorchScript files are programs: run only trusted ones.

    Raises:
        PolicyError: the file is missing or of another kind, or the call fails or returns another shape.
        ModuleNotFoundError: the package torch or onnxruntime is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise PolicyError(f"{path}: no such policy file")
    loaders = {".pt": _torchscript, ".pts": _torchscript, ".onnx": _onnx}
    if path.suffix not in loaders:
        raise PolicyError(f"{path}: a policy's file name ends with one of {', '.join(loaders)}")
    try:
        run = loaders[path.suffix](path)
        shape = run(np.zeros((1, 2 * num_joints), np.float32), np.zeros((1, num_joints), np.float32)).shape
    except ModuleNotFoundError:
        raise
    except Exception as error:  # torch and onnxruntime raise many types
        raise PolicyError(
            f"{path}: cannot be called with a hand state (1, {2 * num_joints}) and a target "
            f"(1, {num_joints}): {error}"
        ) from error
    if shape != (1, num_joints):
        raise PolicyError(f"{path}: the policy must return (1, {num_joints}), it returns {shape}")

    def policy(hand_state: np.ndarray, target: np.ndarray) -> np.ndarray:
        return run(hand_state[None].astype(np.float32), target[None].astype(np.float32))[0].astype(float)

    return policy


def _torchscript(path: Path) -> Policy:
    import torch

    module = torch.jit.load(str(path), map_location="cpu").eval()

    def run(hand_state: np.ndarray, target: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return module(torch.from_numpy(hand_state), torch.from_numpy(target)).numpy()

    return run


def _onnx(path: Path) -> Policy:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # waking more threads takes longer than a small network
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    state, target = (each.name for each in session.get_inputs())
    return lambda *tensors: session.run(None, dict(zip((state, target), tensors, strict=True)))[0]
