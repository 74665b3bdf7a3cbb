"""A user's policy in the place where commands are corrected."""

import importlib
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from geort_drake.errors import PolicyError
from geort_drake.systems.action_correction import PeriodicCorrection
from geort_drake.systems.joint_limits import JointLimits

# (hand state (2n,), commanded positions (n,)) → positions (n,), rad and rad/s.
Policy = Callable[[np.ndarray, np.ndarray], np.ndarray]

POLICY_NOT_FINITE = "held: the policy's answer is not finite"
POLICY_SHAPE = "held: the policy's answer has another shape than the command"
POLICY_FAILED = "held: the policy failed"
_STATES = ("", POLICY_NOT_FINITE, POLICY_SHAPE, POLICY_FAILED)


class PolicyCorrection(PeriodicCorrection):
    """Asks a policy at a fixed period; its answers are kept finite and within the joint limits.

    Position, speed and acceleration are limited as in `JointLimits.step`. An answer that is not finite or
    of another shape is left out, and so is an exception in its place: the joints brake and hold, and the
    first time there is a warning. What comes out at an update is made of the command and the hand as they
    were just before, so commands come one update later.

    Its ports are those of `ActionCorrection`, and another output port:
        status (abstract str): why the joints are held, or empty.

    State: the policy's last answer (n), the desired state last given out (2n), and the number of the status.

    Args:
        policy: what `load_policy` returns, or any function like it.
        actuated_joints: joints in actuator order, which is the policy's.
        initial_positions: joint name → rad, the command before the first update.
        limits: of the joints, in the order of `actuated_joints`.
        period: time between two questions to the policy, s.
    """

    def __init__(
        self,
        policy: Policy,
        actuated_joints: Sequence[str],
        initial_positions: dict[str, float],
        limits: JointLimits,
        period: float = 0.01,
    ):
        super().__init__(actuated_joints, initial_positions, limits, period)
        self._n, self._policy = len(actuated_joints), policy
        self._given_out = self.DeclareDiscreteState(np.concatenate([self._q_start, np.zeros(self._n)]))
        self._status = self.DeclareDiscreteState(1)
        self._warned = False
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(""),
            lambda context, output: output.set_value(
                _STATES[int(context.get_discrete_state(self._status).value()[0])]
            ),
            {self.discrete_state_ticket(self._status)},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._given_out).value())

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        n = self._n
        state = context.get_discrete_state(self._given_out).value()
        q, v, before = state[:n], state[n:], context.get_discrete_state(self._positions).value()
        answer, status = self._ask(self._measured.Eval(context), self._desired.Eval(context)[:n])
        if answer is not None:
            answer = np.clip(answer, self._limits.lower, self._limits.upper)
        else:
            answer = before = q
        q, v = self._limits.step(q, v, answer, before, self._period)
        discrete_state.get_mutable_vector(self._given_out).SetFromVector(np.concatenate([q, v]))
        discrete_state.get_mutable_vector(self._positions).SetFromVector(answer)
        discrete_state.get_mutable_vector(self._status).SetFromVector([_STATES.index(status)])
        return EventStatus.Succeeded()

    def _ask(self, hand_state: np.ndarray, target: np.ndarray) -> tuple[np.ndarray | None, str]:
        """The policy's answer (n,), rad, and the status; None where it cannot be used."""
        try:
            answer = np.asarray(self._policy(hand_state, target), dtype=float)
        except Exception as error:  # a policy is a program of anybody's
            self._warn(f"{POLICY_FAILED}: {error}")
            return None, POLICY_FAILED
        if answer.shape != (self._n,):
            self._warn(f"{POLICY_SHAPE}: {answer.shape}, not {(self._n,)}")
            return None, POLICY_SHAPE
        if not np.isfinite(answer).all():
            self._warn(POLICY_NOT_FINITE)
            return None, POLICY_NOT_FINITE
        return answer, ""

    def _warn(self, message: str) -> None:
        if not self._warned:
            self._warned = True
            warnings.warn(message, RuntimeWarning, stacklevel=2)


def load_policy(path: str | os.PathLike, num_joints: int) -> Policy:
    """Loads a policy: a TorchScript file (.pt, .pts) or an ONNX model (.onnx).

    It is called with two float32 tensors, the hand's state (1, 2n), positions and then velocities, and the
    commanded positions (1, n), and returns the positions to command, (1, n); rad and rad/s. A TorchScript
    file is a program: run only those that you trust.

    Raises:
        PolicyError: the file is missing, of another kind or malformed; the package that runs it is not
            installed; or a trial call fails or returns another shape.
    """
    path = Path(path)
    if not path.is_file():
        raise PolicyError(f"{path}: there is no such policy file")
    loaders = {".pt": _torchscript, ".pts": _torchscript, ".onnx": _onnx}
    if path.suffix not in loaders:
        raise PolicyError(f"{path}: a policy's file name ends with one of {', '.join(loaders)}")
    run = loaders[path.suffix](path)

    def policy(hand_state: np.ndarray, target: np.ndarray) -> np.ndarray:
        return run(hand_state[None].astype(np.float32), target[None].astype(np.float32))[0].astype(float)

    try:
        given = run(np.zeros((1, 2 * num_joints), np.float32), np.zeros((1, num_joints), np.float32)).shape
    except Exception as error:  # torch and onnxruntime raise many types
        raise PolicyError(
            f"{path}: a call with a hand state (1, {2 * num_joints}) and a target (1, {num_joints}) fails: "
            f"{error}"
        ) from error
    if given != (1, num_joints):
        raise PolicyError(f"{path}: the policy must return (1, {num_joints}), it returns {given}")
    return policy


def _torchscript(path: Path) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    torch = _package("torch", path)
    try:
        module = torch.jit.load(str(path), map_location="cpu").eval()
    except (RuntimeError, ValueError) as error:
        raise PolicyError(f"{path}: not a TorchScript file: {error}") from error

    def run(hand_state: np.ndarray, target: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return module(torch.from_numpy(hand_state), torch.from_numpy(target)).numpy()

    return run


def _onnx(path: Path) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    onnxruntime = _package("onnxruntime", path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # waking more takes longer than so small a network
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base but Exception
        raise PolicyError(f"{path}: not an ONNX model: {error}") from error
    names = [item.name for item in session.get_inputs()]
    if len(names) != 2:
        raise PolicyError(
            f"{path}: the policy must take two inputs, the hand's state and the target; it takes "
            f"{len(names)}: {', '.join(names)}"
        )

    def run(hand_state: np.ndarray, target: np.ndarray) -> np.ndarray:
        return session.run(None, dict(zip(names, (hand_state, target), strict=True)))[0]

    return run


def _package(name: str, path: Path) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PolicyError(
            f"{path}: running this policy needs the package {name}: pip install {name}"
        ) from error
