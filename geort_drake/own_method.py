"""Runs a user's own retargeting method, a Python file with a function `make(hand)`."""

import importlib.util
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from geort_drake.errors import MethodError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.hand import Hand

MAX_CALL_TIME = 0.3  # s, longest duration of a call
_TOLERANCE = 2e-3  # rad; optimisers may end slightly outside the limits


class OwnMethod:
    """Calls the retargeter from a user's file; its faults do not end a trial.

    The file defines `make(hand)`, which takes the `Hand` and returns a function from keypoints p_HK
    (21, 3) of a right hand, m in H, to joint angles (n,), rad, in the order of `hand.joint_names`. `make` is
    called for each trial, with the same `Hand`, so the function may remember earlier frames. Unusable outputs
    become NaN, which `RetargetingSystem` does not follow; angles outside the limits are clamped to them.

    Attributes:
        finger_names, joint_names, lower, upper: fingers and joints of the hand, and the joints' limits, rad.
        faults: kind of fault → number of outputs since `reset`.
    """

    def __init__(self, path: Path, hand: Hand):
        self._path, self._hand = path, hand
        self.finger_names, self.joint_names = hand.finger_names, hand.joint_names
        self.lower, self.upper = hand.lower, hand.upper
        self.reset()

    def __reduce__(self) -> tuple:
        return _for_description, (self._path, self._hand.description)  # solvers cannot be pickled

    def reset(self) -> None:
        """Begins a new trial."""
        self._retarget: Callable[[np.ndarray], Any] | None = None
        self.faults: Counter[str] = Counter()

    def check(self, p_HK: np.ndarray) -> None:
        """Checks the method on a frame, called twice because the first call warms up.

        Raises:
            MethodError: the file has no `make`, the method raised an exception, its output is unusable, or
                the call took longer than `MAX_CALL_TIME`; the message names the file.
        """
        self.reset()
        try:
            self._retarget_frame(p_HK)
            start = time.perf_counter()
            q = self._retarget_frame(p_HK)
            duration = time.perf_counter() - start
        except MethodError:
            raise
        except (Exception, SystemExit) as error:
            raise MethodError(f"{self._path}: raised {type(error).__name__}: {error}") from error
        if fault := self._fault(q):
            expected = f"joint angles ({len(self.lower)},), rad, within the limits"
            raise MethodError(f"{self._path}: the output for a frame must be {expected}; it is {fault}")
        if duration > MAX_CALL_TIME:
            raise MethodError(
                f"{self._path}: a call may take at most {MAX_CALL_TIME} s; it takes {duration:.2g} s"
            )

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        """Returns joint angles (n,), rad, or (N, n) for hands (N, 21, 3), which the method gets in order.

        Angles are clamped to the limits; they are NaN if the output is unusable.
        """
        if np.ndim(p_HK) == 3:
            return np.array([self(frame) for frame in p_HK]).reshape(-1, len(self.lower))
        try:
            q = self._retarget_frame(p_HK)
        except (Exception, SystemExit) as error:  # a method may raise anything; the trial records it
            fault, q = f"raised {type(error).__name__}", np.empty(0)
        else:
            fault = self._fault(q)
        if fault:
            self.faults[fault] += 1
        if q.shape != self.lower.shape:
            return np.full(len(self.lower), np.nan)
        return np.clip(q, self.lower, self.upper)  # NaN stays

    def _retarget_frame(self, p_HK: np.ndarray) -> np.ndarray:
        if self._retarget is None:
            make = getattr(_load(self._path), "make", None)
            if not callable(make):
                raise MethodError(f"{self._path}: the file must define a function make(hand)")
            retarget = make(self._hand)
            if not callable(retarget):
                raise MethodError(
                    f"{self._path}: make(hand) must return a function; it returned {retarget!r}"
                )
            self._retarget = retarget
        return np.asarray(self._retarget(np.array(p_HK, float)), float)

    def _fault(self, q: np.ndarray) -> str:
        if q.shape != self.lower.shape:
            return f"of shape {q.shape}"
        if not np.isfinite(q).all():
            return "not finite"
        outside = (q < self.lower - _TOLERANCE) | (q > self.upper + _TOLERANCE)
        return "outside the limits" if outside.any() else ""


def _for_description(path: Path, description: HandDescription) -> OwnMethod:
    return OwnMethod(path, Hand(description))


def _load(path: Path) -> Any:
    name = f"geort_drake_method_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # holds for files whose name ends with .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module
