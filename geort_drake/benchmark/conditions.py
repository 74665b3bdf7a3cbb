"""Conditions: scenarios with one changed parameter, named after it and its value, such as `delay=100`."""

import copy
import dataclasses as dc
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

from geort_drake.benchmark.records import Record
from geort_drake.errors import BenchmarkError, UnknownNameError
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.scenario_files import check_scenario

_NOISES = (
    *("visual_noise", "visual_depth_noise", "visual_turn_noise"),
    *("contact_noise", "motor_noise", "tremor"),
)


@dc.dataclass(frozen=True)
class Parameter:
    """A parameter of a scenario that conditions change.

    Attributes:
        label: label of the plot's axis, with unit.
        values: default values.
        change: sets a value in a scenario.
        nominal: returns the unchanged value of a scenario.
    """

    label: str
    values: tuple[float, ...]
    change: Callable[[Scenario, float], None]
    nominal: Callable[[Scenario], float]


def _factor(
    label: str, values: tuple[float, ...], part: Callable[[Scenario], Any], *fields: str
) -> Parameter:
    """Returns a parameter that multiplies fields of a part of the scenario."""

    def change(scenario: Scenario, factor: float) -> None:
        for field in fields:
            setattr(part(scenario), field, factor * getattr(part(scenario), field))

    return Parameter(f"{label}, factor", values, change, lambda _: 1.0)


def _field(label: str, values: tuple[float, ...], field: str, unit: float = 1.0) -> Parameter:
    """Returns a parameter that sets a field, such as "glove.shift", to `unit` times its value."""
    part, _, name = field.rpartition(".")

    def change(scenario: Scenario, value: float) -> None:
        setattr(attrgetter(part)(scenario), name, unit * value)

    return Parameter(label, values, change, lambda scenario: round(attrgetter(field)(scenario) / unit, 9))


def _shift_glove(scenario: Scenario, shift: float) -> None:
    """Shifts the glove on the hand by `shift` mm and turns it by shift / 0.1 m, as when put on again."""
    scenario.glove.shift, scenario.glove.turn = 1e-3 * shift, 1e-2 * shift


def _soften(scenario: Scenario, modulus: float) -> None:
    """Sets the fingertips' hydroelastic modulus, kPa; 0 for rigid point contact."""
    scenario.fingertip_modulus = 1000 * modulus
    scenario.plant_config.contact_model = "hydroelastic_with_fallback" if modulus else "point"


# Parameters that the sensitivity analysis of a grasp benchmark changes.
ASSUMPTIONS = {
    "delay": _field("visual delay, ms", (0, 100, 300), "operator.visual_delay", 1e-3),
    "gain": _field("correction rate of a seen error, 1/s", (0.5, 1, 3), "operator.correction_rate"),
    "noise": _factor("the person's noise", (0, 2, 4), attrgetter("operator"), *_NOISES),
    "touch": Parameter(
        "felt forces (0: none)",
        (0,),
        lambda s, value: setattr(s.operator, "touch", bool(value)),
        lambda s: float(s.operator.touch),
    ),
    "tracker": _field(
        "angle between tracker and world, °", (5, 10, 15), "glove.misalignment", math.radians(1)
    ),
    "donning": Parameter(
        "shift of the glove, mm", (5, 10), _shift_glove, lambda s: round(1000 * s.glove.shift, 9)
    ),
    "dropouts": _field("gaps of 40 ms, 1/s", (1, 3), "glove.dropout_rate"),
    "person": Parameter(
        "person, by number in the population of seed 0",
        (1, 2, 3),
        lambda s, number: setattr(s, "person", int(number)),
        lambda s: float(s.person),
    ),
    "stiffness": _factor("hand stiffness", (0.5, 2), lambda s: s, "hand_stiffness_factor"),
    "friction": _factor("object friction", (0.5, 2), attrgetter("object"), "friction_factor"),
    "modulus": Parameter(
        "fingertip modulus, kPa (0: point contact)",
        (200,),
        _soften,
        lambda s: s.fingertip_modulus / 1000,
    ),
}


def parse_values(texts: Iterable[str], parameters: Mapping[str, Parameter]) -> dict[str, list[float]]:
    """Parses texts `NAME=V1,V2`, or `NAME` for its defaults, to name → values; no texts mean all defaults.

    Raises:
        UnknownNameError: there is no parameter of that name.
        BenchmarkError: a value is not a finite number of at least 0.
    """
    result: dict[str, list[float]] = {}
    for text in texts or parameters:
        name, equals, values = text.partition("=")
        if name not in parameters:
            raise UnknownNameError("parameter", name, parameters)
        try:
            numbers = list(map(float, values.split(",") if equals else parameters[name].values))
        except ValueError:
            numbers = [math.nan]
        if not all(math.isfinite(number) and number >= 0 for number in numbers):
            raise BenchmarkError(
                f"{name} takes finite numbers of at least 0 with commas between, not '{values}'"
            )
        result.setdefault(name, []).extend(numbers)
    return result


def make_conditions(
    scenario: Scenario, values: Mapping[str, Sequence[float]], parameters: Mapping[str, Parameter]
) -> dict[str, Scenario]:
    """Returns name → changed scenario for each value that is not nominal.

    Raises:
        ScenarioError: a changed scenario is invalid.
    """
    conditions = {}
    for name, numbers in values.items():
        parameter = parameters[name]
        for number in numbers:
            if number != parameter.nominal(scenario):
                changed = copy.deepcopy(scenario)
                parameter.change(changed, number)
                check_scenario(changed)
                conditions[f"{name}={number:g}"] = changed
    return conditions


def group_by_value(records: Iterable[Record], parameter: str) -> dict[float, list[Record]]:
    """Groups records by the value of a parameter in their conditions; leaves out other conditions."""
    groups: dict[float, list[Record]] = {}
    for record in records:
        name, _, value = record.get("condition", "").partition("=")
        if name == parameter:
            groups.setdefault(float(value), []).append(record)
    return groups
