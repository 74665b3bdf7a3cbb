"""The sensitivity of a grasp benchmark: its conditions and whether the ranking of methods holds."""

import math

import pytest
from trial_records import error, trial

from geort_drake.benchmark.conditions import ASSUMPTIONS, make_conditions, parse_values
from geort_drake.benchmark.sensitivity import summarize_sensitivity
from geort_drake.errors import ScenarioError
from geort_drake.simulation.scenario import Scenario, dump_scenario
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.worn_glove import WornGloveConfig

USUAL = {name: list(parameter.values) for name, parameter in ASSUMPTIONS.items()}


def trials(rates: dict[str, int], condition: str = "") -> list[dict]:
    """Ten trials of each method, so many of them successes."""
    return [
        trial(name, seed=k, time=5.0 if k < rate else None, condition=condition)
        for name, rate in rates.items()
        for k in range(10)
    ]


# -- conditions


def test_values_are_read_and_the_usual_ones_filled_in():
    """A name with values, a name alone, and no name at all."""
    assert parse_values(["delay=0,250", "noise"], ASSUMPTIONS) == {"delay": [0, 250], "noise": [0, 2, 4]}
    assert parse_values([], ASSUMPTIONS) == USUAL


def test_a_condition_changes_what_its_name_says_and_the_nominal_value_makes_none():
    """Every parameter acts on the scenario's own fields, and leaves the nominal scenario alone."""
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


# -- the ranking


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
