"""Corrects commands by a user's policy, a TorchScript or ONNX model."""

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.errors import PolicyError
from geort_drake.systems.action_correction import PeriodicCorrection
from geort_drake.systems.joint_limits import JointLimits

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
            target = before = q
        else:
            target = np.clip(output, self._limits.lower, self._limits.upper)
            before = context.get_discrete_state(self._positions).value()
        q, v = self._limits.step(q, v, target, before, self._period)
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
