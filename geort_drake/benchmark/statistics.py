"""Statistics of a grasp benchmark: success, time, slip and failures, with intervals and paired differences.

A completion time runs from the start to the beginning of the successful hold. A trial without success is
censored at the timeout, whenever it ended.
"""

import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import CensoredData, binomtest, bootstrap, ecdf

from geort_drake.benchmark.records import Record

# A fixed seed, so that equal results give equal intervals.
_BOOTSTRAP_RESAMPLES, _BOOTSTRAP_SEED = 4000, 0


def summarize(
    records: Sequence[Record], methods: Sequence[str], timeout: float, grips: Mapping[str, str]
) -> dict:
    """All figures of a benchmark, JSON-ready.

    Args:
        records: in any order.
        methods: in the order of the report; differences refer to the first.
        timeout: at which failures are censored, s.
        grips: object → its grip, which is its class.

    Returns:
        `reference`, `timeout_s`, `objects`; `classes`: grip → its objects; `methods`: name → `overall`,
        `classes` and `objects` → `figures`; `differences`: name of every other method → the same of
        `difference`.
    """
    records = sorted(records, key=lambda r: (r["object"], r["seed"]))
    objects = sorted({record["object"] for record in records})
    classes: dict[str, list[str]] = {grip: [] for grip in sorted({grips[name] for name in objects})}
    for name in objects:
        classes[grips[name]].append(name)
    by_method = {name: [record for record in records if record["method"] == name] for name in methods}

    def each(calculate: Callable[..., dict], *groups: Sequence[Record]) -> dict:
        """Overall, for each class and for each object."""

        def of_objects(names: Sequence[str]) -> dict:
            return calculate(*([r for r in group if r["object"] in names] for group in groups), timeout)

        return {
            "overall": calculate(*groups, timeout),
            "classes": {grip: of_objects(names) for grip, names in classes.items()},
            "objects": {name: of_objects([name]) for name in objects},
        }

    reference, *others = methods
    return {
        "reference": reference,
        "timeout_s": timeout,
        "objects": objects,
        "classes": classes,
        "methods": {name: each(figures, by_method[name]) for name in methods},
        "differences": {name: each(difference, by_method[name], by_method[reference]) for name in others},
    }


def figures(records: Sequence[Record], timeout: float) -> dict:
    """Statistics of trials of one method; None where no trial has the quantity.

    Returns:
        Numbers of `trials` and of `errors`, which are not among them; `one_time_success`, `success` and
        `tip_success`, see `proportion`; `holding`: number of successes in which each link of the hand touched
        the held object; `completion_time_s`: `restricted_mean` up to the timeout with its interval, and
        `median_of_successes`; `phase_s`: mean time in each phase; `slip_mm`: median and 95th percentile over
        trials with a lift; `drops_per_trial`; `peak_force_n`, median; `self_contact`, mean fraction of the
        time; `failures`: number of each `ending` other than success.
    """
    judged = [record for record in records if "error" not in record]
    by_object: dict[str, list[float]] = defaultdict(list)
    for record in judged:
        by_object[record["object"]].append(restricted_time(record, timeout))
    times = [record["completion_time"] for record in judged if record["success"]]
    slips = [1e3 * record["slip"] for record in judged if record["slip"] is not None]
    phases = sorted({phase for record in judged for phase in record["phase_durations"]})
    return {
        "trials": len(judged),
        "errors": len(records) - len(judged),
        "one_time_success": proportion(sum(bool(r["first_attempt"]) for r in judged), len(judged)),
        "success": proportion(sum(r["success"] for r in judged), len(judged)),
        "tip_success": proportion(sum(r["tip_success"] for r in judged), len(judged)),
        "holding": dict(Counter(link for r in judged if r["success"] for link in r["holding"]).most_common()),
        "completion_time_s": {
            "restricted_mean": mean_and_interval(list(by_object.values())),
            "median_of_successes": _median(times),
        },
        "phase_s": {
            phase.lower(): float(np.mean([r["phase_durations"].get(phase, 0.0) for r in judged]))
            for phase in phases
        },
        "slip_mm": {
            "median": _median(slips),
            "p95": float(np.percentile(slips, 95)) if slips else None,
        },
        "drops_per_trial": float(np.mean([r["drops"] for r in judged])) if judged else None,
        "peak_force_n": _median([r["peak_force"] for r in judged]),
        "self_contact": float(np.mean([r["self_contact"] for r in judged])) if judged else None,
        "failures": dict(Counter(ending(r) for r in judged if not r["success"]).most_common()),
    }


def difference(records: Sequence[Record], reference: Sequence[Record], timeout: float) -> dict:
    """A method minus the reference, over the objects and seeds that both have results for.

    Returns:
        `pairs`; `one_time_success`: mean difference with its interval, `won` and `lost`: pairs in which only
        this method or only the reference succeeded, and `p` of McNemar's exact test; `completion_time_s`:
        mean difference of the restricted times with its interval.
    """
    mine, theirs = (
        {(r["object"], r["seed"]): r for r in group if "error" not in r} for group in (records, reference)
    )
    success: dict[str, list[float]] = defaultdict(list)
    time: dict[str, list[float]] = defaultdict(list)
    for key in sorted(set(mine) & set(theirs)):
        a, b = mine[key], theirs[key]
        success[key[0]].append(float(bool(a["first_attempt"])) - float(bool(b["first_attempt"])))
        time[key[0]].append(restricted_time(a, timeout) - restricted_time(b, timeout))
    signs = [sign for strata in success.values() for sign in strata]
    won, lost = signs.count(1.0), signs.count(-1.0)
    return {
        "pairs": len(signs),
        "one_time_success": {
            **mean_and_interval(list(success.values())),
            "won": won,
            "lost": lost,
            "p": float(binomtest(won, won + lost).pvalue) if won + lost else 1.0,
        },
        "completion_time_s": mean_and_interval(list(time.values())),
    }


def ending(record: Record) -> str:
    """A trial's outcome, and after a failure the simulated person's phase, if any."""
    phase = None if record["success"] else record["operator_phase"]
    return record["outcome"] if phase is None else f"{record['outcome']} ({phase})"


def restricted_time(record: Record, timeout: float) -> float:
    """Completion time, s; the timeout for a trial without success."""
    return record["completion_time"] if record["success"] else timeout


def proportion(successes: int, trials: int) -> dict:
    """`successes`, `trials`, `rate`, and Wilson's 95 % interval `low` to `high`."""
    if trials == 0:
        return {"successes": 0, "trials": 0, "rate": None, "low": None, "high": None}
    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return {
        "successes": successes,
        "trials": trials,
        "rate": successes / trials,
        "low": float(interval.low),
        "high": float(interval.high),
    }


def mean_and_interval(strata: Sequence[Sequence[float]]) -> dict:
    """`mean` over all values, and its 95 % percentile bootstrap interval `low` to `high`.

    Values are resampled within each stratum (the trials with one object), because objects are not drawn at
    random. A stratum of one value gives no interval.
    """
    if not strata:
        return {"mean": None, "low": None, "high": None}
    mean = float(np.mean(np.concatenate(strata)))
    if min(map(len, strata)) < 2:
        return {"mean": mean, "low": None, "high": None}

    def pooled(*samples: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.concatenate(samples, axis=axis).mean(axis=axis)

    interval = bootstrap(
        [np.asarray(stratum, float) for stratum in strata],
        pooled,
        n_resamples=_BOOTSTRAP_RESAMPLES,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(_BOOTSTRAP_SEED),
    ).confidence_interval
    return {"mean": mean, "low": float(interval.low), "high": float(interval.high)}


def completed_share(records: Sequence[Record], timeout: float) -> dict[str, np.ndarray]:
    """Fraction of trials completed over time: the Kaplan-Meier estimate with its 95 % interval.

    Returns:
        `t` from 0 to the timeout, s, and `share`, `low` and `high` from `t` on, all of one length.
    """
    judged = [record for record in records if "error" not in record]
    times = [record["completion_time"] for record in judged if record["success"]]
    t = np.unique([0.0, *times, timeout])
    if not times:
        flat = np.zeros(len(t))
        high = proportion(0, len(judged))["high"]
        return {"t": t, "share": flat, "low": flat, "high": flat + (1.0 if high is None else high)}
    failed = [timeout] * (len(judged) - len(times))
    completed = ecdf(CensoredData(uncensored=times, right=failed)).cdf
    with warnings.catch_warnings():
        # Where all trials are completed the interval is NaN, which is replaced below.
        warnings.simplefilter("ignore", RuntimeWarning)
        low, high = (bound.evaluate(t) for bound in completed.confidence_interval(method="log-log"))
    share = completed.evaluate(t)
    return {
        "t": t,
        "share": share,
        "low": np.where(np.isnan(low), share, low),
        "high": np.where(np.isnan(high), share, high),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
