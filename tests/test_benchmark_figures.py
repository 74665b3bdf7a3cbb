"""The results of a benchmark line by line, its figures, and its sensitivity to what is assumed."""

import json
import math

import numpy as np
import pytest
from trial_records import error, trial

from geort_drake import load_scenario
from geort_drake.benchmark.conditions import ASSUMPTIONS, make_conditions, parse_values
from geort_drake.benchmark.records import TrialLog, by_training, read_records
from geort_drake.benchmark.sensitivity import summarize_sensitivity
from geort_drake.benchmark.statistics import (
    completed_share,
    difference,
    figures,
    mean_and_interval,
    proportion,
    summarize,
)
from geort_drake.errors import BenchmarkError, OutputError, ScenarioError
from geort_drake.simulation.scenario import Scenario, dump_scenario
from geort_drake.simulation.worn_glove import WornGloveConfig


def test_every_way_to_end_is_read_and_a_torn_last_line_is_dropped(tmp_path):
    """Success, failure, an error, a replay in which nobody decides; also with a field of a later version.

    A line may lack nothing but its end: its trial is repeated, and the next line stands alone.
    """
    path = tmp_path / "trials.jsonl"
    whole = [
        error(),
        trial(),
        trial(seed=1, time=None),
        trial(seed=2, first_attempt=None, attempts=None),
        trial(seed=3, note="x"),
    ]
    text = "".join(json.dumps(record) + "\n" for record in whole)
    for torn in ('{"method": "ho', json.dumps(error(seed=1))):
        path.write_text(text + torn)
        assert read_records(path) == whole
        with TrialLog(path) as log:
            assert log.torn and log.records == whole
            log.append(error(seed=2))
        assert path.read_text() == text + json.dumps(error(seed=2)) + "\n"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ('{"method": "ho', "line 2: not a trial's result"),
        ('{"method": "hold", "object": "cube", "seed": 1}', "line 2: .*missing.*; repair or delete"),
        (json.dumps(trial(seed=1)) + "\n" + json.dumps(trial(seed=1)), "line 3: a second result of hold"),
        (json.dumps(trial(seed=1, slip=float("nan"))), "line 2: .*slip must be finite, not nan"),
        (json.dumps(trial(seed=1, outcome="thrown")), "line 2: .*success is True, .*contradicts .*thrown"),
    ],
)
def test_a_corrupt_line_is_refused_by_file_and_number(tmp_path, bad, message):
    """With what was expected and what was given, and the file stays as it is."""
    path = tmp_path / "trials.jsonl"
    content = json.dumps(error()) + "\n" + bad + "\n" + json.dumps(error(seed=2)) + "\n"
    path.write_text(content)
    for read in (TrialLog, read_records):
        with pytest.raises(BenchmarkError, match=f"trials.jsonl, {message}"):
            read(path)
    assert path.read_text() == content


def test_two_processes_do_not_write_to_one_file(tmp_path):
    """The second is turned away as long as the first has the file open; without trials, no file remains."""
    path = tmp_path / "run" / "trials.jsonl"
    with TrialLog(path), pytest.raises(OutputError, match="another process is writing"):
        TrialLog(path)
    assert not path.parent.exists()
    TrialLog(path).close()


TIMEOUT = 20.0
GRIPS = {"cube": "tripod", "ball": "tripod", "rod": "pinch"}


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


def test_kinds_of_success_are_told_apart_and_failures_count_as_the_timeout_in_the_mean_only():
    """A thrown object does not become a quick completion."""
    records = [trial(time=4.0), trial(time=6.0, seed=1), trial(time=None, seed=2, simulated_time=3.0)]
    time = figures(records, TIMEOUT)["completion_time_s"]
    assert time["restricted_mean"]["mean"] == pytest.approx((4 + 6 + TIMEOUT) / 3)
    assert time["median_of_successes"] == 5.0
    # Success at once, at the second attempt, and with the palm's help; a trial that raised is in no figure.
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
    """Kaplan and Meier's estimate with censoring at the end alone is the share completed by then.

    Without trials, with failures alone, and with all completed it is finite as well.
    """
    records = [trial(seed=seed, time=time) for seed, time in enumerate([5.0, 6.0, 7.0, 7.0, None, None])]
    curve = completed_share(records, TIMEOUT)
    np.testing.assert_allclose(curve["t"], [0, 5, 6, 7, TIMEOUT])
    np.testing.assert_allclose(curve["share"], [0, 1 / 6, 2 / 6, 4 / 6, 4 / 6])
    assert (curve["low"] <= curve["share"]).all() and (curve["share"] <= curve["high"]).all()
    assert curve["low"][-1] > 0.2 and curve["high"][-1] < 1.0
    for times in ([], [None, None], [5.0], [5.0, 5.0], [3.0, 4.0]):
        curve = completed_share([trial(seed=seed, time=time) for seed, time in enumerate(times)], TIMEOUT)
        assert np.isfinite(list(curve.values())).all()  # all of one length
        assert curve["t"][0] == 0 and curve["t"][-1] == TIMEOUT


USUAL = {name: list(parameter.values) for name, parameter in ASSUMPTIONS.items()}


def trials(rates: dict[str, int], condition: str = "") -> list[dict]:
    """Ten trials of each method, so many of them successes."""
    return [
        trial(name, seed=k, time=5.0 if k < rate else None, condition=condition)
        for name, rate in rates.items()
        for k in range(10)
    ]


def test_a_condition_changes_what_its_name_says_and_the_nominal_value_makes_none():
    """Every parameter acts on the scenario's own fields, and leaves the nominal scenario alone."""
    # A name with values, a name alone, and no name at all.
    assert parse_values(["delay=0,250", "noise"], ASSUMPTIONS) == {"delay": [0, 250], "noise": [0, 2, 4]}
    assert parse_values([], ASSUMPTIONS) == USUAL
    scenario = load_scenario()
    before = dump_scenario(scenario)
    wanted = {"delay": [180, 300], "gain": [2.5, 0.5], "noise": [1, 2], "stiffness": [4], "friction": [0.5]}
    wanted |= {"touch": [0], "tracker": [10], "donning": [5], "dropouts": [2], "person": [3]}
    wanted |= {"modulus": [0, 200]}
    conditions = make_conditions(scenario, wanted, ASSUMPTIONS)
    named = "delay=300 gain=0.5 noise=2 stiffness=4 friction=0.5"
    named += " touch=0 tracker=10 donning=5 dropouts=2 person=3 modulus=200"
    assert list(conditions) == named.split()
    assert conditions["touch=0"].operator.touch is False and conditions["person=3"].person == 3
    assert conditions["tracker=10"].glove.misalignment == pytest.approx(math.radians(10))
    assert conditions["donning=5"].glove == WornGloveConfig(shift=0.005, turn=0.05)
    assert conditions["dropouts=2"].glove.dropout_rate == 2
    assert conditions["delay=300"].operator.visual_delay == 0.3
    assert conditions["gain=0.5"].operator.correction_rate == 0.5
    noisy, person = conditions["noise=2"].operator, scenario.operator
    fields = "visual_noise visual_depth_noise visual_turn_noise contact_noise motor_noise tremor"
    for field in fields.split():
        assert getattr(noisy, field) == 2 * getattr(person, field)
    assert conditions["stiffness=4"].hand_stiffness_factor == 4
    assert conditions["friction=0.5"].object.friction_factor == 0.5
    assert conditions["modulus=200"].fingertip_modulus == 2e5
    assert dump_scenario(scenario) == before
    assert set(make_conditions(scenario, USUAL, ASSUMPTIONS)) == {
        f"{name}={value:g}" for name, values in USUAL.items() for value in values
    }
    with pytest.raises(ScenarioError, match="visual_delay"):
        make_conditions(scenario, {"delay": [5]}, ASSUMPTIONS)
    with pytest.raises(ScenarioError, match=r"friction_factor must be positive and finite, not 0"):
        make_conditions(scenario, {"friction": [0]}, ASSUMPTIONS)


def test_tau_says_whether_the_ranking_holds():
    """1 where all fare worse alike, −1 where the order is turned, none where all are equal."""
    records = [
        *trials({"a": 9, "b": 6, "c": 3}),
        *trials({"a": 6, "b": 3, "c": 0}, "delay=300"),
        *trials({"a": 1, "b": 5, "c": 8}, "delay=0"),
        *trials({"a": 0, "b": 0, "c": 0}, "noise=4"),
    ]
    summary = summarize_sensitivity(records, ["a", "b", "c"], Scenario())
    assert list(summary) == ["delay", "noise"]
    delay = summary["delay"]["conditions"]
    assert [(c["value"], c["nominal"], c["tau"]) for c in delay] == [
        (0.0, False, pytest.approx(-1)),
        (180.0, True, pytest.approx(1)),
        (300.0, False, pytest.approx(1)),
    ]
    assert delay[2]["methods"]["b"]["rate"] == 0.3
    assert delay[2]["methods"]["b"]["low"] < 0.3 < delay[2]["methods"]["b"]["high"]
    assert [c["tau"] for c in summary["noise"]["conditions"]] == [pytest.approx(1), None]


def test_nominal_trials_count_where_a_condition_tried_the_same():
    """Other methods, objects and seeds of the benchmark are left out, and so are errors."""
    records = [
        *trials({"a": 5, "b": 10, "c": 0}),
        *[record for record in trials({"a": 5, "b": 10}, "gain=1") if record["seed"] < 5],
        error("a", seed=7, condition="gain=1"),
    ]
    (parameter,) = summarize_sensitivity(records, ["a", "b", "c"], Scenario()).values()
    for condition in parameter["conditions"]:
        assert set(condition["methods"]) == {"a", "b"}
        assert condition["methods"]["a"]["trials"] == condition["methods"]["a"]["successes"] == 5
