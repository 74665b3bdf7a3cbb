"""Long tasks in several processes, which end with the one that started them."""

import contextlib
import functools
import os
import platform
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from typing import Any

from joblib import Parallel, delayed, parallel_config, register_parallel_backend
from joblib.externals.loky import ProcessPoolExecutor

from geort_drake.benchmark.trial_sources import code_digest
from geort_drake.errors import BenchmarkError, GeortError
from geort_drake.processes import end_with

RENEWED_AFTER = 25  # tasks of a worker on a cluster; see `run_trials`


@contextlib.contextmanager
def workers(jobs: int, backend: str = "loky") -> Iterator[Callable[..., Parallel]]:
    """Yields what makes a `Parallel` of so many workers, called with joblib's `return_as`.

    Args:
        jobs: tasks at a time.
        backend: "loky", processes here; "ray", on a cluster.

    Raises:
        BenchmarkError: a worker ended before its task did; or see `require_workers`.
        GeortError: see `require_workers`.
    """
    require_workers(jobs, backend)
    options: dict = {"inner_max_num_threads": 1, "initializer": end_with, "initargs": (os.getpid(),)}
    if backend == "ray":
        options = {"maxtasksperchild": RENEWED_AFTER}
    try:
        with parallel_config(backend=backend, n_jobs=jobs, **options):
            # Tasks are long and their arguments small: one at a time, and none mapped into files.
            yield functools.partial(Parallel, batch_size=1, max_nbytes=None)
    except BrokenExecutor as error:
        raise BenchmarkError(
            "a worker process ended, perhaps for want of memory; what is finished is kept: "
            "run the same command again, with fewer --jobs perhaps"
        ) from error


def run_trials(
    function: Callable, arguments: Iterable[tuple], jobs: int, backend: str = "loky", ordered: bool = False
) -> Iterator[Any]:
    """Calls `function` with each of the arguments, in workers that run the same trials' code as this process.

    Drake 1.51 never frees a diagram with systems written in Python (RobotLocomotion/drake#24162), and a trial
    leaves 12 MB behind. So a single job has a process of its own, too: loky ends those that have grown by
    300 MB and starts others. On a cluster they are renewed by the number of their trials.

    Args:
        function, arguments: what is called.
        jobs, backend: see `workers`.
        ordered: whether results come in the order of the arguments; otherwise as they are ready.

    Raises:
        BenchmarkError, GeortError: a worker loaded other code; or see `workers`.
    """
    code = code_digest()
    tasks = ((code, function, each) for each in arguments)
    try:
        with workers(jobs, backend) as parallel, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            if jobs == 1:
                yield from _one_by_one(tasks)
            else:
                make = parallel(return_as="generator" if ordered else "generator_unordered")
                yield from make(delayed(_call)(*task) for task in tasks)
    except BenchmarkError as error:
        # A worker may have ended because code that has changed does not even load.
        if isinstance(error.__cause__, BrokenExecutor) and (now := _code_now()) != code:
            raise BenchmarkError(
                f"{error}; code_sha256: the trials' code is {now} by now, and was {code} when this run began"
            ) from error
        raise


def require_workers(jobs: int, backend: str) -> None:
    """Checks that a backend has so many workers; joins the Ray cluster, or starts one here.

    Raises:
        BenchmarkError: the cluster does not answer, or has fewer processors.
        GeortError: the backend is not installed.
    """
    if backend != "ray":
        return
    try:
        import ray
        from ray.util.joblib.ray_backend import RayBackend
    except ImportError as error:
        raise GeortError("the backend 'ray' needs Ray: pip install 'geort-drake[ray]'") from error

    class Backend(RayBackend):
        # Inherited is what holds for pools of processes; Ray's pool gives results as they come.
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
            f"--jobs {jobs}: the Ray cluster has {processors} CPUs; ask for at most as many jobs, or add "
            "machines"
        )


def _one_by_one(tasks: Iterable[tuple]) -> Iterator[Any]:
    """What `_call` gives, in another process; joblib runs a single job in this one."""
    environment = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    executor = ProcessPoolExecutor(1, initializer=end_with, initargs=(os.getpid(),), env=environment)
    try:
        for task in tasks:
            yield executor.submit(_call, *task).result()
    finally:
        executor.shutdown(kill_workers=True)


def _call(code: str, function: Callable, arguments: tuple) -> Any:
    """What a task gives, in a process that has just loaded the code, or a while ago."""
    # Workers start anew now and then, and those of a cluster are on other machines.
    if code_digest() != code:
        raise BenchmarkError(
            f"code_sha256: a worker on {platform.node()} has loaded other code of the trials than this run "
            f"began with: {code_digest()}, not {code}; what is finished is kept: put the code back and run "
            "the same command again, or choose another folder"
        )
    return function(*arguments)


def _code_now() -> str:
    try:
        return code_digest.__wrapped__()
    except (SyntaxError, OSError) as error:
        return f"none: {error}"
