"""A benchmark's log, its figures by closed forms, and the coverage of its intervals."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
from scipy.stats import t as student
from trial_records import error, trial

from geort_drake.benchmark.analysis import (
    bounded_interval,
    frame_of,
    holm,
    mean_interval,
    pairs_of,
    sign_test,
    table,
    variance,
)
from geort_drake.benchmark.log import TrialLog, key_of, read_rows
from geort_drake.benchmark.report import write_report
from geort_drake.benchmark.run import Settings
from geort_drake.errors import BenchmarkError, OutputError
from studies.interval_coverage import Design, coverage


def test_a_damaged_line_causes_a_warning_and_its_trial_is_repeated(tmp_path, capsys):
    """In the midst as at the end, where a crash leaves half a line; the next row stands alone."""
    path = tmp_path / "trials.jsonl"
    rows = [error(), trial(), trial(seed=1, time=None), trial(seed=2, first_attempt=None, attempts=None)]
    lines = [json.dumps(row) for row in rows]
    for damage in ('{"method": "ho', "[" * 3000, json.dumps({"method": "hold"}), "\x00\xff"):
        path.write_text("\n".join([lines[0], damage, *lines[1:], '{"method": "ho']))
        with TrialLog(tmp_path) as log:
            assert log.rows == rows
            told = " ".join(capsys.readouterr().err.split())
            assert "line 2: not the row of a trial" in told and "line 6: not the row" in told
            assert log.unfinished(map(key_of, rows)) == [key_of(rows[0])]
            log.append(trial(seed=7))
        assert read_rows(path) == [*rows, trial(seed=7)]


def test_a_last_line_that_lacks_only_its_end_is_a_result(tmp_path):
    (tmp_path / "trials.jsonl").write_text(json.dumps(trial()))
    with TrialLog(tmp_path) as log:
        log.append(trial(seed=1))
    assert read_rows(tmp_path / "trials.jsonl") == [trial(), trial(seed=1)]
    with pytest.raises(BenchmarkError, match=r"is .* the folder of a benchmark\?"):
        read_rows(tmp_path / "none" / "trials.jsonl")


def test_a_log_has_one_writer_and_no_number_that_json_lacks(tmp_path):
    with TrialLog(tmp_path) as log:
        with pytest.raises(OutputError, match="another process is writing"):
            TrialLog(tmp_path)
        log.append(trial(slip=math.inf))
    assert read_rows(tmp_path / "trials.jsonl") == [trial(slip=None)]


def test_the_variance_of_balanced_trials_is_that_of_their_cluster_means(rng):
    """Student's interval of 6 objects' means has 5 degrees of freedom; independent trials have N − 1."""
    means = rng.normal(size=6)
    values, objects = np.repeat(means, 4) + np.tile([-0.1, 0.1, -0.2, 0.2], 6), np.repeat(np.arange(6), 4)
    assert variance(values, [objects, np.zeros(24)]) == pytest.approx((means.var(ddof=1) / 6, 5))
    assert variance(values, [np.zeros(24)]) == pytest.approx((values.var(ddof=1) / 24, 23))
    mean, low, high = mean_interval(values, [objects])
    half = student.ppf(0.975, 5) * np.sqrt(means.var(ddof=1) / 6)
    assert (mean, high - mean, mean - low) == pytest.approx((means.mean(), half, half))


def test_crossed_objects_and_people_add_their_variances_once(rng):
    """E[MS_A + MS_B − MS_AB] of a two-way analysis of variance is the variance of the mean."""
    objects, persons = np.repeat(np.arange(10), 8), np.tile(np.arange(8), 10)
    values = rng.normal(size=10)[objects] + 2 * rng.normal(size=8)[persons] + 0.5 * rng.normal(size=80)
    square = values.reshape(10, 8)
    rows, columns = square.mean(axis=1), square.mean(axis=0)
    rest = square - rows[:, None] - columns + square.mean()
    wanted = rows.var(ddof=1) / 10 + columns.var(ddof=1) / 8 - (rest**2).sum() / (9 * 7) / 80
    assert variance(values, [objects, persons])[0] == pytest.approx(wanted)


def test_success_with_independent_trials_has_wilsons_interval_with_students_quantile():
    """All or no trials that succeed leave an interval as well."""
    values = np.array([1.0] * 30 + [0.0] * 10)
    p, n, z2 = 0.75, 40 * 39 / 40, student.ppf(0.975, 39) ** 2
    half = np.sqrt(z2 * (p * (1 - p) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    assert bounded_interval(values, []) == pytest.approx((p, centre - half, centre + half))
    mean, low, high = bounded_interval(np.ones(40), [])
    assert mean == high == 1.0 and 0.85 < low < 0.95
    assert np.isnan(bounded_interval(np.ones(1), []).low) and np.isnan(bounded_interval(np.ones(0), []).mean)


def test_an_interval_contains_its_mean_although_numbers_are_rounded():
    for number in range(2, 60):
        for values in (np.ones(number), np.zeros(number)):
            mean, low, high = bounded_interval(values, [])
            assert low <= mean <= high


def test_objects_that_always_fail_widen_the_interval():
    """Three of ten objects: as wide as ten trials allow, not as three hundred would."""
    rows = [trial(thing=f"o{k}", seed=s, time=None if k < 3 else 5.0) for k in range(10) for s in range(30)]
    (figures,) = table(frame_of(rows), ["hold"]).to_dict("records")
    mean, low, high = figures["success"]
    assert mean == pytest.approx(0.7) and low < 0.45 and high > 0.87
    assert figures["time"].mean == pytest.approx(0.7 * 5.0 + 0.3 * 20.0)


def test_deviations_that_cancel_within_each_object_do_not_make_a_difference_certain():
    """One seed of three is lost with every object: nine pairs know no better than nine independent ones."""
    objects = np.repeat(np.arange(3), 3)
    for values in (np.tile([-1.0, 0.0, 0.0], 3), np.tile([1.0, -1.0, 0.0], 3)):
        assert mean_interval(values, [objects]) == pytest.approx(mean_interval(values, []))
    rows = [trial(name, f"o{k}", s, None if name == "geort" and k == 0 else 5.0)
            for name in ("hold", "geort") for k in range(3) for s in range(4)]  # fmt: skip
    difference = table(frame_of(rows), ["hold", "geort"]).to_dict("records")[1]["difference"]
    assert difference == pytest.approx((-1 / 3, -1.0, 1.0))


def test_equal_values_have_the_interval_of_as_many_independent_trials():
    """Also times that differ from their mean by rounding only."""
    for values in (np.full(27, 0.1), np.full(9, 0.1)):
        mean, low, high = bounded_interval(values, [np.arange(len(values)) % 3])
        assert mean == pytest.approx(0.1) and low < 0.03 and high > 0.3
    assert np.isnan(mean_interval(np.full(27, 0.1), [np.arange(27) % 3]).low)


def test_a_table_of_trials_that_all_raised_has_no_rates():
    rows = [error(name, seed=seed) for name in ("hold", "geort") for seed in range(3)]
    for row in table(frame_of(rows), ["hold", "geort"]).to_dict("records"):
        assert (row["trials"], row["errors"], row["success"].text(), row["won"]) == (0, 3, "–", 0)
        assert row["time"].text() == row["difference"].text() == "–" and np.isnan(row["p"])


def report_of(folder, lines, methods=("hold", "geort")) -> str:
    """The report of a folder with these lines of trials.jsonl; every picture that it links exists."""
    entry = {"source": "hold", "latency_s": None, "digests": []}
    settings = Settings(methods=dict.fromkeys(methods, entry))
    (folder / "settings.json").write_text(json.dumps(dataclasses.asdict(settings)))
    (folder / "trials.jsonl").write_text("\n".join(lines))
    json.dumps(write_report(folder).to_json())
    text = (folder / "report.md").read_text()
    for link in re.findall(r"\((\w+\.svg)\)", text):
        assert (folder / link).is_file()
    return text


def test_reports_of_unfinished_and_failed_benchmarks_say_so(tmp_path):
    half = '{"method": "ho'
    assert "no trial with a result" in report_of(tmp_path, [half])
    raised = [json.dumps(error(name)) for name in ("hold", "geort")]
    assert "not counted: 2" in (text := report_of(tmp_path, raised)) and "| geort | 0 | – |" in text
    failed = [json.dumps(trial(name, seed=s, time=None)) for name in ("hold", "geort") for s in range(3)]
    assert "| geort | 3 | 0 [0, 86] |" in (text := report_of(tmp_path, [*failed, half])) and "0 : 0" in text
    varied = [json.dumps(trial(seed=s, condition="operator.visual_delay=1")) for s in range(3)]
    assert "(success.svg)" in report_of(tmp_path, varied, ["hold"])
    assert "hold, operator.visual_delay=1<" in (tmp_path / "success.svg").read_text()
    assert r"| a\|b.py | 1 | 100 |" in report_of(tmp_path, [json.dumps(trial("a|b.py"))], ["a|b.py"])


def paired(outcomes, trainings=1):
    """Rows of a method and a reference; `outcomes` are whether each succeeds, a pair for each seed."""
    for seed, (own, other) in enumerate(outcomes):
        yield trial("reference", seed=seed, time=5.0 if other else None)
        for training in range(trainings):
            yield trial("geort", seed=seed, time=5.0 if own else None, training=training)


def test_copies_of_a_pair_count_once():
    """Five trainings with the same outcomes are five pairs won, as with one: p = 2 / 2⁵."""
    for trainings in (1, 5):
        frame = frame_of(paired([(True, False)] * 5 + [(True, True)] * 5, trainings))
        differences = pairs_of(frame, "geort", "reference", "success")["difference"].to_numpy()
        assert sign_test(differences) == (5, 0, pytest.approx(0.0625))
        row = table(frame, ["reference", "geort"]).to_dict("records")[1]
        assert row["p"] == pytest.approx(0.0625) and row["difference"].mean == pytest.approx(0.5)


def test_pairs_without_a_partner_and_trials_that_raised_count_for_nothing():
    rows = [*paired([(True, False), (False, True), (True, True)]), trial("geort", seed=8)]
    rows += [error("geort", seed=9), trial("reference", seed=9)]
    reference, own = table(frame_of(rows), ["reference", "geort"]).to_dict("records")
    assert (own["trials"], own["errors"], own["won"], own["lost"], own["p"]) == (4, 1, 1, 1, 1.0)
    assert np.isnan(reference["p"]) and np.isnan(reference["difference"].mean)


def test_holm_multiplies_the_smallest_p_by_the_number_of_tests():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0]) and holm([]) == []


@pytest.mark.parametrize(
    "design", [Design(5, 1, 30, 0.0, 1.5), Design(10, 1, 30, 1.5, 0.5), Design(10, 6, 4, 1.5, 1.5)], ids=str
)
def test_intervals_contain_known_effects_in_93_to_97_of_100_simulated_benchmarks(design):
    """Of success, time and difference; with the simulation's own error of two standard deviations.

    `python studies/interval_coverage.py` has more designs.
    """
    benchmarks = 400
    margin = 2 * math.sqrt(0.95 * 0.05 / benchmarks)
    for name, share in coverage(design, benchmarks, seed=1).items():
        assert 0.93 - margin <= share <= 0.97 + margin, name
