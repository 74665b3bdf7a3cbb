"""The lowest point of an object, on which the monitor's verdict rests."""

import itertools

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import ScenarioError
from geort_drake.simulation.object_shape import ObjectShape, object_shape

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
    "capsule": (
        Capsule(0.02, 0.1),
        np.concatenate([0.02 * _DIRECTIONS + [0, 0, z] for z in (-0.05, 0.05)]),
    ),
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
    """The message names the object, the shapes that can be used, and those it has."""
    plane = "<collision name='m'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>"
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    sdf = f"<sdf version='1.11'><model name='thing'><link name='thing'>{plane}</link></model></sdf>"
    Parser(plant).AddModelsFromString(sdf, "sdf")
    with pytest.raises(ScenarioError, match=r"object 'thing' needs .* Box, Capsule, .* it has: HalfSpace"):
        object_shape(plant, scene_graph.model_inspector(), plant.GetBodyByName("thing"))
