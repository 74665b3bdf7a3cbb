"""Runs functions in worker processes, local or on a Ray cluster, with the same code as their parent."""

import functools
import os
import platform
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from typing import Any

from joblib import Parallel, delayed, parallel_config, register_parallel_backend
from joblib.externals.loky import ProcessPoolExecutor, get_reusable_executor

from geort_drake.errors import BenchmarkError, GeortError
from geort_drake.files import source_digest
from geort_drake.processes import end_with

# Subpackages that determine a trial; learned weights have a separate digest.
_TRIAL_SUBPACKAGES = ("people", "hands", "retargeting", "simulation", "systems")


def call_in_workers(
    function: Callable, arguments: Iterable[tuple], jobs: int, backend: str = "loky", ordered: bool = False
) -> Iterator[Any]:
    """Calls `function` in workers, with each of `arguments`, and yields the results.

    Even a single job has its own process, whose end by lack of memory does not end this one.

    Args:
        function: function to call; must be picklable.
        arguments: arguments of each call.
        jobs: number of simultaneous calls.
        backend: "loky" for local processes, "ray" for a cluster.
        ordered: whether to yield results in the order of the arguments; otherwise as they are ready.

    Raises:
        BenchmarkError: a worker ended before its task did, or has loaded different code.
        BenchmarkError, GeortError: see `require_workers`.
    """
    require_workers(jobs, backend)
    options: dict = {}
    if backend != "ray":
        options = {"inner_max_num_threads": 1, "initializer": end_with, "initargs": (os.getpid(),)}
    code = code_digest()
    tasks = ((code, function, each) for each in arguments)
    try:
        with parallel_config(backend=backend, n_jobs=jobs, **options), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            order = "generator" if ordered else "generator_unordered"
            if jobs == 1:
                yield from _one_by_one(tasks)
                return
            # Tasks are long and their arguments small: dispatch singly, without memory-mapped files.
            parallel = Parallel(batch_size=1, max_nbytes=None, return_as=order)
            yield from parallel(delayed(_call)(*task) for task in tasks)
            if backend != "ray":
                get_reusable_executor(reuse=True).shutdown()
    except BrokenExecutor as error:
        message = (
            "a worker process ended, perhaps because memory ran out; finished trials are kept: run the same "
            "command again, with fewer --jobs if needed"
        )
        # Changed code that cannot be loaded is another cause.
        if (now := _code_now()) != code:
            message += f"; the code of the trials has changed: code_sha256 is now {now}, at the start {code}"
        raise BenchmarkError(message) from error


def require_backend(backend: str) -> None:
    """Raises GeortError if a backend is not installed."""
    if backend == "ray":
        try:
            import ray.util.joblib.ray_backend  # noqa: F401
        except ImportError as error:
            raise GeortError("the backend 'ray' needs Ray: pip install 'geort-drake[ray]'") from error


def require_workers(jobs: int, backend: str) -> None:
    """Checks that a backend has enough workers; joins a Ray cluster, or starts one here.

    Raises:
        BenchmarkError: the cluster does not answer, or has fewer processors.
        GeortError: the backend is not installed.
    """
    if backend != "ray":
        return
    require_backend(backend)
    import ray
    from ray.util.joblib.ray_backend import RayBackend

    class Backend(RayBackend):
        # Ray's pool yields results as they are ready, but the base class does not declare it.
        supports_return_generator = True

    register_parallel_backend("ray", Backend)
    if not ray.is_initialized():
        try:
            ray.init()
        except (ConnectionError, ValueError) as error:
            raise BenchmarkError(f"the Ray cluster does not answer: {error}") from error
    processors = int(ray.cluster_resources().get("CPU", 0))
    if jobs > processors:
        raise BenchmarkError(
            f"--jobs {jobs}: the Ray cluster has {processors} CPUs; use at most as many jobs, or add machines"
        )


@functools.cache
def code_digest() -> str:
    """SHA-256 of the code of trials as it was at this process's first call."""
    return source_digest(*_TRIAL_SUBPACKAGES)


def _one_by_one(tasks: Iterable[tuple]) -> Iterator[Any]:
    """Yields results of `_call` from one other process; joblib would run a single job in this process."""
    environment = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    executor = ProcessPoolExecutor(1, initializer=end_with, initargs=(os.getpid(),), env=environment)
    try:
        for task in tasks:
            yield executor.submit(_call, *task).result()
    finally:
        executor.shutdown(kill_workers=True)


def _call(code: str, function: Callable, arguments: tuple) -> Any:
    """Calls a function; raises BenchmarkError if this worker has loaded other code than its parent."""
    # New workers load the present code, and workers of a cluster that of other machines.
    if code_digest() != code:
        raise BenchmarkError(
            f"code_sha256: a worker on {platform.node()} has loaded different code of the trials: "
            f"{code_digest()}, not {code}; finished trials are kept: restore the code and run the same "
            "command again, or choose another folder"
        )
    return function(*arguments)


def _code_now() -> str:
    try:
        return code_digest.__wrapped__()
    except (SyntaxError, OSError) as error:
        return f"unreadable: {error}"
