"""Long tasks in several processes, which end with the one that started them."""

import contextlib
import functools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor

from joblib import Parallel, parallel_config, register_parallel_backend

from geort_drake.errors import BenchmarkError, GeortError
from geort_drake.processes import end_with


@contextlib.contextmanager
def workers(jobs: int, backend: str = "loky") -> Iterator[Callable[..., Parallel]]:
    """Yields what makes a `Parallel` of so many workers, called with joblib's `return_as`.

    Raises:
        BenchmarkError: a worker ended before its task did.
        GeortError: the backend is not installed.
    """
    options: dict = {"inner_max_num_threads": 1, "initializer": end_with, "initargs": (os.getpid(),)}
    if backend == "ray":
        options = {}
        _register_ray()
    try:
        with parallel_config(backend=backend, n_jobs=jobs, **options):
            # Tasks are long and their arguments small: one at a time, and none mapped into files.
            yield functools.partial(Parallel, batch_size=1, max_nbytes=None)
    except BrokenExecutor as error:
        raise BenchmarkError(
            "a worker process ended, perhaps for want of memory; what is finished is kept: "
            "run the same command again, with fewer --jobs perhaps"
        ) from error


def _register_ray() -> None:
    try:
        from ray.util.joblib.ray_backend import RayBackend
    except ImportError as error:
        raise GeortError("the backend 'ray' needs Ray: pip install 'geort-drake[ray]'") from error

    class Backend(RayBackend):
        # Inherited is what holds for pools of processes; Ray's pool gives results as they come.
        supports_return_generator = True

    register_parallel_backend("ray", Backend)
