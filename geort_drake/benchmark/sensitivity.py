"""Sensitivity of a grasp benchmark to its assumptions about the person and the robot.

A condition is the benchmark's scenario with one parameter changed, and named after it: `delay=100`.
"""

import copy
import dataclasses as dc
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from scipy.stats import kendalltau

from geort_drake.benchmark.records import Record
from geort_drake.benchmark.statistics import proportion
from geort_drake.errors import BenchmarkError, UnknownNameError
from geort_drake.simulation.scenario import Scenario


@dc.dataclass(frozen=True)
class Parameter:
    """An assumption that conditions change.

    Attributes:
        label: of the plot's axis.
        values: tried beside the scenario's own value.
        nominal: the scenario's own value.
        change: sets the value in a scenario.
    """

    label: str
    values: tuple[float, ...]
    nominal: Callable[[Scenario], float]
    change: Callable[[Scenario, float], None]


def _set_delay(scenario: Scenario, milliseconds: float) -> None:
    scenario.operator.visual_delay = milliseconds / 1000


def _set_gain(scenario: Scenario, rate: float) -> None:
    scenario.operator.correction_rate = rate


def _scale_noise(scenario: Scenario, factor: float) -> None:
    person = scenario.operator
    person.visual_noise *= factor
    person.visual_turn_noise *= factor
    person.contact_noise *= factor
    person.motor_noise *= factor
    person.tremor *= factor


def _scale_stiffness(scenario: Scenario, factor: float) -> None:
    scenario.hand_stiffness_factor *= factor


def _scale_friction(scenario: Scenario, factor: float) -> None:
    scenario.object.friction_factor *= factor


PARAMETERS = {
    "delay": Parameter(
        "visual delay, ms", (0, 100, 300), lambda s: round(1000 * s.operator.visual_delay, 9), _set_delay
    ),
    "gain": Parameter("naive gain, 1/s", (0.5, 1, 3), lambda s: s.operator.correction_rate, _set_gain),
    "noise": Parameter("the person's noise, factor", (0, 2, 4), lambda s: 1.0, _scale_noise),
    "stiffness": Parameter("hand stiffness, factor", (0.5, 2), lambda s: 1.0, _scale_stiffness),
    "friction": Parameter("object friction, factor", (0.5, 2), lambda s: 1.0, _scale_friction),
}


def usual_values() -> dict[str, tuple[float, ...]]:
    """The values of each parameter that are tried if none are given."""
    return {name: parameter.values for name, parameter in PARAMETERS.items()}


def parse_values(texts: Iterable[str], choices: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """Name → values from texts `NAME=V1,V2`, or `NAME` alone for the usual values; no texts: all usual ones.

    Raises:
        UnknownNameError: a name is none of the choices.
        BenchmarkError: a value is not a finite number of at least 0.
    """
    result: dict[str, list[float]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        if name not in choices:
            raise UnknownNameError("parameter", name, choices)
        try:
            numbers = [float(value) for value in values.split(",")] if equals else list(choices[name])
        except ValueError:
            numbers = [math.nan]
        if not all(math.isfinite(number) and number >= 0 for number in numbers):
            raise BenchmarkError(
                f"{name} takes finite numbers of at least 0 with commas between, not '{values}'"
            )
        result.setdefault(name, []).extend(numbers)
    return result or {name: list(values) for name, values in choices.items()}


def condition_name(parameter: str, value: float) -> str:
    """Name of the condition in which a parameter has a value."""
    return f"{parameter}={value:g}"


def parameter_and_value(record: Record) -> tuple[str, float]:
    """The changed parameter of a trial's condition and its value; ("", 0) without a condition."""
    name, _, value = record.get("condition", "").partition("=")
    return name, float(value or 0)


def make_conditions(scenario: Scenario, values: Mapping[str, Sequence[float]]) -> dict[str, Scenario]:
    """Name → changed scenario for each value of each parameter, except for nominal values.

    Raises:
        ScenarioError: a value makes no valid scenario.
    """
    conditions = {}
    for name, numbers in values.items():
        parameter = PARAMETERS[name]
        for number in numbers:
            if number != parameter.nominal(scenario):
                changed = copy.deepcopy(scenario)
                parameter.change(changed, number)
                changed.validate()
                conditions[condition_name(name, number)] = changed
    return conditions


def summarize_sensitivity(
    records: Iterable[Record], methods: Sequence[str], scenario: Scenario
) -> dict[str, dict]:
    """One-time success of every method in every condition, and whether the ranking holds.

    Nominal trials count if their method, object and seed were tried in a condition of the parameter too.

    Args:
        records: lines of the results file, with and without a condition.
        methods: in the order of the report; those that were tried in no condition are left out.
        scenario: the nominal one.

    Returns:
        Parameter → `label` and `conditions`, sorted by `value`, each with `nominal`: whether it is the
        scenario's own value; `methods`: name → `proportion`; `tau`: Kendall's τ_b between the methods'
        success rates here and in the nominal scenario, None if either side has only ties.
    """
    judged = [record for record in records if "error" not in record]
    unchanged = [record for record in judged if not record.get("condition")]
    result = {}
    for name, parameter in PARAMETERS.items():
        changed = [record for record in judged if parameter_and_value(record)[0] == name]
        if not changed:
            continue
        tried = {(r["method"], r["object"], r["seed"]) for r in changed}
        usual = parameter.nominal(scenario)
        groups = {usual: [r for r in unchanged if (r["method"], r["object"], r["seed"]) in tried]}
        for record in changed:
            groups.setdefault(parameter_and_value(record)[1], []).append(record)
        names = [method for method in methods if any(r["method"] == method for r in changed)]
        rates = {value: _success(group, names) for value, group in groups.items()}
        result[name] = {
            "label": parameter.label,
            "conditions": [
                {
                    "value": value,
                    "nominal": value == usual,
                    "methods": rates[value],
                    "tau": _tau(rates[usual], rates[value]),
                }
                for value in sorted(rates)
            ],
        }
    return result


def _success(records: Sequence[Record], methods: Sequence[str]) -> dict[str, dict]:
    success = {name: [bool(r["first_attempt"]) for r in records if r["method"] == name] for name in methods}
    return {name: proportion(sum(values), len(values)) for name, values in success.items()}


def _tau(nominal: Mapping[str, dict], changed: Mapping[str, dict]) -> float | None:
    both = [name for name in nominal if None not in (nominal[name]["rate"], changed[name]["rate"])]
    if len(both) < 2:
        return None
    tau = kendalltau(*([rates[name]["rate"] for name in both] for rates in (nominal, changed))).statistic
    return None if np.isnan(tau) else float(tau)
