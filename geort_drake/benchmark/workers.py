"""Calls functions in worker processes, on this machine or on a Ray cluster, through joblib."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from typing import Any

from joblib import Parallel, delayed, parallel_config, register_parallel_backend

from geort_drake.errors import BenchmarkError, GeortError
from geort_drake.processes import end_with


def call_in_workers(
    function: Callable, arguments: Iterable[tuple], jobs: int, backend: str = "loky", ordered: bool = False
) -> Iterator[Any]:
    """Calls `function` with each of `arguments` in workers, and yields the results.

    Args:
        function: function to call; must be picklable.
        arguments: arguments of each call.
        jobs: number of simultaneous calls; a single local one runs in this process.
        backend: "loky" for local processes, "ray" for a cluster.
        ordered: whether to yield results in the order of the arguments; otherwise as they are ready.

    Raises:
        BenchmarkError: a worker ended before its call did, or see `join_cluster`.
        GeortError: Ray is not installed.
    """
    options: dict[str, Any] = {
        "inner_max_num_threads": 1,
        "initializer": end_with,
        "initargs": (os.getpid(),),
    }
    if backend == "ray":
        join_cluster(jobs)
        options = {}
    with parallel_config(backend=backend, **options):
        # Calls are long and their arguments small: dispatch singly, without memory-mapped files.
        order = "generator" if ordered else "generator_unordered"
        parallel = Parallel(jobs, return_as=order, batch_size=1, max_nbytes=None)
    try:
        yield from parallel(delayed(function)(*each) for each in arguments)
    except BrokenExecutor as error:
        raise BenchmarkError(
            "a worker process ended, perhaps because memory ran out; finished trials are kept: run the same "
            "command again, with fewer --jobs if needed"
        ) from error


def join_cluster(jobs: int) -> None:
    """Joins a Ray cluster, or starts one here, and makes it known to joblib.

    Raises:
        BenchmarkError: the cluster does not answer, or has fewer than `jobs` processors.
        GeortError: Ray is not installed.
    """
    try:
        import ray
        from ray.util.joblib.ray_backend import RayBackend
    except ImportError as error:
        raise GeortError("the backend 'ray' needs Ray: pip install 'geort-drake[ray]'") from error

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
