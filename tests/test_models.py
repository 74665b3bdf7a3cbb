"""Every model in models/sdf, and the objects."""

import numpy as np
import pytest
from model_scene import OBJECTS, SDF_FILES, Scene
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator

from geort_drake.resources import models_dir
from geort_drake.simulation.object_shape import half_extents

# The manufacturer's masses in kg: palm, three fingers and a thumb with four links and a tip each.
ALLEGRO_MASSES = [0.4154, *3 * (0.0119, 0.065, 0.0355, 0.0096, 0.0168), 0.0176, 0.0119, 0.038, 0.0388, 0.0168]


@pytest.mark.parametrize("path", SDF_FILES, ids=lambda path: path.stem)
def test_every_link_is_physically_possible(path):
    """Every model parses strictly; every link has a positive mass and a valid spatial inertia."""
    scene = Scene(path)
    bodies = [scene.plant.get_body(BodyIndex(i)) for i in range(1, scene.plant.num_bodies())]
    assert bodies
    for body in bodies:
        assert body.default_mass() > 0, body.name()
        assert body.default_spatial_inertia().IsPhysicallyValid(), body.name()
        assert np.linalg.norm(body.default_com()) < 0.5, body.name()


def test_total_masses_are_those_of_the_hardware(allegro, allegro_left, leap, panda):
    """The hands weigh the sum of the published link masses, the arm 17.99 kg."""
    for hand, mass in ((allegro, sum(ALLEGRO_MASSES)), (allegro_left, sum(ALLEGRO_MASSES)), (leap, 0.746)):
        assert hand.plant.CalcTotalMass(hand.plant.CreateDefaultContext()) == pytest.approx(mass)
    assert panda.plant.CalcTotalMass(panda.context) == pytest.approx(17.99)


@pytest.mark.parametrize("path", SDF_FILES, ids=lambda path: path.stem)
def test_models_are_self_contained(path):
    """No model refers to a mesh, a texture, another package or an address."""
    text = path.read_text(encoding="utf-8").replace("http://drake.mit.edu", "")
    for reference in ("<mesh", "<uri", "package://", "drake_models", "http", "<include"):
        assert reference not in text


def test_the_objects_differ_in_size_and_mass():
    """A wide, a tall, a tiny (2 cm) and a heavy (0.5 kg) one are among them, all of plausible density."""
    sizes, masses = {}, {}
    for path in OBJECTS:
        scene = Scene(path)
        body, inspector = scene.plant.GetBodyByName(path.stem), scene.scene_graph.model_inspector()
        masses[path.stem] = body.default_mass()
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for id in inspector.GetGeometries(scene.plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity):
            centre, half = inspector.GetPoseInFrame(id).translation(), half_extents(inspector.GetShape(id))
            low, high = np.minimum(low, centre - half), np.maximum(high, centre + half)
            friction = inspector.GetProximityProperties(id).GetProperty("material", "coulomb_friction")
            assert 0.5 <= friction.static_friction() <= 1.0
        sizes[path.stem] = high - low
        # From a foam to a stone, by the box around it.
        assert 50 < masses[path.stem] / np.prod(high - low) < 3000
    assert sizes["wide_box"][0] == pytest.approx(0.09) and sizes["wide_box"].argmax() == 0
    assert max(size[2] for size in sizes.values()) == pytest.approx(0.2)
    assert sizes["block_tiny"] == pytest.approx([0.02] * 3)
    assert max(masses.values()) == masses["can_heavy"] == 0.5


@pytest.mark.parametrize("path", OBJECTS, ids=lambda path: path.stem)
def test_objects_stand_on_the_plinth(path):
    """An object released on the plinth moves by less than 1 mm and turns by less than 0.5° in 1 s."""
    scene = Scene(models_dir() / "sdf" / "plinth.sdf", path, welded=("plinth_base",))
    body = scene.plant.GetBodyByName(path.stem)
    lowest = _lowest_point(scene, body)
    start = RigidTransform(RotationMatrix.MakeZRotation(0.3), [0.01, -0.005, 0.1 - lowest])
    scene.plant.SetFreeBodyPose(scene.context, body, start)
    simulator = Simulator(scene.diagram, scene.root)
    simulator.AdvanceTo(1.0)
    moved = start.inverse() @ scene.plant.EvalBodyPoseInWorld(scene.context, body)
    assert np.linalg.norm(moved.translation()) < 1e-3
    assert abs(moved.rotation().ToAngleAxis().angle()) < np.deg2rad(0.5)
    speed = scene.plant.EvalBodySpatialVelocityInWorld(scene.context, body)
    assert np.linalg.norm(speed.translational()) < 1e-3


def _lowest_point(scene: Scene, body) -> float:
    """z in the body frame of the lowest point of its collision geometry, by bisecting on contact."""
    inspector = scene.scene_graph.model_inspector()
    frame = scene.plant.GetBodyFrameIdOrThrow(body.index())
    low, high = 0.0, 0.5  # heights of the body above the plinth: touching, clear
    assert inspector.GetGeometries(frame, Role.kProximity)
    while high - low > 1e-7:
        middle = (low + high) / 2
        scene.plant.SetFreeBodyPose(scene.context, body, RigidTransform([0, 0, 0.1 + middle]))
        low, high = (middle, high) if scene.collides() else (low, middle)
    return -high
