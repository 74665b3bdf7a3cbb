"""The plant of a scenario: the object's place, weight, friction and lowest point, and who feels gravity."""

import itertools
from functools import cache

import numpy as np
import pytest
from grasp_setup import scenario_with
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError
from geort_drake.hands.description import load_hand
from geort_drake.simulation.object_shape import ObjectShape, object_shape
from geort_drake.simulation.scenario import Scenario
from geort_drake.simulation.world import ObjectScene, add_scene, draw_placement


def scene_of(scenario: Scenario) -> ObjectScene:
    return add_scene(DiagramBuilder(), scenario, load_hand(scenario.hand), np.random.default_rng(0))


@cache
def nominal_scene() -> ObjectScene:
    return scene_of(scenario_with("cylinder"))


def test_the_placement_is_the_seeds_and_within_its_ranges():
    """Position, yaw, mass and friction stay in the ranges and fill them; one seed gives one placement."""
    scenario = scenario_with("cylinder")
    config = scenario.object
    placements = [draw_placement(scenario, -0.05, np.random.default_rng(seed)) for seed in range(300)]
    p = np.array([placement.X_WO.translation() for placement in placements])
    offsets = p[:, :2] - config.position
    assert np.abs(offsets).max() <= config.position_range
    assert np.abs(offsets).max(axis=0).min() > 0.9 * config.position_range
    np.testing.assert_allclose(p[:, 2], config.support_height + 0.05, atol=1e-12)
    yaw = np.array([np.arctan2(*placement.X_WO.rotation().matrix()[[1, 0], 0]) for placement in placements])
    assert 0.9 * config.yaw_range < np.abs(yaw).max() <= config.yaw_range
    for name, largest in (("mass_factor", config.mass_range), ("friction_factor", config.friction_range)):
        factor = np.array([getattr(placement, name) for placement in placements])
        assert 0.9 * largest < np.abs(factor - 1).max() <= largest == 0.2
    again = draw_placement(scenario, -0.05, np.random.default_rng(7))
    np.testing.assert_array_equal(again.X_WO.GetAsMatrix4(), placements[7].X_WO.GetAsMatrix4())
    assert again.friction_factor == placements[7].friction_factor


def test_friction_and_stiffness_are_scaled_in_the_plant():
    """Only the object's coefficients and the hand's gains; and only the object feels gravity."""
    text = "{hand_stiffness_factor: 4.0, object: {friction_factor: 0.5}}"
    # Both have the same seed, and so the same draw of friction on top.
    scaled, nominal = scene_of(scenario_with("cylinder", text)), nominal_scene()

    def coefficients(scene: ObjectScene) -> dict[str, float]:
        inspector = scene.scene_graph.model_inspector()
        return {
            inspector.GetName(geometry): inspector.GetProximityProperties(geometry)
            .GetProperty("material", "coulomb_friction")
            .dynamic_friction()
            for geometry in inspector.GetAllGeometryIds(Role.kProximity)
        }

    def gains(scene: ObjectScene) -> dict[str, tuple[float, float]]:
        indices = scene.plant.GetJointActuatorIndices()
        actuators = [scene.plant.get_joint_actuator(index) for index in indices]
        return {a.name(): (a.get_controller_gains().p, a.get_controller_gains().d) for a in actuators}

    before, after = coefficients(nominal), coefficients(scaled)
    changed = {name: after[name] / before[name] for name in before if after[name] != before[name]}
    assert set(changed) == {name for name in before if name.startswith("cylinder::")} != set()
    np.testing.assert_allclose(list(changed.values()), 0.5)
    indices = nominal.plant.GetJointActuatorIndices(nominal.hand)
    of_hand = {nominal.plant.get_joint_actuator(index).name() for index in indices}
    stiff = gains(scaled)
    for name, (p, d) in gains(nominal).items():
        assert stiff[name] == pytest.approx((4 * p, 2 * d) if name in of_hand else (p, d))
    # The controllers compensate the weight of arm and hand.
    for model in (nominal.arm, nominal.hand):
        assert not nominal.plant.is_gravity_enabled(model)
    assert nominal.plant.is_gravity_enabled(nominal.object_body.model_instance())


_DIRECTIONS = np.random.default_rng(0).normal(size=(100_000, 3))
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_ANGLE = np.linspace(0, 2 * np.pi, 3601)
_RIM = 0.02 * np.column_stack([np.cos(_ANGLE), np.sin(_ANGLE), 0 * _ANGLE])
# Each shape, and points of its surface among which the lowest one is, to a micrometre or so.
SHAPES = {
    "box": (
        Box(0.1, 0.2, 0.3),
        0.5 * np.array(list(itertools.product((-0.1, 0.1), (-0.2, 0.2), (-0.3, 0.3)))),
    ),
    "sphere": (Sphere(0.03), 0.03 * _DIRECTIONS),
    "ellipsoid": (Ellipsoid(0.03, 0.05, 0.01), [0.03, 0.05, 0.01] * _DIRECTIONS),
    "cylinder": (Cylinder(0.02, 0.1), np.concatenate([_RIM + [0, 0, 0.05], _RIM - [0, 0, 0.05]])),
    "capsule": (Capsule(0.02, 0.1), np.concatenate([0.02 * _DIRECTIONS + [0, 0, z] for z in (-0.05, 0.05)])),
}


def pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform(RollPitchYaw(rng.uniform(-np.pi, np.pi, 3)), rng.uniform(-1, 1, 3))


@pytest.mark.parametrize("names", [*((name,) for name in SHAPES), tuple(SHAPES)])
def test_no_point_of_the_surface_is_lower(names):
    """Of every shape, and of all of them in one object."""
    rng = np.random.default_rng(1)
    for _ in range(3):
        X_WO, placed = pose(rng), [(SHAPES[name], pose(rng)) for name in names]
        shape = ObjectShape(tuple((primitive, X_OG) for (primitive, _), X_OG in placed))
        lowest = min((X_WO @ X_OG).multiply(points.T)[2].min() for (_, points), X_OG in placed)
        assert shape.lowest_point(X_WO) == pytest.approx(lowest, abs=3e-6)
        assert shape.lowest_point(X_WO) <= lowest + 1e-12


def test_an_object_without_usable_geometry_is_refused_by_name():
    plane = "<collision name='m'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>"
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    sdf = f"<sdf version='1.11'><model name='thing'><link name='thing'>{plane}</link></model></sdf>"
    Parser(plant).AddModelsFromString(sdf, "sdf")
    with pytest.raises(ScenarioError, match=r"object 'thing' needs .* Box, Capsule, .* it has: HalfSpace"):
        object_shape(plant, scene_graph.model_inspector(), plant.GetBodyByName("thing"))
