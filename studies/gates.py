"""Validates tasks before methods are compared by them: which task reveals bad maps, to which kind of person?

python studies/gates.py --tasks keys --output gates

A scripted robot must succeed in at least 90 % of the trials, and a hand that holds still in at most 5 %.
Then people of each kind do the task through maps of three families, and through copies of each with faults
of known sizes. `FAMILIES` and `SIZES` state maps, faults and sizes, before anything runs, in the order in
which they are tried. A fault is revealed if scores fall as it grows: Kendall's tau must be positive in a
permutation test within seeds, with p < 0.05 after Holm's correction. A task speaks for a kind of person if
it reveals a fault of at least two families.

Each task and kind is a claim of its own, so the correction is for the fifteen tests that decide it. A family
gets no further faults once one is revealed, and the third family runs only if the first two do not suffice;
tests that do not run count with p = 1, which can only hide faults. `--all` runs all of them. Trials are rows
of trials.jsonl, as in a benchmark; the same command resumes an interrupted run, and adds tasks. The scripted
robots are in `studies/scripted`.
"""

import argparse
import importlib
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import permutation_test
from worsened import Trials, add_options, case_of, condition_of, run_trials

from geort_drake.benchmark.analysis import frame_of, holm
from geort_drake.benchmark.log import Row, TrialKey, key_of
from geort_drake.benchmark.workers import simulate
from geort_drake.console import run_main
from geort_drake.hands.description import load_hand
from geort_drake.simulation.person.engine import KINDS
from geort_drake.simulation.trial import Trial

FAMILIES = ("affine_ik", "universal", "geort")
LEVEL = 0.05
# The sizes of each fault, from small to large, with the reason for some. Own fingertips move by about 50 mm
# either way. A squeeze that is turned by more than 39° leaves the friction cone at the mean friction of 0.8.
# A press of 8 mm moves the other, mixed fingers by 1 to 3 mm.
SIZES = {
    "shrunk": (0.5, 0.75, 0.875),
    "jittering": (1.0, 2.0, 4.0),
    "turned": (20.0, 40.0, 60.0),
    "gapped": (10.0, 20.0, 30.0),
    "mixed": (0.25, 0.5, 0.75),
}


def scripted_keys(tasks: Sequence[str], seeds: int) -> list[TrialKey]:
    """Returns the trials of the scripted robot and of the hand that holds still."""
    kind = next(iter(KINDS))
    return [
        TrialKey(name, 0, task, kind, "", case_of(task), 0, seed)
        for seed, task, name in itertools.product(range(seeds), tasks, ("scripted", "hold"))
    ]


def keys_of(task: str, kind: str, family: str, faults: Iterable[str], seeds: int) -> list[TrialKey]:
    """Returns the trials through a map and its copies, seed by seed, so that every prefix is balanced."""
    conditions = ["", *(condition_of({name: size}) for name in faults for size in SIZES[name])]
    return [
        TrialKey(family, 0, task, kind, condition, case_of(task), 0, seed)
        for seed, condition in itertools.product(range(seeds), conditions)
    ]


def next_keys(rows: Sequence[Row], tasks: Sequence[str], kinds: Sequence[str], seeds: int) -> list[TrialKey]:
    """Returns the trials that can still decide whether a task speaks for a kind; none if all is decided."""
    tests, finished = tests_of(frame_of(rows)), {key_of(row) for row in rows}
    keys = []
    for task, kind in itertools.product(tasks, kinds):
        of_claim = (tests["task"] == task) & (tests["kind"] == kind)
        revealed = set(tests.loc[of_claim & tests["revealed"], "family"])
        undecided = []
        for family in FAMILIES:
            trials = [keys_of(task, kind, family, [fault], seeds) for fault in SIZES]
            remaining = [group for group in trials if not finished.issuperset(group)]
            if family not in revealed and remaining:
                undecided.append(remaining[0])
        keys += undecided[: max(2 - len(revealed), 0)]
    return [key for group in itertools.zip_longest(*keys) for key in group if key is not None]


def run(key: TrialKey, trial: Trial) -> Row:
    """Returns the row of a trial."""
    if key.method != "scripted":
        return simulate(key, trial)
    robot = importlib.import_module(f"scripted.{key.task}")
    plan = robot.plans(trial.scenario, load_hand(trial.scenario.hand))[0]
    score = robot.scripted(trial.scenario, plan, key.seed)
    result = {"success": score > 0, "score": score, "completion_time": None, "outcome": "scripted"}
    return {**key._asdict(), **result, "timeout": trial.scenario.timeout}


def tau(*scores: np.ndarray, axis: int = -1) -> np.ndarray:
    """Returns Kendall's tau-a of scores of each map, with trials along an axis, expected best first."""
    pairs = itertools.combinations(scores, 2)
    return np.mean([np.sign(better - worse).mean(axis) for better, worse in pairs], axis=0)


def ordering(scores: np.ndarray) -> tuple[float, float]:
    """Returns tau of scores (seeds, maps), expected best first, and its p-value against no order.

    Scores are permuted within seeds.
    """
    if len(scores) < 2:  # too few for a test
        return np.nan, 1.0
    options: Any = {"permutation_type": "samples", "alternative": "greater", "vectorized": True, "rng": 0}
    return float(tau(*scores.T)), float(permutation_test(scores.T, tau, **options).pvalue)


def tests_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns a row per task, kind, family and fault: mean scores by size, seeds, tau, and p by Holm."""
    rows = []
    columns = ["task", "kind", "family", "fault", "seeds", "score", "tau", "p", "p_holm", "revealed"]
    if frame.empty:
        return pd.DataFrame(columns=columns)
    people = frame[frame["error"].isna() & frame["method"].isin(FAMILIES)]
    for (task, kind, family), group in people.groupby(["task", "kind", "method"], sort=False):
        scores = group.pivot(index="seed", columns="condition", values="score")
        for name, sizes in SIZES.items():
            conditions = ["", *(condition_of({name: size}) for size in sizes)]
            table = scores.reindex(columns=conditions).dropna().to_numpy(float)
            if len(table) == 0:
                continue
            order, p = ordering(table)
            means = ", ".join(f"{100 * mean:.0f}" for mean in table.mean(axis=0))
            rows.append((task, kind, family, name, len(table), means, order, p))
    tests = pd.DataFrame(rows, columns=columns[:-2])
    number = len(FAMILIES) * len(SIZES)
    tests["p_holm"] = tests.groupby(["task", "kind"])["p"].transform(
        lambda p: holm([*p, *[1.0] * (number - len(p))])[: len(p)]
    )
    tests["revealed"] = tests["p_holm"] < LEVEL
    return tests


def report(rows: Iterable[Row]) -> str:
    """Returns the gates of all tasks in Markdown."""
    frame = frame_of(rows)
    frame = frame[frame["error"].isna()]
    lines = ["| task | scripted robot | hold |", "|---|---|---|"]
    for task, group in frame.groupby("task"):
        cells = (group.loc[group["method"] == name, "success"] for name in ("scripted", "hold"))
        lines.append(f"| {task} | " + " | ".join(f"{cell.sum()} of {len(cell)}" for cell in cells) + " |")
    tests = tests_of(frame)
    lines += [
        "",
        "| task | kind | family | fault | seeds | score, % | τ | p (Holm) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for test in tests.itertuples():
        p = f"**{test.p_holm:.3g}**" if test.revealed else f"{test.p_holm:.2g}"
        names = f"{test.task} | {test.kind} | {test.family} | {test.fault}"
        lines.append(f"| {names} | {test.seeds} | {test.score} | {test.tau:.2f} | {p} |")
    return "\n".join([*lines, "", verdicts(tests)])


def verdicts(tests: pd.DataFrame) -> str:
    """Returns in Markdown which faults of each family a task reveals, and whether it speaks for a kind."""
    families = " | ".join(f"`{family}`" for family in FAMILIES)
    lines = [f"| task | kind | {families} | speaks |", f"|---|---|{'---|' * len(FAMILIES)}---|"]
    for (task, kind), group in tests.groupby(["task", "kind"], sort=False):
        cells = []
        for family in FAMILIES:
            of_family = group[group["family"] == family]
            revealed = ", ".join(of_family.loc[of_family["revealed"], "fault"])
            cells.append(revealed or ("none" if len(of_family) else "not tried"))
        speaks = group.loc[group["revealed"], "family"].nunique() >= 2
        lines.append(f"| {task} | {kind} | {' | '.join(cells)} | {'yes' if speaks else 'no'} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ["grasp", "pick_place", "peg", "keys", "cap"]
    parser.add_argument("--tasks", nargs="+", default=names, choices=names, help="default: all")
    parser.add_argument("--kinds", nargs="+", default=["adaptive", "mimicry", "servo"], metavar="KIND")
    parser.add_argument("--seeds", type=int, default=4, help="seeds of each map and kind of person")
    parser.add_argument(
        "--scripted-seeds", type=int, default=20, help="seeds of scripted robot and still hand"
    )
    add_options(parser)
    parser.add_argument("--all", action="store_true", help="run all faults of all families")
    arguments = parser.parse_args(argv)
    tasks, kinds, seeds = arguments.tasks, arguments.kinds, arguments.seeds
    trials, keys = Trials(arguments.hand), scripted_keys(tasks, arguments.scripted_seeds)
    if arguments.all:
        for task, kind, family in itertools.product(tasks, kinds, FAMILIES):
            keys += keys_of(task, kind, family, SIZES, seeds)
    else:
        keys += next_keys([], tasks, kinds, seeds)
    while keys:
        rows = run_trials(run, keys, report, arguments, trials)
        keys = next_keys(rows, tasks, kinds, seeds)
    return 0


if __name__ == "__main__":
    run_main(main)
