"""Computes every figure of a benchmark from its rows: rates, times and paired differences, with intervals.

Objects and people are samples of those that one may meet, so trials with one object, or by one person, are
alike. Intervals therefore treat objects and people as clusters, and several trainings of a method as well.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest
from scipy.stats import t as student

from geort_drake.benchmark.log import RESULT, Row

LEVEL = 0.95
# What makes two trials of different methods a pair.
PAIR = ["task", "kind", "condition", "object", "person", "seed"]
CLUSTERS = ["object", "person", "training"]


class Interval(NamedTuple):
    """A mean with its 95 % interval; `low` and `high` are NaN where they cannot be estimated."""

    mean: float
    low: float
    high: float

    def text(self, form: str = "{:.0f}", scale: float = 100.0) -> str:
        """Formats the interval, such as "75 [60, 86]"; a dash without a mean."""
        if np.isnan(self.mean):
            return "–"
        mean, low, high = (form.format(scale * value) for value in self)
        return mean if np.isnan(self.low) else f"{mean} [{low}, {high}]"


def frame_of(rows: Iterable[Row]) -> pd.DataFrame:
    """Returns one row per trial; `time` is the time to success, s, and the timeout for failures.

    Trials that raised an error have it in the column `error`, and no result.
    """
    frame = pd.DataFrame(list(rows))
    # Of a benchmark whose trials all raised an error, no row has any result.
    columns = {name: None for name in (*RESULT, "error", "first_attempt", "faults", "operator_phase")}
    for column, missing in (columns | {"attainable": True}).items():
        if column not in frame:
            frame[column] = missing
    frame["time"] = frame["completion_time"].where(frame["success"] == True, frame["timeout"])  # noqa: E712
    return frame


def variance(values: np.ndarray, clusters: Sequence[np.ndarray]) -> tuple[float, float]:
    """Estimates the variance of the mean of clustered values, and its degrees of freedom.

    Each way of clustering with several groups adds the variance of the groups' sums of deviations,
    G / (G − 1) · Σ u_g² / N². The first two ways cross, so that the variance of their interaction, which both
    contain, is subtracted: E[MS_A + MS_B − MS_AB] is the variance of the mean in a balanced two-way analysis
    of variance with random effects. The degrees of freedom are Satterthwaite's. Without several groups in any
    way, values are independent.

    Args:
        values: (N,) values, at least two.
        clusters: ways of clustering, each (N,) labels.
    """
    n, deviations = len(values), values - values.mean()
    ways = [np.unique(labels, return_inverse=True)[1] for labels in clusters]
    ways = [codes for codes in ways if codes.max() > 0] or [np.arange(n)]
    terms = []
    for codes in ways:
        groups = codes.max() + 1
        sums = np.bincount(codes, deviations)
        terms.append((groups / (groups - 1) * np.sum(sums**2) / n**2, groups - 1.0))
    total = sum(term for term, _ in terms)
    freedom = [(term, df) for term, df in terms]
    if len(ways) > 1:
        first, second = ways[:2]
        shape = first.max() + 1, second.max() + 1
        df = float((shape[0] - 1) * (shape[1] - 1))
        counts, totals = np.zeros(shape), np.zeros(shape)
        np.add.at(counts, (first, second), 1.0)
        np.add.at(totals, (first, second), deviations)
        rows = totals.sum(1, keepdims=True) / counts.sum(1, keepdims=True)
        columns = totals.sum(0, keepdims=True) / counts.sum(0, keepdims=True)
        interaction = (df + sum(shape) - 1) / df * np.sum((totals - counts * (rows + columns)) ** 2) / n**2
        # A difference of estimates may fall below what a single way of clustering gives.
        largest = max(terms)
        if total - interaction > largest[0]:
            total, freedom = total - interaction, [*terms, (interaction, df)]
        else:
            total, freedom = largest[0], [largest]
    spread = sum(term**2 / df for term, df in freedom)
    return total, total**2 / spread if spread > 0 else min(df for _, df in terms)


def mean_interval(values: np.ndarray, clusters: Sequence[np.ndarray]) -> Interval:
    """Returns the mean of values and its t interval, see `variance`; equal values have none.

    The interval is at least that of independent values, because deviations may happen to cancel within every
    cluster.
    """
    if len(values) < 2 or np.ptp(values) == 0:
        return Interval(float(np.mean(values)) if len(values) else np.nan, np.nan, np.nan)
    estimates = [variance(values, clusters), variance(values, [])]
    half = max(float(student.ppf(0.5 + LEVEL / 2, df) * np.sqrt(spread)) for spread, df in estimates)
    mean = float(values.mean())
    return Interval(mean, mean - half, mean + half)


def bounded_interval(values: np.ndarray, clusters: Sequence[np.ndarray]) -> Interval:
    """Returns the mean of values from 0 to 1, such as successes, and Wilson's interval for clustered trials.

    Wilson's interval takes the number of successes and failures whose rate would have the estimated variance,
    and Student's quantile (Dean and Pagano 2015, J. Surv. Stat. Methodol. 3, 484–503). The variance is at
    least that of independent values; equal values, which have none, count as independent successes and
    failures.
    """
    n = len(values)
    if n < 2:
        return Interval(float(np.mean(values)) if n else np.nan, np.nan, np.nan)
    p, (spread, df) = float(values.mean()), variance(values, clusters)
    spread = max(spread, float(values.var()) / n)
    effective = p * (1 - p) / spread if np.ptp(values) > 0 else n
    square = float(student.ppf(0.5 + LEVEL / 2, df)) ** 2
    width = 1 + square / effective
    centre = (p + square / (2 * effective)) / width
    half = np.sqrt(square * (p * (1 - p) / effective + square / (4 * effective**2))) / width
    # The interval contains p, but for rounding.
    return Interval(p, float(np.clip(centre - half, 0.0, p)), float(np.clip(centre + half, p, 1.0)))


def time_interval(frame: pd.DataFrame, clusters: Sequence[np.ndarray]) -> Interval:
    """Returns the mean time of trials of one task, s, restricted to the timeout, and its interval."""
    timeout = float(frame["timeout"].max()) if len(frame) else np.nan
    share = bounded_interval(frame["time"].to_numpy(float) / timeout, clusters)
    return Interval(*(timeout * value for value in share))


def holm(p: Sequence[float]) -> list[float]:
    """Adjusts p-values for their number by Holm's method."""
    order, largest, result = np.argsort(p), 0.0, [1.0] * len(p)
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(p) - rank) * p[index]))
        result[index] = largest
    return result


def pairs_of(frame: pd.DataFrame, method: str, reference: str, column: str) -> pd.DataFrame:
    """Returns the unique pairs of two methods, with `difference`: method minus reference in a column.

    A method with several trainings counts with the mean over them, so that no trial is part of two pairs.
    """
    values = frame.dropna(subset=[column])
    means = values.astype({column: float}).groupby([*PAIR, "method"])[column].mean().unstack("method")
    if not {method, reference} <= set(means.columns):
        return pd.DataFrame(columns=[*PAIR, "difference"])
    means = means[[method, reference]].dropna()
    return (means[method] - means[reference]).rename("difference").reset_index()


def sign_test(differences: np.ndarray) -> tuple[int, int, float]:
    """Returns how many pairs were won and lost, and the p-value of the exact sign test.

    For single trials that succeed or fail it is McNemar's exact test.
    """
    wins, losses = int((differences > 0).sum()), int((differences < 0).sum())
    return wins, losses, float(binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0


def table(frame: pd.DataFrame, methods: Sequence[str]) -> pd.DataFrame:
    """Returns the figures of each method for the trials of one task, kind of person and condition.

    Args:
        frame: see `frame_of`.
        methods: methods in the order of the table; differences refer to the first.

    Returns:
        One row per method: `trials`; `errors`, trials that raised one; `unattainable`, trials before which
        free play showed no attainable plan; `success`, `first_attempt`, `score`, `time` (s) and `difference`,
        of success to the first method's, see `Interval`; `won`, `lost` and `p`, see `sign_test`, with Holm's
        correction for the number of methods.
    """
    judged = frame[frame["error"].isna()]
    rows, reference = [], methods[0]
    for method in methods:
        of_method = judged[judged["method"] == method]
        clusters = [of_method[name].to_numpy() for name in CLUSTERS]
        first = of_method.dropna(subset=["first_attempt"])
        pairs = (
            pairs_of(judged, method, reference, "success") if method != reference and len(of_method) else None
        )
        row = {
            "method": method,
            "trials": len(of_method),
            "errors": int((frame["method"] == method).sum()) - len(of_method),
            "unattainable": int((of_method["attainable"] == False).sum()),  # noqa: E712
            "success": bounded_interval(of_method["success"].to_numpy(float), clusters),
            "first_attempt": bounded_interval(
                first["first_attempt"].to_numpy(float), [first[name].to_numpy() for name in CLUSTERS]
            ),
            "score": bounded_interval(of_method["score"].to_numpy(float), clusters),
            "time": time_interval(of_method, clusters),
            "difference": Interval(np.nan, np.nan, np.nan),
            "won": 0,
            "lost": 0,
            "p": np.nan,
        }
        if pairs is not None and len(pairs):
            differences = pairs["difference"].to_numpy(float)
            mean, low, high = mean_interval(differences, [pairs[name] for name in ("object", "person")])
            row["difference"] = Interval(mean, *np.clip((low, high), -1.0, 1.0).tolist())
            row["won"], row["lost"], row["p"] = sign_test(differences)
        rows.append(row)
    result = pd.DataFrame(rows)
    compared = result["p"].notna()
    result.loc[compared, "p"] = holm(result.loc[compared, "p"].tolist())
    return result


def endings(frame: pd.DataFrame) -> Counter[str]:
    """Counts the outcomes of trials; those of failures name the simulated person's phase: "thrown (lift)"."""
    judged = frame[frame["error"].isna()]
    return Counter(
        outcome if success or phase is None or pd.isna(phase) else f"{outcome} ({phase})"
        for outcome, success, phase in zip(
            judged["outcome"], judged["success"], judged["operator_phase"], strict=True
        )
    )
