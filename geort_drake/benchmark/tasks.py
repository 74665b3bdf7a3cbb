"""Writes reports of any task, and a summary of several tasks and kinds of people.

FOLDER/TASK/KIND/    benchmark of a task with one kind of simulated person, see `folder`
FOLDER/summary.json  all figures by task, kind and method
"""

import dataclasses as dc
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from geort_drake.benchmark.config import CONFIG, TRIALS, read_config
from geort_drake.benchmark.records import Record, by_training, read_records, training_of
from geort_drake.benchmark.report import SUMMARY, write_grasp_report
from geort_drake.benchmark.statistics import axes_of, ending, mean_and_interval, proportion, table_of
from geort_drake.files import write_text
from geort_drake.simulation.task import TrialResult
from geort_drake.simulation.tasks import find_task

GRASP = "grasp"


def write_task_report(folder: Path) -> dict:
    """Writes and returns the summary of one task's folder; for grasps, see `write_grasp_report`.

    Returns:
        For tasks other than grasps: `tasks`: name → kind → result of `task_figures`; `conditions`: name →
        `methods` of that; `errors`, the number of trials that raised one; `config`.

    Raises:
        BenchmarkError: the folder contains no benchmark, or a damaged one.
    """
    config = read_config(folder)
    if task_of(config) == GRASP:
        return write_grasp_report(folder)
    records = read_records(folder / TRIALS)
    figures = task_figures(records, config)
    conditions = {
        name: task_figures(records, config, name)["methods"] for name in config.get("conditions", {})
    }
    tasks = {task_of(config): {config["settings"]["scenario"]["kind"]: figures}}
    return _write(folder, {"tasks": tasks, "conditions": conditions, "config": config})


def write_summary(folder: Path) -> dict:
    """Writes the reports of all tasks and kinds in a folder; writes and returns their summary.

    Returns:
        `tasks` and `errors`; see `write_task_report`.
    """
    tasks: dict[str, dict] = {}
    for path in sorted(folder.glob(f"*/*/{CONFIG}")):
        config = read_config(path.parent)
        write_task_report(path.parent)
        figures = task_figures(read_records(path.parent / TRIALS), config)
        tasks.setdefault(task_of(config), {})[path.parts[-2]] = figures
    return _write(folder, {"tasks": tasks})


def _write(folder: Path, summary: dict) -> dict:
    kinds = [figures for kinds in summary["tasks"].values() for figures in kinds.values()]
    summary["errors"] = sum(figures["errors"] for figures in kinds)
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def task_of(config: dict) -> str:
    """Returns the task of a benchmark's configuration."""
    return config["settings"]["scenario"].get("task", GRASP)


def task_figures(records: Iterable[Record], config: dict, condition: str = "") -> dict:
    """Returns the figures that every task has, for the trials of one condition.

    Returns:
        `errors`: number of trials that raised an error; `refused`: case → why the hand cannot do it;
        `methods`: name → `trials`; `success` and `first_attempt_success`, see `proportion`; `score`: mean
        with its interval, and `against_first`: its paired difference to the first method's;
        `completion_time_s`: median of successes; `peak_force_n`, median; `self_contact`, mean fraction of the
        time; `unattainable`: number of trials before which free play showed no attainable plan; `faults` of
        an `OwnMethod`; `endings`: number of each; and the mean of each number that the task adds to results.
    """
    chosen = [by_training(record) for record in records if record.get("condition", "") == condition]
    judged = [record for record in chosen if "error" not in record]
    order = list(dict.fromkeys(training_of(name)[0] for name in config["methods"]))
    axes = axes_of(judged)
    scores = {
        name: table_of([r for r in judged if r["method"] == name], axes, lambda r: r["score"])
        for name in order
    }
    own = [
        field.name
        for field in dc.fields(find_task(task_of(config)).result)
        if field.name not in {common.name for common in dc.fields(TrialResult)}
    ]
    return {
        "errors": len(chosen) - len(judged),
        "refused": config.get("refused", {}),
        "methods": {
            name: {
                **_figures([r for r in judged if r["method"] == name], own),
                "score": {
                    **mean_and_interval(scores[name]),
                    "against_first": None if name == order[0] else _paired(scores[name], scores[order[0]]),
                },
            }
            for name in order
        },
    }


def _figures(records: Sequence[Record], own: Sequence[str]) -> dict:
    numbers = {
        name: [r[name] for r in records if isinstance(r[name], int | float) and not isinstance(r[name], bool)]
        for name in own
    }
    times = [r["completion_time"] for r in records if r["success"]]
    return {
        "trials": len(records),
        "success": proportion(sum(r["success"] for r in records), len(records)),
        "first_attempt_success": proportion(sum(bool(r["first_attempt"]) for r in records), len(records)),
        "completion_time_s": float(np.median(times)) if times else None,
        "peak_force_n": float(np.median([r["peak_force"] for r in records])) if records else None,
        "self_contact": float(np.mean([r["self_contact"] for r in records])) if records else None,
        "unattainable": sum(not r.get("attainable", True) for r in records),
        "faults": dict(sum((Counter(r.get("faults", {})) for r in records), Counter())),
        "endings": dict(Counter(ending(r) for r in records).most_common()),
        **{name: float(np.mean(values)) for name, values in numbers.items() if values},
    }


def _paired(values: np.ndarray, reference: np.ndarray) -> dict:
    """Returns the mean difference over cases and seeds with values of both, and its interval."""
    both = ~np.isnan(values).all(axis=0) & ~np.isnan(reference).all(axis=0)
    return mean_and_interval(*(np.where(both, group, np.nan) for group in (values, reference)))
