"""Computes a benchmark's statistics: success, time, slip and failures, with intervals and differences.

The completion time is from the start to the beginning of the successful hold. A trial without success is
censored at the timeout, whenever it ended.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import CensoredData, binomtest, ecdf

from geort_drake.benchmark.records import Record

# A fixed seed, so that equal results give equal intervals.
_BOOTSTRAP_RESAMPLES, _BOOTSTRAP_SEED = 4000, 0


def summarize(
    records: Sequence[Record], methods: Sequence[str], timeout: float, grips: Mapping[str, str]
) -> dict:
    """Returns all figures of a benchmark, JSON-ready.

    Args:
        records: records in any order; those of several trainings of a method have a `training`.
        methods: methods in the order of the report; differences refer to the first.
        timeout: time at which failures are censored, s.
        grips: object → its grip, which is its class.

    Returns:
        `reference`, `timeout_s`, `objects`; `classes`: grip → its objects; `methods`: name → `overall`,
        `classes` and `objects` → result of `figures`; `differences`: name of every other method → the same
        with the result of `difference`.
    """
    records = sorted(records, key=lambda r: (r["object"], r["seed"]))
    objects = sorted({record["object"] for record in records})
    classes: dict[str, list[str]] = {grip: [] for grip in sorted({grips[name] for name in objects})}
    for name in objects:
        classes[grips[name]].append(name)
    by_method = {name: [record for record in records if record["method"] == name] for name in methods}

    def each(calculate: Callable[..., dict], *groups: Sequence[Record]) -> dict:
        """Calculates overall, for each class and for each object."""

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
    """Returns statistics of the trials of one method; None where no trial has the quantity.

    Returns:
        `trials`, their number, and `errors`, the number of further trials that raised one;
        `first_attempt_success`, `success` and `tip_success`, see `proportion`; `holding`: number of successes
        in which each link of the hand touched the held object; `completion_time_s`: `restricted_mean` up to
        the timeout with its interval, and `median_of_successes`; `phase_s`: mean time in each phase;
        `slip_mm`: median and 95th percentile over trials with a lift; `unattainable`: number of trials in
        which free play showed no attainable plan; `drops_per_trial`; `peak_force_n`, median; `self_contact`,
        mean fraction of the time; `faults`: number of outputs with each kind of fault, see `OwnMethod`;
        `failures`: number of each `ending` other than success.
    """
    judged = [record for record in records if "error" not in record]
    spent = table_of(judged, axes_of(judged), lambda record: restricted_time(record, timeout))
    times = [record["completion_time"] for record in judged if record["success"]]
    slips = [1e3 * record["slip"] for record in judged if record["slip"] is not None]
    phases = sorted({phase for record in judged for phase in record["phase_durations"]})
    return {
        "trials": len(judged),
        "errors": len(records) - len(judged),
        "first_attempt_success": proportion(sum(bool(r["first_attempt"]) for r in judged), len(judged)),
        "success": proportion(sum(r["success"] for r in judged), len(judged)),
        "tip_success": proportion(sum(r["tip_success"] for r in judged), len(judged)),
        "holding": dict(Counter(link for r in judged if r["success"] for link in r["holding"]).most_common()),
        "completion_time_s": {
            "restricted_mean": mean_and_interval(spent),
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
        "unattainable": sum(not r.get("attainable", True) for r in judged),
        "drops_per_trial": float(np.mean([r["drops"] for r in judged])) if judged else None,
        "peak_force_n": _median([r["peak_force"] for r in judged]),
        "self_contact": float(np.mean([r["self_contact"] for r in judged])) if judged else None,
        "faults": dict(sum((Counter(r.get("faults", {})) for r in judged), Counter())),
        "failures": dict(Counter(ending(r) for r in judged if not r["success"]).most_common()),
    }


def difference(records: Sequence[Record], reference: Sequence[Record], timeout: float) -> dict:
    """Returns the differences of a method to the reference, over objects and seeds with results of both.

    Returns:
        `pairs`; `first_attempt_success`: mean difference with its interval, `won` and `lost`: pairs in which
        only this method or only the reference succeeded, and `p` of McNemar's exact test;
        `completion_time_s`: mean difference of the restricted times with its interval.
    """
    judged = [r for r in records if "error" not in r], [r for r in reference if "error" not in r]
    axes = axes_of([*judged[0], *judged[1]])
    once = [table_of(group, axes, lambda r: float(bool(r["first_attempt"]))) for group in judged]
    times = [table_of(group, axes, lambda r: restricted_time(r, timeout)) for group in judged]
    for pair in (once, times):
        both = np.logical_and(*(~np.isnan(values).all(axis=0) for values in pair))
        for values in pair:
            values[:, ~both] = np.nan
    # Trainings are paired by number; a reference with fewer trainings repeats its first one.
    first = np.where(np.isnan(once[1]), once[1][:1], once[1])
    signs = (once[0] - first)[~np.isnan(once[0] - first)]
    won, lost = int((signs > 0).sum()), int((signs < 0).sum())
    return {
        "pairs": len(signs),
        "first_attempt_success": {
            **mean_and_interval(*once),
            "won": won,
            "lost": lost,
            "p": float(binomtest(won, won + lost).pvalue) if won + lost else 1.0,
        },
        "completion_time_s": mean_and_interval(*times),
    }


def ending(record: Record) -> str:
    """Returns a trial's outcome, after a failure with the simulated person's phase, if any."""
    phase = None if record["success"] else record["operator_phase"]
    return record["outcome"] if phase is None else f"{record['outcome']} ({phase})"


def restricted_time(record: Record, timeout: float) -> float:
    """Returns the completion time, s; the timeout for a trial without success."""
    return record["completion_time"] if record["success"] else timeout


def proportion(successes: int, trials: int) -> dict:
    """Returns `successes`, `trials`, `rate`, and Wilson's 95 % interval `low` to `high`."""
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


def mean_and_interval(values: np.ndarray, reference: np.ndarray | None = None) -> dict:
    """Returns `mean` of values, or its difference to a reference's, and its interval `low` to `high`.

    The interval is the 95 % percentile interval of a hierarchical bootstrap, which resamples objects, the
    seeds of each object, and each method's trainings. Both methods share the resampled objects and seeds. A
    level with one member does not vary; a single value gives no interval.

    Args:
        values: (trainings, objects, seeds) values of the trials; NaN where there is none.
        reference: the same for the reference.
    """
    groups = [values] if reference is None else [values, reference]
    if any(np.isnan(group).all() for group in groups):
        return {"mean": None, "low": None, "high": None}
    sign = (1.0, -1.0)
    mean = sum(factor * float(np.nanmean(group)) for factor, group in zip(sign, groups, strict=False))
    if max((~np.isnan(group)).sum() for group in groups) < 2:
        return {"mean": mean, "low": None, "high": None}
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    _, objects, seeds = values.shape
    # How often each object, and each of its seeds, is drawn.
    weight = _counts(rng, objects)[..., None] * _counts(rng, seeds, objects)
    means = np.zeros(_BOOTSTRAP_RESAMPLES)
    for factor, group in zip(sign, groups, strict=False):
        made = group[~np.isnan(group).all(axis=(1, 2))]
        trainings = _counts(rng, len(made))
        total = np.einsum("rt,ros,tos->r", trainings, weight, np.nan_to_num(made), optimize=True)
        count = np.einsum("rt,ros,tos->r", trainings, weight, ~np.isnan(made), optimize=True)
        means += factor * total / np.where(count, count, np.nan)
    low, high = np.nanpercentile(means, [2.5, 97.5])
    return {"mean": mean, "low": float(low), "high": float(high)}


def _counts(rng: np.random.Generator, size: int, groups: int | None = None) -> np.ndarray:
    """Returns how often each of `size` members is drawn in R resamples, (R, size) or (R, groups, size)."""
    shape = (_BOOTSTRAP_RESAMPLES,) if groups is None else (_BOOTSTRAP_RESAMPLES, groups)
    return rng.multinomial(size, np.full(size, 1 / size), shape).astype(float)


_Axes = tuple[list[int], list[str], list[int]]


def axes_of(records: Sequence[Record]) -> _Axes:
    """Returns the trainings, objects and seeds that occur in records, sorted."""
    return (
        sorted({r.get("training", 0) for r in records}),
        sorted({r["object"] for r in records}),
        sorted({r["seed"] for r in records}),
    )


def table_of(records: Sequence[Record], axes: _Axes, value: Callable[[Record], float]) -> np.ndarray:
    """Returns a table (trainings, objects, seeds) of the records' values; NaN where there is none."""
    table = np.full([len(axis) for axis in axes], np.nan)
    for r in records:
        trainings, objects, seeds = axes
        place = trainings.index(r.get("training", 0)), objects.index(r["object"]), seeds.index(r["seed"])
        table[place] = value(r)
    return table


def completed_share(records: Sequence[Record], timeout: float) -> dict[str, np.ndarray]:
    """Returns the fraction of trials completed over time, a Kaplan-Meier estimate with 95 % interval.

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
        # The interval is NaN where all trials are completed; it is replaced below.
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
