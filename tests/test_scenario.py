"""The schema of scenarios: what loads, what comes back, and what is refused with which words."""

import copy
import dataclasses as dc
from pathlib import Path

import pytest
import yaml
from pydrake.common.yaml import yaml_dump_typed
from pydrake.multibody.plant import MultibodyPlant

from geort_drake.errors import HandError, ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.scenario import (
    Scenario,
    dump_scenario,
    load_scenario,
    names_object,
)
from geort_drake.simulation.world import add_object, add_robot

SCENARIOS = Path(__file__).parent / "scenarios" / "test.scenarios.yaml"


def shipped() -> list[tuple[Path, str]]:
    """Every scenario of every file in diagrams/."""
    return [
        (file, name)
        for file in sorted(diagrams_dir().glob("*.scenarios.yaml"))
        for name in (node.value for node, _ in yaml.compose(file.read_text(encoding="utf-8")).value)
    ]


def given_leaves(schema, given: dict, path: str = ""):
    """Yields (path, value of the schema, value of the YAML) and checks that no field was left out."""
    names = {field.name for field in dc.fields(schema)}
    assert names == set(given), f"{path or 'scenario'}: {sorted(names ^ set(given))} only on one side"
    for name in names:
        value = getattr(schema, name)
        if dc.is_dataclass(value):
            yield from given_leaves(value, given[name], f"{path}{name}.")
        else:
            yield f"{path}{name}", value, given[name]


# -- what loads


@pytest.mark.parametrize(("file", "name"), shipped(), ids=lambda value: getattr(value, "stem", value))
def test_shipped_scenarios_load_and_their_models_fit(file, name):
    """Every scenario of the package passes its own checks, and its robot and object can be built."""
    scenario = load_scenario(file, name)
    plant = MultibodyPlant(scenario.plant_config.time_step)
    add_robot(plant, scenario, load_hand(scenario.hand))
    add_object(plant, scenario.object.name)
    plant.Finalize()
    assert plant.num_actuators() > 0


def test_an_empty_scenario_is_all_defaults():
    """`Name: {}` gives the values documented in the schema."""
    assert yaml_dump_typed(load_scenario(SCENARIOS, "Defaults")) == yaml_dump_typed(Scenario())


def test_every_field_can_be_set():
    """Each field of the schema is in the file, is read from it, and is not its default."""
    scenario = load_scenario(SCENARIOS, "OneOfEverything")
    given = yaml.safe_load(SCENARIOS.read_text(encoding="utf-8"))["OneOfEverything"]
    plant_config, directives = given["plant_config"], given["directives"]
    for key, value in plant_config.items():
        assert getattr(scenario.plant_config, key) == value
        assert getattr(Scenario().plant_config, key) != value
    assert scenario.directives[0].add_directives.file == directives[0]["add_directives"]["file"]
    defaults = {path: value for path, value, _ in given_leaves(Scenario(), given)}
    for path, value, wanted in given_leaves(scenario, given):
        if path not in ("plant_config", "directives"):
            assert value == wanted, path
            assert value != defaults[path], f"{path} is given its default, so reading it is not tested"


def test_text_is_merged_over_the_file():
    """Mappings merge and keep what the text does not name; lists replace."""
    text = "{timeout: 3.0, object: {position: [0.1, 0.2]}, arm_posture: {panda_joint1: 0.5}}"
    scenario = load_scenario(SCENARIOS, "OneOfEverything", text)
    assert scenario.timeout == 3.0
    assert scenario.object.position == [0.1, 0.2]
    assert scenario.object.name == "cube"
    assert scenario.arm_posture == {"panda_joint1": 0.5, "panda_joint4": -2.0}
    assert load_scenario(SCENARIOS, "OneOfEverything", text, hand="leap_right").hand == "leap_right"


def test_a_scenario_says_whether_it_names_its_object(tmp_path):
    """In the file, in the text, or in what the file merges into it; another field of the object does not."""
    file = tmp_path / "own.scenarios.yaml"
    file.write_text(
        "Base: &base {object: {name: cube}}\nNamed: {<<: *base, timeout: 3}\nBare: {object: {yaw: 0.1}}\n"
    )
    assert load_scenario(file, "Named").object.name == "cube"
    assert names_object(file, "Named") and names_object(file, "Base")
    assert not names_object(file, "Bare")
    assert names_object(file, "Bare", "{object: {name: bottle}}")
    assert not names_object(file, "Bare", "{timeout: 3}")
    assert not names_object()


def test_loading_leaves_the_defaults_alone():
    """Neither the schema's defaults nor an earlier result change when another scenario is read."""
    before = yaml_dump_typed(Scenario())
    first = load_scenario(SCENARIOS, "OneOfEverything")
    copied = yaml_dump_typed(copy.deepcopy(first))
    second = load_scenario(SCENARIOS, "OneOfEverything", "{object: {position: [9, 9]}, timeout: 1}")
    second.object.position[0] = -5.0
    second.arm_posture["another"] = 1.0
    assert yaml_dump_typed(first) == copied
    assert yaml_dump_typed(Scenario()) == before


@pytest.mark.parametrize(
    ("file", "name"), [(SCENARIOS, "OneOfEverything"), (SCENARIOS, "Defaults"), (None, "Grasp")]
)
def test_a_dumped_scenario_reads_back_the_same(tmp_path, file, name):
    """What is written beside the results is the whole scenario."""
    scenario = load_scenario(file, name, "random_seed: 12")
    again = tmp_path / "scenario.yaml"
    again.write_text(dump_scenario(scenario), encoding="utf-8")
    assert dump_scenario(load_scenario(again, "Resolved")) == dump_scenario(scenario)


# -- what is refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{tiemout: 3}", "tiemout"),
        ("{timeout: .nan}", "timeout must be positive and finite, not nan"),
        ("{plant_config: {contact_model: glue}}", r"plant_config: .*'glue'"),
        ("{retargeting: {period: 0.003}}", r"retargeting\.period must be a multiple of .* not 0\.003"),
        ("{operator: {visual_delay: 0.175}}", r"visual_delay \(0\.175\) must be a multiple"),
        ("{wrist_to_arm: {joint_speed_share: 2}}", r"joint_speed_share must be at most 1, not 2"),
        ("{correction: {kind: magic}}", r"correction\.kind must be one of none, guard, policy"),
        ("{object: {mass_range: 1.0}}", r"object\.mass_range must be in \[0, 1\)"),
        ("{timeout: 5, timeout: 6}", "text merged into .* 'timeout' is given twice"),
    ],
)
def test_wrong_values_are_refused_by_name(text, message):
    """The message names the field, the rule and the value."""
    with pytest.raises(ScenarioError, match=message):
        load_scenario(text=text)


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"- a\n- b\n", "must map names to scenarios"),
        (b"Grasp: " + b"[" * 5000 + b"]" * 5000, "must map names to scenarios"),
        (b"Grasp:\n  timeout: 5\n  object: {yaw: 0.1, yaw: 0.2}\n", "'yaw' is given twice in .* line 3"),
    ],
)
def test_malformed_files_are_refused_by_name(tmp_path, contents, message):
    """The message names the file and the fault."""
    path = tmp_path / "bad.scenarios.yaml"
    path.write_bytes(contents)
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("directives: []", ScenarioError, "must add a model named 'arm'"),
        ("arm_posture: {elbow: 0}", ScenarioError, "no joint 'elbow'; the joints are: panda_joint1"),
        ("hand_parent: adapter::arm_side", ScenarioError, "hand_parent: .*arm_side"),
        ("arm_posture: {panda_joint4: 0.5}", HandError, "panda_joint4 = 0.5 rad is outside its limits"),
    ],
)
def test_models_that_do_not_fit_are_refused_by_name(text, error, message):
    """When the robot is built."""
    scenario = load_scenario(text=text)
    with pytest.raises(error, match=message):
        add_robot(MultibodyPlant(0.002), scenario, load_hand(scenario.hand))
