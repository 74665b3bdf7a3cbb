"""Checks the benchmark's intervals by simulated benchmarks: how often do they contain the true value?

python studies/interval_coverage.py --benchmarks 2000

Objects and people have random effects on the logit of success and on the logarithm of the time to success;
failures count as the timeout. The true values are those of a population of objects and people. Prints the
coverage of 95 % intervals of success, time and a paired difference of success.
"""

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geort_drake.benchmark.analysis import bounded_interval, mean_interval
from geort_drake.console import print_table, run_main

DRAWS = 200_000  # of the population, for the true values
EFFECT = 0.7  # of the second method on the logit of success
TIMEOUT = 25.0  # s


class Design(NamedTuple):
    """A simulated benchmark.

    Attributes:
        objects, persons, seeds: numbers of each.
        logit: mean logit of success.
        object_sd, person_sd: standard deviations of the effects on the logit; a quarter on the log time.
    """

    objects: int
    persons: int
    seeds: int
    logit: float
    object_sd: float
    person_sd: float = 0.7


DESIGNS = [
    Design(objects, persons, seeds, logit, object_sd)
    for objects, persons, seeds in ((5, 1, 30), (10, 1, 30), (8, 4, 6), (10, 6, 4))
    for logit in (0.0, 1.5, 3.0)
    for object_sd in (0.5, 1.5)
]


def coverage(design: Design, benchmarks: int, seed: int = 0) -> dict[str, float]:
    """Returns the fraction of intervals of success, time and difference that contain the true value."""
    rng = np.random.default_rng(seed)
    persons_sd = design.person_sd if design.persons > 1 else 0.0
    effects = design.object_sd * rng.normal(size=DRAWS) + persons_sd * rng.normal(size=DRAWS)
    # The second method acts differently with each object.
    interaction = 0.5 * design.object_sd * rng.normal(size=DRAWS)
    first = _share(design.logit + effects)
    truth = {
        "success": first.mean(),
        "time": _times(rng, effects, rng.random(DRAWS) < first).mean() / TIMEOUT,
        "difference": (_share(design.logit + effects + EFFECT + interaction) - first).mean(),
    }
    labels = np.indices((design.objects, design.persons, design.seeds)).reshape(3, -1)[:2]
    hits = dict.fromkeys(truth, 0)
    for _ in range(benchmarks):
        of_object = design.object_sd * rng.normal(size=design.objects)
        effect = of_object[labels[0]] + (persons_sd * rng.normal(size=design.persons))[labels[1]]
        change = EFFECT + (0.5 * design.object_sd * rng.normal(size=design.objects))[labels[0]]
        success = rng.random(len(effect)) < _share(design.logit + effect)
        other = rng.random(len(effect)) < _share(design.logit + effect + change)
        time = _times(rng, effect, success)
        intervals = {
            "success": bounded_interval(success.astype(float), labels),
            "time": bounded_interval(time / TIMEOUT, labels),
            "difference": mean_interval(other.astype(float) - success, labels),
        }
        for name, interval in intervals.items():
            hits[name] += interval.low <= truth[name] <= interval.high
    return {name: count / benchmarks for name, count in hits.items()}


def _times(rng: np.random.Generator, effect: np.ndarray, success: np.ndarray) -> np.ndarray:
    """Draws times to success, s, around 7 s; failures take the timeout."""
    times = np.exp(2.0 - 0.25 * effect + 0.3 * rng.normal(size=len(effect)))
    return np.where(success, np.minimum(times, TIMEOUT), TIMEOUT)


def _share(logit: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-logit))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benchmarks", type=int, default=2000, help="simulated benchmarks per design")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation")
    arguments = parser.parse_args(argv)
    headings = (*Design._fields, "success", "time", "difference")
    rows, everything = [], []
    for design in DESIGNS:
        hits = coverage(design, arguments.benchmarks, arguments.seed)
        everything.append(list(hits.values()))
        rows.append([*map(str, design), *(f"{100 * share:.1f} %" for share in hits.values())])
    means = (f"{100 * share:.1f} %" for share in np.mean(everything, axis=0))
    rows.append(["all", *[""] * (len(Design._fields) - 1), *means])
    print_table(headings, rows, "Coverage of 95 % intervals")
    return 0


if __name__ == "__main__":
    run_main(main)
