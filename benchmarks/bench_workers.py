"""Times the grasp benchmark's trials in one worker and in several.

python benchmarks/bench_workers.py --retargeter runs/allegro_right --json workers.json

Each number of workers runs the same trials in turns, in new processes; results must be equal.
  trials/min      for the whole turn, including the start of the workers
  once begun      for the trials alone: number of workers divided by the mean time of a trial
  start           time until the last worker begins its first trial
  memory          largest peak of a worker
"""

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from joblib.externals.loky import get_reusable_executor
from rich.table import Table
from side_by_side import parse, parser, worker_counts, write_json

from geort_drake.benchmark.folder import open_benchmark
from geort_drake.benchmark.trials import Trial, plan_cases, simulate
from geort_drake.benchmark.workers import call_in_workers
from geort_drake.console import console, run_main
from geort_drake.errors import GeortError
from geort_drake.people.play import synthesize_play
from geort_drake.simulation.scenario_files import load_scenario


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.set_defaults(seconds=1.0)
    options.add_argument("--retargeter", default="hold", help="method or checkpoint (default: %(default)s)")
    options.add_argument("--object", default="cylinder", help="object to grasp (default: %(default)s)")
    options.add_argument("--trials", type=int, default=16, help="trials per turn (default: %(default)s)")
    arguments = parse(options, argv)
    numbers = worker_counts()
    turns: dict[int, list[dict]] = {number: [] for number in numbers}
    wanted = None
    with tempfile.TemporaryDirectory() as folder:
        benchmark = open_benchmark(
            Path(folder) / "benchmark",
            load_scenario(),
            synthesize_play(seed=0),
            [arguments.retargeter],
            [arguments.object],
            arguments.trials,
        )
        goals = dict(plan_cases(benchmark.scenario_text, [arguments.object], 1, "loky"))
        keys = benchmark.keys(benchmark.methods, [arguments.object], arguments.trials)
        tasks = [benchmark.trial(key, goals[key.object]) for key in keys]
        end = time.perf_counter() + arguments.seconds
        while not turns[1] or time.perf_counter() < end:
            for number in numbers:
                figures, results = turn(tasks, number)
                turns[number].append(figures)
                wanted = wanted or results
                if results != wanted:
                    raise GeortError(f"results of {number} workers differ from those of one")
    report(turns, arguments)
    return 0


def turn(tasks: Sequence[Trial], workers: int) -> tuple[dict, list[dict]]:
    """Returns the figures of one turn, and the trials' results."""
    started = time.time()
    done = list(call_in_workers(measured, ((task,) for task in tasks), workers, ordered=True))
    ended = time.time()
    get_reusable_executor().shutdown()  # the next turn starts its own
    first = {process: begun for _, process, begun, _, _ in reversed(done)}
    if len(first) != workers:
        raise GeortError(f"{len(first)} of {workers} workers took part: ask for more --trials")
    took = [end - begun for _, _, begun, end, _ in done]
    figures = {
        "per_minute": 60 * len(tasks) / (ended - started),
        "per_minute_once_begun": 60 * workers / float(np.mean(took)),
        "start_s": max(first.values()) - started,
        "memory_mib": max(memory for *_, memory in done),
    }
    return figures, [{**result, "wall_time": None} for result, *_ in done]


def measured(task: Trial) -> tuple[dict, int, float, float, float]:
    """Returns a trial's result, process id, times of begin and end, s, and the process's peak memory, MiB."""
    begun = time.time()
    result = simulate(task)
    return result, os.getpid(), begun, time.time(), _memory()


def _memory() -> float:
    """Returns the peak memory of this process, MiB."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux, `getrusage` starts from the parent's peak
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def report(turns: dict[int, list[dict]], arguments: argparse.Namespace) -> None:
    """Prints a table of medians over the turns, and writes them as JSON."""
    table = Table(title=f"trials with the {arguments.object}, {arguments.retargeter}")
    for heading in ("workers", "trials/min", "over one", "once begun", "over one", "start", "memory"):
        table.add_column(heading, justify="right")
    rows = {}
    for number, found in turns.items():
        row = {name: float(np.median([each[name] for each in found])) for name in found[0]}
        for name in ("per_minute", "per_minute_once_begun"):
            ratios = [each[name] / one[name] for each, one in zip(found, turns[1], strict=True)]
            row[f"{name}_ratio"] = float(np.median(ratios))
        rows[number] = row
        table.add_row(
            str(number),
            f"{row['per_minute']:.1f}",
            f"{row['per_minute_ratio']:.2f}",
            f"{row['per_minute_once_begun']:.1f}",
            f"{row['per_minute_once_begun_ratio']:.2f}",
            f"{row['start_s']:.1f} s",
            f"{row['memory_mib']:.0f} MiB",
        )
    console.print(table)
    if arguments.json:
        write_json(arguments.json, results=rows, trials=arguments.trials, turns=len(turns[1]))


if __name__ == "__main__":
    run_main(main)
