"""Scenarios: what loads, what is refused, and the plant of one with its object, friction and gravity."""

import numpy as np
import pytest
import trimesh
import yaml
from grasp_setup import scenario_with, stage_of
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geort_drake import load_hand, load_scenario
from geort_drake.errors import HandError, ScenarioError
from geort_drake.resources import diagrams_dir
from geort_drake.simulation.object_shape import ObjectShape
from geort_drake.simulation.scenario import dump_scenario
from geort_drake.simulation.task import Stage
from geort_drake.simulation.world import add_object, add_robot, draw_placement

SHIPPED = [
    (file, name)
    for file in sorted(diagrams_dir().glob("*.scenarios.yaml"))
    for name in yaml.safe_load(file.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(("file", "name"), SHIPPED, ids=lambda value: getattr(value, "stem", value))
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{tiemout: 3}", "unknown field 'tiemout'; choose one of: .*timeout"),
        ("{object: {nam: cube}}", "unknown field 'object.nam'; choose one of: .*name"),
        ("{timeout: long}", "field timeout must be a number; given: 'long'"),
        ("{object: {position: [0.5, left]}}", r"field object\.position\.1 must be a number; given: 'left'"),
        ("{object: cube}", "field object must be a mapping with some of: .*name.*; given: 'cube'"),
        ("{timeout: 3", r"line 1, column 12: expected ',' or '}', but got '<stream end>'$"),
        ("{timeout: .nan}", "timeout must be positive and finite, not nan"),
        ("{plant_config: {contact_model: glue}}", r"plant_config: .*'glue'"),
        ("{retargeting: {period: 0.003}}", r"retargeting\.period must be a multiple of .* not 0\.003"),
        ("{operator: {visual_delay: 0.175}}", r"visual_delay \(0\.175\) must be a multiple"),
        ("{wrist_to_arm: {joint_speed_share: 2}}", r"joint_speed_share must be at most 1, not 2"),
        ("{correction: {kind: magic}}", r"correction\.kind must be one of none, guard, policy"),
        ("{object: {mass_range: 1.0}}", r"object\.mass_range must be in \[0, 1\)"),
        ("directives: []", "must add a model named 'arm'"),
        ("arm_posture: {elbow: 0}", "no joint 'elbow'; the joints are: panda_joint1"),
        ("hand_parent: adapter::arm_side", "hand_parent: .*arm_side"),
        ("arm_posture: {panda_joint4: 0.5}", "panda_joint4 = 0.5 rad is outside its limits"),
    ],
)
def test_wrong_values_and_models_that_do_not_fit_are_refused_by_name(text, message):
    """When the scenario is loaded, or else when its robot is added to a plant."""
    error = HandError if "panda_joint4" in text else ScenarioError  # the limits are the model's
    with pytest.raises(error, match=message):
        scenario = load_scenario(text=text)
        add_robot(MultibodyPlant(0.002), scenario, load_hand(scenario.hand))


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"Grasp: " + b"[" * 5000 + b"]" * 5000, "must map names to scenarios"),
        (b"- Grasp", "must map names to scenarios"),
    ],
)
def test_malformed_files_are_refused_by_name(tmp_path, contents, message):
    path = tmp_path / "bad.scenarios.yaml"
    path.write_bytes(contents)
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)


def test_the_placement_is_the_seeds_and_within_its_ranges():
    """Position, yaw, mass and friction stay in the ranges and fill them; one seed gives one placement."""
    scenario = scenario_with("cylinder")
    config = scenario.object
    placements = [draw_placement(scenario, -0.05, np.random.default_rng(seed)) for seed in range(300)]
    poses, *factors = zip(*placements, strict=True)
    p = np.array([X_WO.translation() for X_WO in poses])
    offsets = p[:, :2] - config.position
    assert np.abs(offsets).max() <= config.position_range
    assert np.abs(offsets).max(axis=0).min() > 0.9 * config.position_range
    np.testing.assert_allclose(p[:, 2], config.support_height + 0.05, atol=1e-12)
    yaw = np.array([np.arctan2(*X_WO.rotation().matrix()[[1, 0], 0]) for X_WO in poses])
    assert 0.9 * config.yaw_range < np.abs(yaw).max() <= config.yaw_range
    for factor, largest in zip(factors, (config.mass_range, config.friction_range), strict=True):
        assert 0.9 * largest < np.abs(np.array(factor) - 1).max() <= largest == 0.2
    X_WO, *again = draw_placement(scenario, -0.05, np.random.default_rng(7))
    np.testing.assert_array_equal(X_WO.GetAsMatrix4(), poses[7].GetAsMatrix4())
    assert again == [factor[7] for factor in factors]


def test_friction_is_scaled_in_the_plant():
    """Only the object's coefficients are; and only the object feels gravity."""
    text = "{object: {friction_factor: 0.5}}"
    # Both have the same seed, and so the same draw of friction on top.
    scaled, nominal = (
        stage_of(DiagramBuilder(), scenario, load_hand(scenario.hand))
        for scenario in (scenario_with("cylinder", text), scenario_with("cylinder"))
    )

    def coefficients(stage: Stage) -> dict[str, float]:
        inspector = stage.scene_graph.model_inspector()
        return {
            inspector.GetName(geometry): inspector.GetProximityProperties(geometry)
            .GetProperty("material", "coulomb_friction")
            .dynamic_friction()
            for geometry in inspector.GetAllGeometryIds(Role.kProximity)
        }

    before, after = coefficients(nominal), coefficients(scaled)
    changed = {name: after[name] / before[name] for name in before if after[name] != before[name]}
    assert set(changed) == {name for name in before if name.startswith("cylinder::")} != set()
    np.testing.assert_allclose(list(changed.values()), 0.5)
    # The controllers compensate the weight of arm and hand.
    for model in (nominal.arm, nominal.hand):
        assert not nominal.plant.is_gravity_enabled(model)
    assert nominal.plant.is_gravity_enabled(nominal.handled.body.model_instance())


BALL = trimesh.creation.icosphere(subdivisions=7, radius=1.0).vertices
# Each shape, and points of its surface among which the lowest one is, to a micrometre or so.
SHAPES = {
    "box": (Box(0.1, 0.2, 0.3), trimesh.creation.box((0.1, 0.2, 0.3)).vertices),
    "sphere": (Sphere(0.03), 0.03 * BALL),
    "ellipsoid": (Ellipsoid(0.03, 0.05, 0.01), [0.03, 0.05, 0.01] * BALL),
    "cylinder": (Cylinder(0.02, 0.1), trimesh.creation.cylinder(0.02, 0.1, sections=3600).vertices),
    "capsule": (Capsule(0.02, 0.1), np.concatenate([0.02 * BALL + [0, 0, z] for z in (-0.05, 0.05)])),
}


def pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform(RollPitchYaw(rng.uniform(-np.pi, np.pi, 3)), rng.uniform(-1, 1, 3))


@pytest.mark.parametrize("names", [*((name,) for name in SHAPES), tuple(SHAPES)])
def test_no_point_of_the_surface_is_lower(names):
    """Of every shape, and of all of them in one object."""
    rng = np.random.default_rng(1)
    for _ in range(3):
        X_WO, placed = pose(rng), [(SHAPES[name], pose(rng)) for name in names]
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
        body = plant.AddRigidBody("thing")
        for number, ((primitive, _), X_OG) in enumerate(placed):
            plant.RegisterCollisionGeometry(body, X_OG, primitive, str(number), CoulombFriction(1.0, 1.0))
        shape = ObjectShape(plant, scene_graph.model_inspector(), body)
        lowest = min((X_WO @ X_OG).multiply(points.T)[2].min() for (_, points), X_OG in placed)
        assert shape.lowest_point(X_WO) == pytest.approx(lowest, abs=3e-6)
        assert shape.lowest_point(X_WO) <= lowest + 1e-12


def test_an_object_without_usable_geometry_is_refused_by_name():
    plane = "<collision name='m'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>"
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    sdf = f"<sdf version='1.11'><model name='thing'><link name='thing'>{plane}</link></model></sdf>"
    Parser(plant).AddModelsFromString(sdf, "sdf")
    with pytest.raises(ScenarioError, match=r"object 'thing' needs .* Box, Capsule, .* it has: HalfSpace"):
        ObjectShape(plant, scene_graph.model_inspector(), plant.GetBodyByName("thing"))
