"""The schema of scenarios: what loads, what comes back, and what is refused with which words."""

from pathlib import Path

import pytest
import yaml
from pydrake.multibody.plant import MultibodyPlant

from geort_drake import load_hand, load_scenario
from geort_drake.errors import HandError, ScenarioError
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.scenario import dump_scenario
from geort_drake.simulation.world import add_object, add_robot


def shipped() -> list[tuple[Path, str]]:
    """Every scenario of every file in diagrams/."""
    return [
        (file, name)
        for file in sorted(diagrams_dir().glob("*.scenarios.yaml"))
        for name in (node.value for node, _ in yaml.compose(file.read_text(encoding="utf-8")).value)
    ]


# -- what loads


@pytest.mark.parametrize(("file", "name"), shipped(), ids=lambda value: getattr(value, "stem", value))
def test_shipped_scenarios_load_their_models_fit_and_dumps_read_back_the_same(tmp_path, file, name):
    """What is written beside the results is the whole scenario."""
    text = "{random_seed: 12, object: {position: [0.1, 0.2]}, operator: {touch: false}, glove: {shift: 0.01}}"
    scenario = load_scenario(file, name, text)
    again = tmp_path / "scenario.yaml"
    again.write_text(dump_scenario(scenario), encoding="utf-8")
    assert dump_scenario(load_scenario(again, "Resolved")) == dump_scenario(scenario)
    plant = MultibodyPlant(scenario.plant_config.time_step)
    add_robot(plant, scenario, load_hand(scenario.hand))
    add_object(plant, scenario.object.name)
    plant.Finalize()
    assert plant.num_actuators() > 0


def test_text_is_merged_over_the_file():
    """Mappings merge and keep what the text does not name; lists replace; defaults stay as they were."""
    text = "{timeout: 3.0, object: {position: [0.1, 0.2]}, arm_posture: {panda_joint1: 0.5}}"
    before, scenario = load_scenario(), load_scenario(text=text)
    assert scenario.timeout == 3.0
    assert scenario.object.position == [0.1, 0.2]
    assert scenario.object.name == before.object.name
    assert scenario.arm_posture == before.arm_posture | {"panda_joint1": 0.5} != before.arm_posture
    assert load_scenario(text=text, hand="leap_right").hand == "leap_right"
    assert dump_scenario(load_scenario()) == dump_scenario(before)


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
    scenario = load_scenario(text=text)
    with pytest.raises(error, match=message):
        add_robot(MultibodyPlant(0.002), scenario, load_hand(scenario.hand))
