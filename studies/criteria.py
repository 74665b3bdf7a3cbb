"""Asks which open-loop criteria matter in closed loop, by maps that spoil some of them.

python studies/criteria.py --output criteria

`SPOILED` names seven faults of the universal map, one per criterion, and their sizes. 48 maps have some of
them, in a fractional factorial design of two levels (2^(7−3), resolution IV) that is repeated three times
with other random axes. People of each kind do each task once through each map. The map is the unit: for
each task and kind, the effect of a criterion is estimated from the scores of the 48 maps by least squares,
beside the other criteria and the repetitions, and likewise on the mean score of each map. Holm's method
corrects p-values, for the effects on the mean score and for all others separately. Two consecutive maps
have opposite faults, so each even number of maps is balanced; the same command resumes an interrupted run.
"""

import argparse
import itertools
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from scipy.stats import t as student
from worsened import Trials, add_options, case_of, condition_of, faults_of, run_trials

from geort_drake.benchmark.analysis import frame_of, holm
from geort_drake.benchmark.log import Row, TrialKey
from geort_drake.benchmark.workers import simulate
from geort_drake.console import run_main

LEVEL = 0.05
METHOD = "universal"
REPETITIONS = 3
# Criteria, and the fault that spoils each. Sizes are about the largest differences among the methods that are
# compared, for human_alex: the gain of affine_ik's thumb is 1.6 times the universal map's, the motion
# preservation of telekinesis is the cosine of 38°, affine_ik leaves two thirds of the pinches open, and makes
# 1.5 mm of 1 mm of noise. Unevenness, the turn of distal links and the drift are guesses.
SPOILED = {
    "size": ("shrunk", 0.4),
    "direction": ("turned", 30.0),
    "evenness": ("uneven", 3.0),
    "pinches": ("gapped", 20.0),
    "posture": ("twisted", 1.6),
    "jitter": ("jittering", 1.0),
    "stillness": ("drifting", 10.0),
}


def design() -> list[dict[str, bool]]:
    """Returns which criteria each of 16 maps spoils, each map followed by its opposite.

    Four criteria take all combinations. Each other one is the product of three of them, so that no main
    effect is confounded with an interaction of two criteria.
    """
    names = list(SPOILED)
    half = [signs for signs in itertools.product((-1, 1), repeat=4) if signs[0] < 0]
    rows = []
    for signs in half:
        for a, b, c, d in (signs, tuple(-sign for sign in signs)):
            rows.append([a, b, c, d, a * b * c, b * c * d, a * c * d])
    return [{name: sign > 0 for name, sign in zip(names, row, strict=True)} for row in rows]


def keys_of(tasks: Sequence[str], kinds: Sequence[str]) -> list[TrialKey]:
    """Returns the trials, map by map; the seed of trial and map is the repetition."""
    keys = []
    for repetition in range(REPETITIONS):
        for spoiled in design():
            faults = dict(SPOILED[name] for name, is_spoiled in spoiled.items() if is_spoiled)
            keys += [
                TrialKey(METHOD, 0, task, kind, condition_of(faults), case_of(task), 0, repetition)
                for task, kind in itertools.product(tasks, kinds)
            ]
    return keys


def least_squares(
    A: np.ndarray, scores: np.ndarray, effects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fits A x = scores; `effects` is the number of the first columns that are of interest.

    Returns:
        (effects,) each: x, the half widths of its 95 % intervals, and its two-sided p-values.
    """
    freedom = len(scores) - np.linalg.matrix_rank(A)
    x, *_ = np.linalg.lstsq(A, scores, rcond=None)
    variance = float(np.square(scores - A @ x).sum()) / freedom
    deviations = np.maximum(np.sqrt(np.diag(np.linalg.pinv(A.T @ A)) * variance), 1e-12)[:effects]
    p = 2 * student.sf(np.abs(x[:effects]) / deviations, freedom)
    return x[:effects], student.ppf(0.975, freedom) * deviations, p


def effects(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns the effect of each criterion for each task and kind of people.

    Returns:
        One row per task, kind and criterion: the number of maps; the mean score without and with the fault;
        their difference `effect` with its 95 % interval from `low` to `high`; and the two-sided `p`, and
        `p_holm`.
    """
    rows = []
    faults = [fault for fault, _ in SPOILED.values()]
    for (task, kind), group in frame.groupby(["task", "kind"]):
        spoiled = np.array(
            [[fault in faults_of(name) for fault in faults] for name in group["condition"]], float
        )
        repetitions = pd.get_dummies(group["seed"]).to_numpy(float)
        A, scores = np.hstack([spoiled, repetitions]), group["score"].to_numpy(float)
        if len(scores) <= np.linalg.matrix_rank(A):
            continue
        x, half_widths, p = least_squares(A, scores, len(SPOILED))
        for number, name in enumerate(SPOILED):
            with_fault = spoiled[:, number] > 0
            rows.append(
                {
                    "task": task,
                    "kind": kind,
                    "criterion": name,
                    "maps": len(scores),
                    "without": scores[~with_fault].mean(),
                    "with": scores[with_fault].mean(),
                    "effect": x[number],
                    "low": x[number] - half_widths[number],
                    "high": x[number] + half_widths[number],
                    "p": p[number],
                }
            )
    table = pd.DataFrame(rows)
    if len(table):
        table["p_holm"] = holm(table["p"].tolist())
    return table


def overall(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns the effects on the mean score over all tasks and kinds, as `effects` does, of complete maps."""
    scores = frame.pivot(index=["condition", "seed"], columns=["task", "kind"], values="score").dropna()
    means = scores.mean(axis=1).rename("score").reset_index()
    return effects(means.assign(task="all", kind="all"))


def report(rows: Iterable[Row]) -> str:
    """Returns the effects in Markdown: points of score that a criterion costs where it is spoiled."""
    frame = frame_of(rows)
    frame = frame[frame["error"].isna()]
    table = pd.concat([overall(frame), effects(frame)])
    cases = [(task, kind) for (task, kind), _ in table.groupby(["task", "kind"])]
    titles = ["all" if task == "all" else f"{task}, {kind}" for task, kind in cases]
    lines = [
        "| criterion | " + " | ".join(titles) + " |",
        "|---" * (len(cases) + 1) + "|",
    ]
    for name, group in table.groupby("criterion", sort=False):
        cells = []
        for row in group.sort_values(["task", "kind"]).itertuples():
            text = f"{100 * row.effect:+.0f} [{100 * row.low:+.0f}, {100 * row.high:+.0f}]"
            cells.append(f"**{text}**" if row.p_holm < LEVEL else text)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    maps = table.groupby(["task", "kind"])["maps"].first().tolist()
    lines += ["", f"Maps: {min(maps, default=0)} to {max(maps, default=0)} for each task and kind."]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", default=["pick_place", "keys", "cap"], metavar="TASK")
    parser.add_argument("--kinds", nargs="+", default=["adaptive", "mimicry", "servo"], metavar="KIND")
    add_options(parser)
    arguments = parser.parse_args(argv)
    keys = keys_of(arguments.tasks, arguments.kinds)
    run_trials(simulate, keys, report, arguments, Trials(arguments.hand))
    return 0


if __name__ == "__main__":
    run_main(main)
