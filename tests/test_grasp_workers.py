"""A benchmark's workers: processes here and a Ray cluster give what one process gives."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from grasp_setup import TOO_SHORT, judged, planned_goal

from geort_drake.benchmark import folder as grasp_benchmark
from geort_drake.benchmark import trial_sources, workers
from geort_drake.benchmark.folder import open_benchmark
from geort_drake.benchmark.trial import simulate
from geort_drake.benchmark.trial_log import TrialKey, key_of
from geort_drake.errors import BenchmarkError, GeortError
from geort_drake.people.play import synthesize_play
from geort_drake.simulation.scenario import load_scenario
from geort_drake.sources import PACKAGE


@pytest.fixture(scope="module")
def play():
    return synthesize_play(seed=0, duration_s=60)


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory, play):
    """One object, a method without and one with a memory."""
    folder, scenario = tmp_path_factory.mktemp("benchmark"), load_scenario(text=TOO_SHORT)
    return open_benchmark(folder, scenario, play, ["hold", "vector_online"], ["cylinder"], 2)


def run_all(benchmark, jobs: int, backend: str = "loky") -> list[dict]:
    """Every trial's line in order, and without the time it took."""
    goals = {"cylinder": planned_goal("cylinder")}
    keys = benchmark.keys(["hold", "vector_online"], ["cylinder"], 2)
    return sorted(map(judged, benchmark.run(keys, goals, jobs, backend)), key=key_of)


@pytest.fixture(scope="module")
def alone(benchmark) -> list[dict]:
    """The same lines, of trials simulated in this process."""
    goal = planned_goal("cylinder")
    keys = benchmark.keys(["hold", "vector_online"], ["cylinder"], 2)
    return sorted((judged(simulate(*benchmark.arguments(key, goal))) for key in keys), key=key_of)


@pytest.mark.parametrize("jobs", [1, 2])
def test_processes_give_what_one_process_gives(benchmark, alone, jobs):
    """Bit by bit, also for a method that remembers its last answer."""
    assert [key_of(record) for record in alone] == [
        TrialKey(method, "cylinder", seed) for method in ("hold", "vector_online") for seed in (0, 1)
    ]
    assert not any("error" in record for record in alone)
    assert run_all(benchmark, jobs) == alone


def test_a_single_job_has_a_process_that_is_renewed():
    """Drake never frees a diagram with systems in Python, so what simulates trials keeps growing."""
    used = list(workers.run_trials(_grow, ((),) * 8, 1))
    assert os.getpid() not in used and len(set(used)) > 1 and sorted(used, key=used.index) == used


@pytest.fixture(scope="module")
def grasping(tmp_path_factory, play):
    """One trial, long enough for a whole grasp by a method with a memory: the benchmark, goals and keys."""
    scenario = load_scenario(text="{timeout: 9.0, monitor: {hold_time: 0.5}}")
    folder = tmp_path_factory.mktemp("grasping")
    made = open_benchmark(folder, scenario, play, ["vector_online"], ["cylinder"], 1, zero_latency=True)
    return made, made.keys(["vector_online"], ["cylinder"], 1), {"cylinder": planned_goal("cylinder")}


@pytest.fixture(scope="module")
def grasped(grasping):
    """Its line, from this process."""
    made, keys, goals = grasping
    record = simulate(*made.arguments(keys[0], goals["cylinder"]))
    # In contact, small differences would grow.
    assert {"TOUCH", "GRASP", "LIFT"} <= record["phase_times"].keys() and record["peak_force"] > 0.1
    return judged(record)


def test_a_whole_grasp_is_the_same_in_another_process(grasping, grasped):
    """With all its contacts, to the last bit."""
    made, keys, goals = grasping
    (record,) = made.run(keys, goals, 2, "loky")
    assert judged(record) == grasped


def test_a_ray_cluster_gives_what_one_process_gives(benchmark, alone, grasping, grasped, monkeypatch):
    """On a local cluster of two workers that the test starts; a whole grasp, too."""
    ray = pytest.importorskip("ray")
    # The workers find the tests' own modules, and this package where it is not installed.
    environment = {"env_vars": {"PYTHONPATH": ":".join(map(str, sys.path)), "OMP_NUM_THREADS": "1"}}
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    ray.init(num_cpus=2, include_dashboard=False, runtime_env=environment, log_to_driver=False)
    try:
        assert run_all(benchmark, 2, "ray") == alone
        made, keys, goals = grasping
        assert [judged(record) for record in made.run(keys, goals, 2, "ray")] == [grasped]
        tasks = 2 * workers.RENEWED_AFTER + 1
        assert len(set(workers.run_trials(os.getpid, ((),) * tasks, 2, "ray"))) > 2
        with pytest.raises(BenchmarkError, match="--jobs 3: the Ray cluster has 2 CPUs"):
            run_all(benchmark, 3, "ray")
    finally:
        ray.shutdown()


def test_without_ray_the_backend_says_what_to_install(benchmark, monkeypatch):
    """The extra's name is in the message."""
    monkeypatch.setitem(sys.modules, "ray.util.joblib.ray_backend", None)
    with pytest.raises(GeortError, match=r"pip install 'geort-drake\[ray\]'"):
        run_all(benchmark, 2, "ray")


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_worker_that_dies_leaves_a_message_that_helps(benchmark, monkeypatch, jobs):
    """What is finished is kept, and one can go on."""
    monkeypatch.setattr(grasp_benchmark, "simulate", _die)
    with pytest.raises(BenchmarkError, match=r"a worker process ended.*run the same command again"):
        run_all(benchmark, jobs)


def test_a_worker_that_loaded_other_code_is_named(benchmark, monkeypatch):
    """As one that begins after the code was changed does; with what to do about it."""
    monkeypatch.setattr(workers, "code_digest", lambda: "of before")
    with pytest.raises(
        BenchmarkError, match=r"code_sha256: a worker on .* not of before; what is finished is kept"
    ):
        run_all(benchmark, 2)


def test_the_digest_covers_what_a_worker_loads_and_no_training():
    """Every module of a worker that can change a trial, and those that are imported later."""
    code = (
        "import sys, geort_drake.benchmark.trial; "
        "from geort_drake.retargeting.methods import online, trivial; "
        "import geort_drake.retargeting.methods.coupled.retargeter; "
        "print(*[m.__file__ for n, m in sys.modules.items() if n.startswith('geort_drake.') and m.__file__])"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    covered = {str(path) for path in trial_sources.trial_sources()}
    rooms = ("people", "hands", "retargeting", "simulation", "systems")
    needed = {
        path
        for path in loaded.split()
        if Path(path).relative_to(PACKAGE).parts[0] in rooms and "__init__" not in path
    } - {str(PACKAGE / "retargeting/methods/coupled/config.py")}  # of training
    assert len(needed) > 30 and needed <= covered
    names = {path.rpartition("/")[2] for path in covered}
    assert "numpy_retargeter.py" in names  # imported where a checkpoint asks for it
    assert not any("rerun" in name for name in names)
    assert not names & {"training.py", "descent.py", "losses.py", "play.py"}


_grown = []


def _grow() -> int:
    """Keeps 100 MB, and waits for as long as loky does between its looks at memory; its process."""
    _grown.append(np.ones(12_500_000))
    time.sleep(1)
    return os.getpid()


def _die(*_):
    os._exit(1)


def test_a_worker_loads_neither_torch_nor_what_draws():
    """They would cost every worker seconds and memory."""
    code = (
        "import sys, geort_drake.benchmark.trial; "
        "print([name for name in ('torch', 'matplotlib', 'rerun') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
