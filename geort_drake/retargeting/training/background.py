"""What a descent asks about the map as it is, in a process of its own or here."""

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


class Beside:
    """Calls functions of a map, one call after the other; used as a context manager.

    Threads would wait for each other's Python, which costs a descent about an eighth of its time. The results
    are the same bit for bit in a process and here.
    """

    def __init__(self, functions: Mapping[str, Callable], process: bool):
        """Takes what is called as function(network, ...), by name.

        A function may keep a state from call to call; in a process it is a copy's.
        """
        self._functions, self._pool = functions, None
        if process:
            self._pool = ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),))
            # As a first call, which is not waited for, unlike what an initializer is given.
            self._pool.submit(_take, functions)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def start(self, name: str, network: nn.Module, *arguments: Any) -> Future:
        """Begins to call a function of a copy, on the CPU, of the network as it is now.

        Raises:
            TrainingError: the process ended.
        """
        now = copy.deepcopy(network).cpu()
        if self._pool is not None:
            with _process_named():
                return self._pool.submit(_call, name, now, *arguments)
        future: Future = Future()
        future.set_result(self._functions[name](now, *arguments))
        return future


def result_of(future: Future) -> Any:
    """What the call gave.

    Raises:
        TrainingError: its process ended.
    """
    with _process_named():
        return future.result()


@contextlib.contextmanager
def _process_named() -> Iterator[None]:
    try:
        yield
    except BrokenExecutor as error:
        raise TrainingError(
            "the process that prepares the batches of training ended, perhaps for want of memory"
        ) from error


_functions: dict[str, Callable] = {}  # of a process that takes part


def _begin(starter: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the descent is interrupted, and ends this process
    end_with(starter)
    torch.set_num_threads(1)


def _take(functions: Mapping[str, Callable]) -> None:
    _functions.update(functions)


def _call(name: str, *arguments: Any) -> Any:
    return _functions[name](*arguments)
