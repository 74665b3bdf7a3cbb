"""Shares work between this process and worker processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from joblib.externals.loky import ProcessPoolExecutor

from geort_drake.processes import end_with, usable_cores

Part = TypeVar("Part")
Result = TypeVar("Result")


def worthwhile_processes(parts: int, parts_in_start: int) -> int:
    """One process per core, but no more than save time, as a start takes as long as `parts_in_start`."""
    return max(1, min(usable_cores(), parts // (2 * parts_in_start)))


def shared_work(
    parts: Sequence[Part],
    here: Callable[[Part], Result],
    there: Callable[[Part], Result],
    processes: int,
    start: Callable[..., None],
    arguments: tuple,
) -> Iterator[Result]:
    """Yields the results of all parts, in order.

    Workers begin with the last part, because they start late. This process begins with the first one and
    does not wait: a result that is not ready in time, or that a worker failed to compute, is computed here.

    Args:
        parts: of the work.
        here, there: compute the same result from a part, in this process and in a worker.
        processes: how many take part, including this one.
        start: called once in every worker, with `arguments`.
        arguments: of `start`.
    """
    if processes < 2:
        yield from map(here, parts)
        return
    pool = ProcessPoolExecutor(processes - 1, initializer=_begin, initargs=(os.getpid(), start, arguments))
    futures = [pool.submit(there, part) for part in reversed(parts)][::-1]
    try:
        for part, future in zip(parts, futures, strict=True):
            given = future.done() and future.exception() is None
            yield future.result() if given else here(part)
    finally:
        for future in futures:
            future.cancel()
        pool.shutdown(wait=False)


def _begin(starter: int, start: Callable[..., None], arguments: tuple) -> None:
    end_with(starter)
    start(*arguments)
