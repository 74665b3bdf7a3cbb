"""Reads scenarios from YAML and checks them."""

import math
import os
from operator import attrgetter
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.settings import check_fields, fault_of, require_numbers
from geort_drake.simulation.person.engine import KINDS
from geort_drake.simulation.scenario import ObjectConfig, Scenario, object_file
from geort_drake.simulation.tasks import find_task
from geort_drake.systems.corrections import load_policy
from geort_drake.systems.joint_limits import check_timing

# Rule, its test, and the numeric fields to which it applies.
_RULES = (
    (
        "positive and finite",
        lambda value: 0 < value < math.inf,
        (
            "timeout",
            "plant_config.time_step",
            "retargeting.period",
            "retargeting.max_joint_speed",
            "retargeting.max_joint_acceleration",
            "recording_period",
            "object.mass_factor",
            "object.friction_factor",
        ),
    ),
    ("finite", math.isfinite, ("object.support_height", "object.yaw")),
    (
        "finite and not negative",
        lambda value: 0 <= value < math.inf,
        ("object.position_range", "object.yaw_range", "fingertip_modulus"),
    ),
    ("in [0, 1)", lambda value: 0 <= value < 1, ("object.mass_range", "object.friction_range")),
    ("0 or more", lambda value: value >= 0, ("random_seed", "person")),
)
_MIN_TIME_STEP = 1e-5  # s; with a shorter step, a trial would take hours
# Periods that must be multiples of the plant's time step.
_PERIODS = ("retargeting.period", "wrist_to_arm.period", "operator.period", "recording_period")


def check_scenario(scenario: Scenario) -> None:
    """Checks the values of a scenario.

    Raises:
        ScenarioError: a field is wrong; the message names it, the rule and the value.
        UnknownNameError: there is no such object, task, setting of the task or kind of person.
    """
    task = find_task(scenario.task)
    if scenario.kind not in KINDS:
        raise UnknownNameError("kind of person", scenario.kind, KINDS)
    for rule, holds, names in _RULES:
        for name in names:
            value = attrgetter(name)(scenario)
            _require(holds(value), name, rule, value)
    position = scenario.object.position
    is_point = len(position) == 2 and all(map(math.isfinite, position))
    _require(is_point, "object.position", "[x, y] in m", position)
    try:
        require_numbers(scenario.glove, "glove", may_be_zero=True)
        scenario.operator.validate()
        scenario.correction.validate()
        scenario.wrist_to_arm.validate()
        task.settings_of(scenario)
    except ValueError as error:
        raise ScenarioError(f"scenario field {error}") from error
    try:
        check_timing(scenario.retargeting.period, scenario.retargeting.latency, scenario.retargeting.cutoff)
    except ValueError as error:
        raise ScenarioError(f"scenario field retargeting.{error}") from error
    plant_config = scenario.plant_config
    step = plant_config.time_step
    _require(step >= _MIN_TIME_STEP, "plant_config.time_step", f"at least {_MIN_TIME_STEP} s", step)
    try:
        AddMultibodyPlant(plant_config, DiagramBuilder())
    except RuntimeError as error:
        raise ScenarioError(f"scenario field plant_config: {error}") from error
    _require(
        scenario.fingertip_modulus == 0 or plant_config.contact_model == "hydroelastic_with_fallback",
        "fingertip_modulus",
        "0 unless plant_config.contact_model is hydroelastic_with_fallback",
        scenario.fingertip_modulus,
    )
    for name in _PERIODS:
        period = attrgetter(name)(scenario)
        whole = abs(period / step - round(period / step)) <= 1e-6
        _require(whole, name, f"a multiple of plant_config.time_step ({step} s)", period)
    object_file(scenario.object.name)


def _require(holds: bool, name: str, rule: str, value: object) -> None:
    if not holds:
        raise ScenarioError(f"scenario field {name} must be {rule}, not {value}")


def load_scenario(
    file: str | os.PathLike | None = None,
    name: str | None = None,
    text: str | None = None,
    hand: str | None = None,
    task: str | None = None,
) -> Scenario:
    """Reads a scenario by name, merges YAML `text` into it, and checks the result.

    Mappings are merged and lists replaced, as in Drake's hardware_sim.

    Args:
        file: YAML file; by default the scenario is the task's own.
        name: name of the scenario in the file, by default Grasp.
        text: YAML mapping of the fields to change, such as "{timeout: 30}".
        hand: name or file of a hand's description, instead of the scenario's.
        task: name of a task, instead of the scenario's; without one, the defaults are those of grasp.

    Raises:
        ScenarioError: the file is missing or malformed, or a field is unknown or wrong.
        UnknownNameError: there is no scenario of that name, or see `check_scenario`.
        PolicyError: the policy that corrects commands cannot be run.
    """
    scenario = _load(file, name, text, task, Scenario())
    scenario.hand, scenario.task = hand or scenario.hand, task or scenario.task
    check_scenario(scenario)
    if scenario.correction.kind == "policy":
        load_policy(scenario.correction.policy, len(load_hand(scenario.hand).joint_names))
    return scenario


def names_object(
    file: str | os.PathLike | None = None, name: str | None = None, text: str | None = None
) -> bool:
    """Whether a scenario that `load_scenario` accepts, or the merged text, sets the object's name."""
    return bool(_load(file, name, text, None, Scenario(object=ObjectConfig(name=""))).object.name)


def _load(
    file: str | os.PathLike | None, name: str | None, text: str | None, task: str | None, defaults: Scenario
) -> Scenario:
    source = find_task(task or "grasp").scenario
    if file is None and isinstance(source, str):
        scenario = merged(source, None, f"the scenario of task {task}", defaults)
    else:
        default_file, default_name = ("", "Grasp") if isinstance(source, str) else source
        path, name = Path(file or default_file), name or default_name
        choices = scenario_names(path)
        if name not in choices:
            raise UnknownNameError(f"scenario of {path}:", name, choices)
        scenario = merged(path.read_text(encoding="utf-8"), name, f"scenario '{name}' in {path}", defaults)
    if text:
        scenario = merged(text, None, "the text merged into the scenario", scenario)
    return scenario


def scenario_names(path: Path) -> list[str]:
    """Returns the names of the scenarios in a file; raises ScenarioError if it is missing or malformed."""
    if not path.is_file():
        raise ScenarioError(f"scenario file {path} does not exist")
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(f"scenario file {path} must map names to scenarios: {fault_of(error)}") from error
    if not isinstance(node, yaml.MappingNode):
        raise ScenarioError(f"scenario file {path} must map names to scenarios")
    return [key.value for key, _ in node.value]


def merged(text: str, name: str | None, source: str, defaults: Scenario) -> Scenario:
    """Returns the defaults with YAML merged in: a scenario, or the one of that name in a mapping."""
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        if name is not None:
            node = dict((key.value, content) for key, content in node.value)[name]
        check_fields(node, Scenario)
        return yaml_load_typed(schema=Scenario, data=text, child_name=name, defaults=defaults)
    except Exception as error:  # Drake's loader raises many types for faulty YAML
        raise ScenarioError(f"{source}: {fault_of(error)}") from error
