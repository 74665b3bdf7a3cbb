"""The schema of scenarios: what loads, what comes back, and what is refused with which words."""

import copy
import dataclasses as dc
from pathlib import Path

import pytest
import yaml
from pydrake.common.yaml import yaml_dump_typed
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import GeortError, HandError, ScenarioError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.object_shape import object_shape
from geort_drake.simulation.scenario import (
    Scenario,
    default_scenario_file,
    dump_scenario,
    load_scenario,
    names_object,
    object_names,
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


def test_every_object_has_a_shape_the_planner_can_use():
    """All shipped objects load, stand on their support, and are made of convex primitives."""
    assert len(object_names()) >= 10
    for name in object_names():
        plant, scene_graph = AddMultibodyPlant(Scenario().plant_config, DiagramBuilder())
        body = add_object(plant, name)
        assert object_shape(plant, scene_graph.model_inspector(), body).parts


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
    ("text", "error", "message"),
    [
        ("{tiemout: 3}", ScenarioError, "tiemout"),
        ("{operator: {vision: 3}}", ScenarioError, "vision"),
        ("{timeout: soon}", ScenarioError, "text merged into scenario 'Grasp'.*soon"),
        ("{timeout: 0}", ScenarioError, "timeout must be positive, not 0"),
        ("{timeout: .nan}", ScenarioError, "timeout must be positive, not nan"),
        ("{plant_config: {time_step: -0.001}}", ScenarioError, "time_step must be positive"),
        (
            "{retargeting: {period: 0.003}}",
            ScenarioError,
            r"retargeting\.period \(0\.003 s\) must be a",
        ),
        ("{wrist_to_arm: {period: 0.005}}", ScenarioError, r"wrist_to_arm\.period .* multiple"),
        ("{monitor: {period: 0.0033}}", ScenarioError, r"monitor\.period .* multiple"),
        ("{recording: {period: 0.001}}", ScenarioError, r"recording\.period .* multiple"),
        ("{recording: {period: .inf}}", ScenarioError, r"recording\.period must be positive"),
        ("{operator: {period: 0.005, visual_delay: 0.2}}", ScenarioError, r"operator\.period .* multiple"),
        (
            "{retargeting: {latency: -0.001}}",
            ScenarioError,
            r"retargeting\.latency must be from 0 to 10 s",
        ),
        ("{operator: {visual_delay: 0.175}}", ScenarioError, r"visual_delay \(0\.175\) must be a multiple"),
        ("{operator: {tremor: -1}}", ScenarioError, r"operator\.tremor must be finite and not negative"),
        ("{operator: {overshoot: .nan}}", ScenarioError, r"operator\.overshoot must be finite"),
        ("{operator: {period: 0}}", ScenarioError, r"operator\.period"),
        ("{monitor: {hold_time: 0}}", ScenarioError, r"monitor\.hold_time must be positive"),
        ("{wrist_to_arm: {posture_gain: -1}}", ScenarioError, r"wrist_to_arm\.posture_gain must be positive"),
        ("{retargeting: {max_joint_speed: .inf}}", ScenarioError, r"max_joint_speed must be positive"),
        ("{object: {position: [0.5]}}", ScenarioError, r"object\.position must be \[x, y\]"),
        ("{object: {mass_range: 1.0}}", ScenarioError, r"object\.mass_range must be in \[0, 1\)"),
        ("{object: {mass_range: -0.1}}", ScenarioError, r"object\.mass_range must be in \[0, 1\)"),
        ("{object: {position: [.nan, 0]}}", ScenarioError, r"object\.position must be .* not \[nan, 0"),
        ("{object: {support_height: .nan}}", ScenarioError, r"object\.support_height must be finite"),
        ("{object: {position_range: -0.1}}", ScenarioError, r"object\.position_range must be .* not -0\.1"),
        ("{object: {yaw_range: .inf}}", ScenarioError, r"object\.yaw_range must be finite"),
        ("{object: {yaw: .nan}}", ScenarioError, r"object\.yaw must be finite, not nan"),
        ("{object: {mass_factor: 0}}", ScenarioError, r"object\.mass_factor must be positive, not 0"),
        ("{object: {friction_factor: -1}}", ScenarioError, r"object\.friction_factor must be positive"),
        ("{object: {friction_range: .nan}}", ScenarioError, r"object\.friction_range must be in \[0, 1\)"),
        ("{hand_stiffness_factor: .inf}", ScenarioError, r"hand_stiffness_factor must be positive, not inf"),
        ("{random_seed: -1}", ScenarioError, r"random_seed must be 0 or more, not -1"),
        ("{plant_config: {contact_model: glue}}", ScenarioError, r"plant_config: .*'glue'"),
        ("{operator: {period: .nan}}", ScenarioError, r"operator\.period must be finite"),
        ("{operator: {squeeze_time: 0}}", ScenarioError, r"operator\.squeeze_time must be positive, not 0"),
        ("{operator: {closing_lead: 0}}", ScenarioError, r"operator\.closing_lead must be positive, not 0"),
        ("{monitor: {period: .nan}}", ScenarioError, r"monitor\.period must be positive and finite, not nan"),
        (
            "{wrist_to_arm: {period: .inf}}",
            ScenarioError,
            r"wrist_to_arm\.period must be positive and finite",
        ),
        (
            "{wrist_to_arm: {joint_speed_share: 2}}",
            ScenarioError,
            r"joint_speed_share must be at most 1, not 2",
        ),
        ("{object: {name: teapot}}", UnknownNameError, r"unknown object 'teapot'; .*cube.*cylinder"),
        ("{object: {name: [}", ScenarioError, "Grasp"),
    ],
)
def test_wrong_values_are_refused_by_name(text, error, message):
    """The message names the field and what was wanted."""
    with pytest.raises(error, match=message):
        load_scenario(text=text)


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        ("A: {timeout: 3\nB", "no mapping of names to scenarios"),
        ("just words", "no mapping of names to scenarios"),
        ("", "no mapping of names to scenarios"),
        ("- a\n- b\n", "no mapping of names to scenarios"),
        ("Grasp: [1, 2]\n", "Grasp"),
        ("Grasp: {nonsense: 1}\n", "nonsense"),
    ],
)
def test_malformed_files_are_refused_by_name(tmp_path, contents, message):
    """A file that is no mapping of scenarios is named, with what is wrong."""
    path = tmp_path / "bad.scenarios.yaml"
    path.write_text(contents, encoding="utf-8")
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_a_binary_one_are_refused_by_name(tmp_path):
    """The path is in the message."""
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml does not exist"):
        load_scenario(tmp_path / "nowhere.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ScenarioError, match=r"binary\.yaml"):
        load_scenario(binary)


def test_what_a_loader_would_take_without_a_word_is_refused(tmp_path):
    """A field that is given twice, in the file or in the text; lists nested too deep; steps without end."""
    twice = tmp_path / "twice.yaml"
    twice.write_text("Grasp:\n  timeout: 5\n  object: {yaw: 0.1, yaw: 0.2}\n")
    with pytest.raises(
        ScenarioError, match=r"twice\.yaml: 'yaw' is given twice in the mapping from line 3 on"
    ):
        load_scenario(twice)
    with pytest.raises(ScenarioError, match=r"text merged into .* 'timeout' is given twice"):
        load_scenario(text="{timeout: 5, timeout: 6}")
    deep = tmp_path / "deep.yaml"
    deep.write_text("Grasp: " + "[" * 5000 + "]" * 5000)
    with pytest.raises(ScenarioError, match=r"deep\.yaml"):
        load_scenario(deep)
    with pytest.raises(ScenarioError, match=r"time_step must be at least 1e-05 s.*1e-12"):
        load_scenario(text="plant_config: {time_step: 1e-12}")


def test_an_unknown_scenario_lists_those_there_are():
    """The choices are in the message."""
    with pytest.raises(UnknownNameError, match=r"'Gras'.*Defaults, OneOfEverything"):
        load_scenario(SCENARIOS, "Gras")
    assert issubclass(UnknownNameError, GeortError)
    assert default_scenario_file().is_file()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("directives: []", ScenarioError, "must add a model named 'arm'"),
        (
            "directives: [{add_model: {name: arm, file: 'package://geort_drake/models/sdf/panda.sdf'}}]",
            ScenarioError,
            "hand_parent: .*no model instance named 'adapter'",
        ),
        (
            "directives: [{add_model: {name: arm, file: 'package://geort_drake/models/none.sdf'}}]",
            ScenarioError,
            "scenario field directives",
        ),
        ("arm_posture: {elbow: 0}", ScenarioError, "no joint 'elbow'; the joints are: panda_joint1"),
        ("hand_parent: adapter::arm_side", ScenarioError, "hand_parent: .*arm_side"),
        ("{hand: allegro_left, left_arm_posture: {elbow: 0}}", ScenarioError, "left_arm_posture.*'elbow'"),
        ("arm_posture: {panda_joint4: 0.5}", HandError, "panda_joint4 = 0.5 rad is outside its limits"),
    ],
)
def test_models_that_do_not_fit_are_refused_by_name(text, error, message):
    """What the schema cannot know is found when the robot is built."""
    scenario = load_scenario(text=text)
    with pytest.raises(error, match=message):
        add_robot(MultibodyPlant(0.002), scenario, load_hand(scenario.hand))
