"""Calls functions of a network in the background during its training."""

import contextlib
import copy
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Future
from typing import Any, Self

import torch
from joblib.externals.loky import ProcessPoolExecutor
from torch import nn

from geort_drake.errors import TrainingError
from geort_drake.processes import end_with


class BackgroundProcess:
    """Calls functions of a network one after the other in another process; a context manager.

    Results are the same bit for bit without the process. A thread would slow training down by an eighth.
    """

    def __init__(self, functions: Mapping[str, Callable], separate: bool):
        """`functions`, called as function(network, ...), may keep a state between calls.

        Without `separate`, `start` calls them in this process.
        """
        self._functions, self._pool = functions, None
        if separate:
            self._pool = ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),))
            # A first call instead of an initializer's argument, which would be waited for.
            self._pool.submit(_take, functions)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def start(self, name: str, network: nn.Module, *arguments: Any) -> Future:
        """Starts a call with a copy, on the CPU, of the network as it is now.

        Raises:
            TrainingError: the process ended.
        """
        now = copy.deepcopy(network).cpu()
        if self._pool is not None:
            with _named_failure():
                return self._pool.submit(_call, name, now, *arguments)
        future: Future = Future()
        future.set_result(self._functions[name](now, *arguments))
        return future


def result_of(future: Future) -> Any:
    """The result of a call.

    Raises:
        TrainingError: its process ended.
    """
    with _named_failure():
        return future.result()


@contextlib.contextmanager
def _named_failure() -> Iterator[None]:
    try:
        yield
    except BrokenExecutor as error:
        raise TrainingError(
            "the background process of the training ended; memory may have run out"
        ) from error


_functions: dict[str, Callable] = {}  # in the background process


def _begin(starter: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the training process handles it and ends this one
    end_with(starter)
    torch.set_num_threads(1)


def _take(functions: Mapping[str, Callable]) -> None:
    _functions.update(functions)


def _call(name: str, *arguments: Any) -> Any:
    return _functions[name](*arguments)
