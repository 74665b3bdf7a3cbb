"""A benchmark's workers give the same results as one process."""

import os
import signal
import subprocess
import sys
import warnings

import joblib
import numpy as np
import pytest
from grasp_setup import TOO_SHORT, allegro, human_with, judged

from geort_drake import load_scenario
from geort_drake.benchmark.log import TrialKey, key_of
from geort_drake.benchmark.workers import call_in_workers, simulate
from geort_drake.errors import BenchmarkError
from geort_drake.retargeting import METHODS
from geort_drake.simulation.trial import Trial


def trial(method: str, seed: int, scenario_text: str = TOO_SHORT) -> tuple[TrialKey, Trial]:
    """A trial of a method that needs no training, with its key."""
    scenario = load_scenario(text=scenario_text)
    scenario.random_seed = seed
    retarget = METHODS[method].fit(allegro())
    key = TrialKey(method, 0, "grasp", "servo", "", "cylinder", 0, seed)
    return key, Trial(scenario, retarget, human_with(clearance=np.inf))


@pytest.fixture(scope="module")
def short():
    """Two trials without contact, of a method without and one with a memory."""
    return [trial("hold", 0), trial("anyteleop", 1)]


@pytest.fixture(scope="module")
def alone(short):
    """Their results in this process."""
    results = [judged(simulate(*each)) for each in short]
    assert not any("error" in result for result in results)
    return results


def simulated(key: TrialKey, trial: Trial) -> tuple[int, dict]:
    """The process, and the trial's result without the time it took."""
    return os.getpid(), judged(simulate(key, trial))


def results_of(trials: list[tuple[TrialKey, Trial]], jobs: int) -> list[dict]:
    """The trials' results in their order."""
    processes, done = zip(*call_in_workers(simulated, trials, jobs), strict=True)
    assert os.getpid() not in processes
    order = [key for key, _ in trials]
    return sorted(done, key=lambda result: order.index(key_of(result)))


def test_other_processes_give_the_same_results(short, alone):
    """Bit for bit, also with a method that continues from its last answer."""
    assert results_of(short, jobs=2) == alone


@pytest.mark.slow
def test_other_processes_give_the_same_results_in_contact(short, alone):
    """Where small differences would grow."""
    quick = "operator: {peak_wrist_speed: 1.2, max_fingertip_speed: 1.5}"
    grasp = trial("anyteleop", 0, f"{{timeout: 6.0, {quick}}}")  # the object is touched after 4.3 s
    touched = judged(simulate(*grasp))
    assert {"TOUCH", "GRASP"} <= touched["phase_times"].keys() and touched["peak_force"] > 0.1
    assert results_of([grasp, *short], jobs=2) == [touched, *alone]


def test_a_dead_worker_raises_an_error():
    """Finished trials are kept, and the same command continues."""
    with pytest.raises(BenchmarkError, match=r"a worker process ended.*run the same command again"):
        list(call_in_workers(os._exit, [(1,), (1,)], 2))


def test_a_worker_loads_neither_torch_nor_plots_nor_rerun():
    code = (
        "import sys, geort_drake.benchmark.workers; "
        "from geort_drake.retargeting import affine_ik, online, store; "
        "assert not {'torch', 'matplotlib', 'pandas', 'rerun'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_nothing_global_is_changed_between_results():
    """A caller that takes one result at a time finds its own warnings filters and joblib settings."""
    filters = list(warnings.filters)
    results = call_in_workers(abs, [(-1,), (-2,)], 2)
    assert next(results) in (1, 2) and warnings.filters == filters
    assert joblib.Parallel().n_jobs == 1 and sorted(results) in ([1], [2])


WORKER = (
    "import os, time; from geort_drake.processes import end_with; "
    "end_with(os.getppid()); print(os.getpid(), flush=True); time.sleep(600)"
)
STARTER = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORKER!r}])"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_worker_ends_when_its_starter_is_killed():
    """Even by a signal that the starter cannot handle."""
    starter = subprocess.Popen([sys.executable, "-c", STARTER], stdout=subprocess.PIPE, text=True)
    worker = int(starter.stdout.readline())
    os.kill(worker, 0)
    starter.send_signal(signal.SIGKILL)
    # The worker holds the other end of the pipe for as long as it lives.
    assert starter.communicate(timeout=60.0) == ("", None)
