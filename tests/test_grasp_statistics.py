"""Figures of a grasp benchmark: intervals, censoring, pairing, and what they are when little is known."""

import json

import numpy as np
import pytest
from trial_records import error, trial

from geort_drake.benchmark.records import by_training
from geort_drake.benchmark.statistics import (
    completed_share,
    difference,
    figures,
    mean_and_interval,
    proportion,
    summarize,
)

TIMEOUT = 20.0
GRIPS = {"cube": "tripod", "ball": "tripod", "rod": "pinch"}


# -- of one method


def test_a_proportion_has_wilsons_interval():
    """8 of 10 by Wilson's formula; no successes still leave room above, and no trials say nothing."""
    z, p, n = 1.959964, 0.8, 10
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    found = proportion(8, 10)
    assert found["rate"] == 0.8
    np.testing.assert_allclose([found["low"], found["high"]], [centre - half, centre + half], atol=1e-6)
    assert proportion(0, 10)["low"] == 0 and 0.2 < proportion(0, 10)["high"] < 0.4
    assert proportion(0, 0)["rate"] is None


def test_failures_count_as_the_timeout_in_the_mean_and_not_in_the_median():
    """A thrown object does not become a quick completion."""
    records = [trial(time=4.0), trial(time=6.0, seed=1), trial(time=None, seed=2, simulated_time=3.0)]
    time = figures(records, TIMEOUT)["completion_time_s"]
    assert time["restricted_mean"]["mean"] == pytest.approx((4 + 6 + TIMEOUT) / 3)
    assert time["median_of_successes"] == 5.0


def test_figures_tell_kinds_of_success_apart():
    """At once, at the second attempt, and with the palm's help; a trial that raised is in no figure."""
    records = [
        trial(),
        trial(seed=1, attempts=2),
        trial(seed=2, tip_success=False, holding={"thumb": 2.0, "palm": 0.1}),
        trial(seed=3, time=None),
        error(),
    ]
    found = figures(records, TIMEOUT)
    counts = [found[kind]["successes"] for kind in ("success", "first_attempt_success", "tip_success")]
    assert counts == [3, 2, 2] and (found["trials"], found["errors"]) == (4, 1)
    assert found["drops_per_trial"] == pytest.approx(1 / 4)
    assert found["failures"] == {"timeout: lift": 1}
    assert found["holding"] == {"thumb": 3, "index": 2, "palm": 1}


@pytest.mark.parametrize("shape", [(1, 20, 4), (6, 8, 3)])
def test_the_interval_of_a_mean_covers_it_about_as_often_as_it_says(shape):
    """Objects and trainings vary as well as trials: of 100 samples nine in ten intervals contain the mean."""
    rng, (trainings, objects, _) = np.random.default_rng(0), shape
    covered = 0
    for _ in range(100):
        levels = (trainings > 1) * rng.normal(0, 1, (trainings, 1, 1)) + rng.normal(0, 1, (1, objects, 1))
        found = mean_and_interval(3.0 + levels + rng.normal(0, 1, shape))
        covered += found["low"] <= 3.0 <= found["high"]
    assert 0.82 <= covered / 100 <= 0.99


def test_objects_that_differ_widen_the_interval_and_missing_trials_do_not_count():
    """One object alone says only how its trials vary."""
    easy, hard = [2.0, 2.1, 1.9] * 5, [20.0, 20.1, np.nan] * 5
    found = mean_and_interval(np.array([[easy, hard]]))
    assert found["mean"] == pytest.approx(np.nanmean([easy, hard])) and found["high"] - found["low"] > 10
    alone = mean_and_interval(np.array([[easy]]))
    assert alone["high"] - alone["low"] < 0.2
    assert mean_and_interval(np.array([[[1.0]]])) == {"mean": 1.0, "low": None, "high": None}
    assert mean_and_interval(np.full((1, 1, 0), np.nan))["mean"] is None


# -- of two methods


def test_differences_are_between_trials_of_the_same_object_and_seed():
    """With equal pairs shifted by one second the difference is one second, however they vary."""
    theirs = [trial("a", seed=seed, time=3.0 + seed) for seed in range(10)]
    mine = [trial("b", seed=seed, time=4.0 + seed) for seed in reversed(range(10))]
    found = difference(mine, theirs, TIMEOUT)
    assert found["pairs"] == 10
    assert found["completion_time_s"] == pytest.approx({"mean": 1.0, "low": 1.0, "high": 1.0})
    unpaired = difference(mine, theirs[:4] + [error("a", seed=seed) for seed in range(4, 10)], TIMEOUT)
    assert unpaired["pairs"] == 4


def test_trainings_of_a_method_are_told_apart():
    """Each is paired with the reference's own, or its only one; those that differ widen the interval."""
    theirs = [trial("a", seed=seed) for seed in range(4)]
    mine = [trial("b", seed=s, time=5.0 if k else None, training=k) for s in range(4) for k in (0, 1)]
    found = difference(mine, theirs, TIMEOUT)
    assert found["pairs"] == 8 and found["first_attempt_success"]["lost"] == 4
    assert found["first_attempt_success"]["mean"] == pytest.approx(-0.5)
    assert found["first_attempt_success"]["low"] == -1 and found["first_attempt_success"]["high"] == 0
    assert by_training({"method": "geort~2", "seed": 1}) == {"method": "geort", "seed": 1, "training": 2}


def test_won_and_lost_are_counted_and_tested():
    """Seven pairs won and one lost: McNemar's exact p is 2 · 9 / 2⁸."""
    theirs = [trial("a", seed=seed, time=None if seed < 7 else 5.0) for seed in range(10)]
    mine = [trial("b", seed=seed, time=None if seed == 9 else 5.0) for seed in range(10)]
    found = difference(mine, theirs, TIMEOUT)["first_attempt_success"]
    assert (found["won"], found["lost"]) == (7, 1)
    assert found["mean"] == pytest.approx(0.6)
    assert found["low"] < 0.6 < found["high"]
    assert found["p"] == pytest.approx(18 / 256)
    assert difference(theirs, theirs, TIMEOUT)["first_attempt_success"]["p"] == 1.0


# -- all together


def test_the_summary_is_the_same_for_any_order_and_is_json():
    """Trials finish in any order; methods keep that of the configuration, the first is the reference."""
    rng = np.random.default_rng(1)
    records = [
        trial(method, thing, seed, float(rng.uniform(3, 9)) if rng.uniform() < 0.7 else None)
        for method in ("b", "a")
        for thing in ("cube", "rod")
        for seed in range(6)
    ]
    summary = summarize(records, ["b", "a", "new"], TIMEOUT, GRIPS)
    shuffled = [records[k] for k in rng.permutation(len(records))]
    assert summarize(shuffled, ["b", "a", "new"], TIMEOUT, GRIPS) == summary
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert list(summary["methods"]) == ["b", "a", "new"] and summary["reference"] == "b"
    assert list(summary["differences"]) == ["a", "new"] and summary["objects"] == ["cube", "rod"]
    rod = summary["methods"]["a"]["objects"]["rod"]
    assert rod == figures([r for r in records if (r["method"], r["object"]) == ("a", "rod")], TIMEOUT)
    assert summary["methods"]["new"]["overall"]["trials"] == 0


def test_the_completed_share_rises_to_the_success_rate():
    """Kaplan and Meier's estimate with censoring at the end alone is the share completed by then."""
    records = [trial(seed=seed, time=time) for seed, time in enumerate([5.0, 6.0, 7.0, 7.0, None, None])]
    curve = completed_share(records, TIMEOUT)
    np.testing.assert_allclose(curve["t"], [0, 5, 6, 7, TIMEOUT])
    np.testing.assert_allclose(curve["share"], [0, 1 / 6, 2 / 6, 4 / 6, 4 / 6])
    assert (curve["low"] <= curve["share"]).all() and (curve["share"] <= curve["high"]).all()
    assert curve["low"][-1] > 0.2 and curve["high"][-1] < 1.0


@pytest.mark.parametrize("times", [[], [None, None], [5.0], [5.0, 5.0], [3.0, 4.0]])
def test_the_completed_share_of_few_trials_is_finite(times):
    """None, only failures, and all completed leave no NaN behind."""
    curve = completed_share([trial(seed=seed, time=time) for seed, time in enumerate(times)], TIMEOUT)
    assert all(np.isfinite(values).all() for values in curve.values())
    assert len({len(values) for values in curve.values()}) == 1
    assert curve["t"][0] == 0 and curve["t"][-1] == TIMEOUT
