"""Which open-loop criteria matter for what a person can do: effects, prediction, and verdicts.

The unit of analysis is the map: trials of one map are alike, so each counts only through the map's mean over
the cases and seeds that it shares with the other maps. With all trials done, this is the linear mixed model
with random maps and fixed seeds.
"""

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from geort_drake.benchmark.config import CONFIG, TRIALS, read_config
from geort_drake.benchmark.records import Record, read_records
from geort_drake.benchmark.statistics import restricted_time
from geort_drake.console import print_table, say
from geort_drake.files import finite_json, write_text
from studies.distorted_map import FACTORS

POINTS, PERCENT = 5.0, 10.0  # of score, and of time: smaller effects do not matter
KINDS, TASKS = 3, 2  # in which a criterion must matter
SPLITS = 200  # random halves of the maps


class Criterion(NamedTuple):
    """An open-loop figure, the factor of the design that spoils it, and whether more of it is better."""

    label: str
    factor: str
    value: Callable[[Mapping[str, Any]], float]
    more: bool


CRITERIA = (
    Criterion("motion preservation", "rotation", lambda m: m["figures"]["motion_preservation"], True),
    Criterion("log gain p95/p5", "gain", lambda m: _log(m["figures"]["gain_p95_p5"]), False),
    Criterion("cross-talk", "cross_talk", lambda m: m["figures"]["cross_talk"], False),
    Criterion("pinches closed", "gap", lambda m: m["figures"]["pinch"]["closed"], True),
    Criterion("coverage at 10 mm", "reach", lambda m: m["figures"]["coverage"]["10mm"], True),
    Criterion("log flatness", "ripple", lambda m: _log(m["figures"]["flatness"]), False),
    Criterion("latency, s", "latency", lambda m: m["latency"], False),
)


def _log(value: float | None) -> float:
    return math.nan if not value else math.log(value)


class MapMeans(NamedTuple):
    """Means of maps, corrected for which trials each has.

    Attributes:
        means: (n,) per map, NaN without trials.
        reliability: share of the variance of `means` that repeats with other seeds, which is the largest R²
            that any predictor can have; NaN if no map has two trials.
    """

    means: np.ndarray
    reliability: float


def map_means(table: np.ndarray) -> MapMeans:
    """Fits map + column to a table (maps, columns of cases and seeds), NaN where there is no trial."""
    rows, columns = np.nonzero(~np.isnan(table))
    present = np.unique(rows)
    values = table[rows, columns]
    X = np.hstack([rows[:, None] == present, columns[:, None] == np.unique(columns)[1:]]).astype(float)
    solution, _, rank, _ = np.linalg.lstsq(X, values, rcond=None)
    effects = solution[: len(present)]
    means = np.full(len(table), np.nan)
    means[present] = effects - effects.mean() + values.mean()
    freedom = len(values) - int(rank)
    if freedom < 1 or len(present) < 2:
        return MapMeans(means, math.nan)
    noise = float(((values - X @ solution) ** 2).sum()) / freedom
    variance = float(effects.var(ddof=1))
    shared = noise * float(np.mean(1.0 / np.bincount(rows)[present]))
    return MapMeans(means, max(0.0, 1.0 - shared / variance) if variance > 0 else 0.0)


def main_effects(levels: np.ndarray, means: np.ndarray) -> list[dict[str, float]]:
    """Differences between the levels 1 and −1 of each factor, with 95 % intervals.

    Args:
        levels: (n, k) from −1 to 1.
        means: (n,) of the maps, NaN without trials.

    Returns:
        `effect`, `low` and `high` of each factor; NaN with too few maps.
    """
    known = ~np.isnan(means)
    X = np.hstack([np.ones((known.sum(), 1)), levels[known]])
    count, size = X.shape
    if count <= size or np.linalg.matrix_rank(X) < size:
        return [dict.fromkeys(("effect", "low", "high"), math.nan)] * levels.shape[1]
    solution, _, _, _ = np.linalg.lstsq(X, means[known], rcond=None)
    variance = float(((means[known] - X @ solution) ** 2).sum()) / (count - size)
    margin = student.ppf(0.975, count - size) * np.sqrt(variance * np.diag(np.linalg.inv(X.T @ X)))
    return [
        {"effect": 2 * float(b), "low": 2 * float(b - m), "high": 2 * float(b + m)}
        for b, m in zip(solution[1:], margin[1:], strict=True)
    ]


def explained(X: np.ndarray, y: np.ndarray, train: np.ndarray, test: np.ndarray) -> float:
    """R² on the rows `test` of a linear model of y (n,) on X (n, k) that is fitted to the rows `train`."""
    ones = np.ones((len(X), 1))
    A = np.hstack([ones, X])
    solution, _, _, _ = np.linalg.lstsq(A[train], y[train], rcond=None)
    spread = float(((y[test] - y[test].mean()) ** 2).sum())
    return 1.0 - float(((y[test] - A[test] @ solution) ** 2).sum()) / spread if spread > 0 else math.nan


def halves(X: np.ndarray, y: np.ndarray, seed: int = 0) -> float:
    """Median over random halves of the rows of R² on the other half."""
    rng, rows = np.random.default_rng(seed), np.arange(len(y))
    drawn = [rng.permutation(rows) for _ in range(SPLITS)]
    return float(np.nanmedian([explained(X, y, d[: len(y) // 2], d[len(y) // 2 :]) for d in drawn]))


def dominance(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """General dominance (k,): what each column of X adds to R², averaged over all subsets of the others.

    Subsets of one size are averaged first (Azen and Budescu 2003), so the sum is R² of all columns.
    """
    count, rows = X.shape[1], np.arange(len(y))
    subsets = [s for n in range(count + 1) for s in itertools.combinations(range(count), n)]
    share = {s: explained(X[:, list(s)], y, rows, rows) for s in subsets}

    def added(k: int, size: int) -> float:
        return float(np.mean([share[tuple(sorted((*s, k)))] - share[s]
                              for s in subsets if len(s) == size and k not in s]))  # fmt: skip

    return np.array([np.mean([added(k, size) for size in range(count)]) for k in range(count)])


def threshold(X: np.ndarray, y: np.ndarray, column: int, more: bool) -> dict[str, float] | None:
    """Where y stops rising with one column of X, the others held.

    Fits y linearly to X, in which x of the column is min(x, c), or max(x, c) where less is better.

    Returns:
        `at`: the best c, and its 95 % likelihood interval `low` to `high`; None if a straight line fits as
        well.
    """
    rows, clip = np.arange(len(y)), (np.minimum if more else np.maximum)
    candidates = np.quantile(X[:, column], np.linspace(0.1, 0.9, 33))
    lost = []
    for c in candidates:
        bent = X.copy()
        bent[:, column] = clip(X[:, column], c)
        lost.append(1.0 - explained(bent, y, rows, rows))
    straight, best = 1.0 - explained(X, y, rows, rows), min(lost)
    allowed = math.exp(3.84 / len(y))  # χ² of one parameter
    if not straight > best * allowed:
        return None
    inside = np.flatnonzero(np.array(lost) <= best * allowed)
    # As wide as the candidates are apart.
    low, high = candidates[max(inside[0] - 1, 0)], candidates[min(inside[-1] + 1, len(candidates) - 1)]
    return {"at": float(candidates[int(np.argmin(lost))]), "low": float(low), "high": float(high)}


def answer(points: Mapping[str, float], percent: Mapping[str, float]) -> str:
    """Whether a factor does harm in one cell: "worse", "better", "no", or "open" where intervals are wide.

    Args:
        points: its main effect on the score, of 100.
        percent: on the time, %.
    """
    harm = [(-points["effect"], -points["high"], -points["low"], POINTS)]
    harm += [(percent["effect"], percent["low"], percent["high"], PERCENT)]
    for effect, low, high, limit in harm:
        if effect > limit and low > 0:
            return "worse"
        if effect < -limit and high < 0:
            return "better"
    within = all(-limit < low and high < limit for _, low, high, limit in harm)
    return "no" if within else "open"


def verdict(answers: Mapping[str, Mapping[str, str]]) -> str:
    """The verdict about one criterion from the answers by task and kind of person.

    "matters" where it does harm for all three kinds on two tasks; "operator-dependent" where kinds disagree
    on a task; "unsupported" where every answer is no, on two tasks with three kinds; else "open".
    """
    complete = {task: set(kinds.values()) for task, kinds in answers.items() if len(kinds) >= KINDS}
    if sum(given == {"worse"} for given in complete.values()) >= TASKS:
        return "matters"
    if any(len(set(kinds.values()) - {"open"}) > 1 for kinds in answers.values()):
        return "operator-dependent"
    everywhere = {each for kinds in answers.values() for each in kinds.values()}
    return "unsupported" if len(complete) >= TASKS and everywhere == {"no"} else "open"


def tables(records: Sequence[Record], names: Sequence[str], timeout: float) -> tuple[np.ndarray, np.ndarray]:
    """Scores of 100, and logarithms of times, (maps, columns of cases and seeds)."""
    judged = [record for record in records if "error" not in record]
    columns = sorted({(record["object"], record["seed"]) for record in judged})
    scores = np.full((len(names), len(columns)), np.nan)
    times = scores.copy()
    for record in judged:
        place = names.index(record["method"]), columns.index((record["object"], record["seed"]))
        scores[place] = 100.0 * record["score"]
        times[place] = math.log(restricted_time(record, timeout))
    return scores, times


def analyse(
    cells: Mapping[tuple[str, str], tuple[np.ndarray, np.ndarray]], maps: Mapping[str, Mapping]
) -> dict:
    """Everything that the trials say.

    Args:
        cells: task and kind → scores and times, see `tables`; rows as in `maps`.
        maps: name → `levels` of designed ones, `figures`, None where not measured yet, and `latency`.

    Returns:
        `cells`: "task kind" → `trials`, `maps`, `reliability` of score and time, `halves`, the median R² on
        unseen halves, `others`, R² on other maps of a fit to designed ones, and `criteria`: label →
        `points`, `percent`, `dominance`, `threshold` and `answer`; `verdicts`: label → `verdict`;
        `largest_correlation` of two criteria among designed maps.
    """
    designed = np.array([each.get("levels") is not None for each in maps.values()])
    levels = np.array([each["levels"] for each in maps.values() if each.get("levels") is not None], float)
    figures = np.array(
        [[c.value(each) if each["figures"] else math.nan for c in CRITERIA] for each in maps.values()]
    )
    X = (figures - np.nanmean(figures, axis=0)) / np.nanstd(figures, axis=0)
    result: dict[str, Any] = {"cells": {}, "verdicts": {}}
    answers: dict[str, dict[str, dict[str, str]]] = {criterion.label: {} for criterion in CRITERIA}
    for (task, kind), (scores, times) in cells.items():
        score, spent = map_means(scores), map_means(times)
        known = ~np.isnan(score.means) & ~np.isnan(X).any(axis=1)
        x, y, rows = X[known], score.means[known], np.arange(known.sum())
        points = main_effects(levels, score.means[designed])
        percent = [
            {name: 100.0 * math.expm1(value) for name, value in effect.items()}
            for effect in main_effects(levels, spent.means[designed])
        ]
        enough = len(y) > 2 * (len(CRITERIA) + 1) and np.ptp(y) > 0
        shares = dominance(x, y) if enough else np.full(len(CRITERIA), np.nan)
        criteria = {}
        for column, criterion in enumerate(CRITERIA):
            place = FACTORS.index(criterion.factor)
            given = answer(points[place], percent[place])
            answers[criterion.label].setdefault(task, {})[kind] = given
            criteria[criterion.label] = {
                "points": points[place],
                "percent": percent[place],
                "dominance": float(shares[column]),
                "threshold": threshold(figures[known], y, column, criterion.more) if enough else None,
                "answer": given,
            }
        result["cells"][f"{task} {kind}"] = {
            "trials": int((~np.isnan(scores)).sum()),
            "maps": len(y),
            "mean_score": float(np.nanmean(scores)),
            "reliability": {"score": score.reliability, "time": spent.reliability},
            "halves": halves(x, y) if enough else math.nan,
            "others": explained(x, y, rows[designed[known]], rows[~designed[known]]) if enough else math.nan,
            "criteria": criteria,
        }
    result["verdicts"] = {label: verdict(given) for label, given in answers.items()}
    measured = X[designed & ~np.isnan(X).any(axis=1)]
    correlated = np.abs(np.corrcoef(measured, rowvar=False)) - np.eye(len(CRITERIA))
    result["largest_correlation"] = float(correlated.max())
    return result


def write_analysis(folder: Path, maps_path: Path) -> dict:
    """Analyses the trials in a folder, writes analysis.json, and prints a table; see `analyse`."""
    maps = json.loads(maps_path.read_text())
    names, cells = list(maps), {}
    for path in sorted(folder.glob(f"*/*/{CONFIG}")):
        records = [r for r in read_records(path.with_name(TRIALS)) if "error" not in r]
        if records:
            timeout = read_config(path.parent)["settings"]["scenario"]["timeout"]
            cells[path.parts[-3], path.parts[-2]] = tables(records, names, timeout)
    result = analyse(cells, maps)
    write_text(folder / "analysis.json", json.dumps(finite_json(result), indent=1) + "\n")
    rows = []
    for criterion in CRITERIA:
        row = [criterion.label, result["verdicts"][criterion.label]]
        for cell in result["cells"].values():
            of = cell["criteria"][criterion.label]
            effect = "{effect:+.0f} [{low:+.0f}, {high:+.0f}]"
            row.append(f"{effect.format(**of['points'])}; {of['percent']['effect']:+.0f} % ({of['answer']})")
        rows.append(row)
    print_table(("spoilt criterion", "verdict", *result["cells"]), rows, "Points of score; time")
    for name, cell in result["cells"].items():
        say(f"{name}: " + ", ".join(f"{key} {cell[key]}" for key in cell if key != "criteria"))
    return result
