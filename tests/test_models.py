"""The robots, the furniture and the objects in models/sdf, against data sheets and physics."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.resources import models_dir
from geort_drake.simulation.object_shape import half_extents

FACTS_DIR = Path(__file__).resolve().parents[2] / "shared" / "facts"
SDF_FILES = sorted((models_dir() / "sdf").rglob("*.sdf"))
OBJECTS = sorted((models_dir() / "sdf" / "objects").glob("*.sdf"))

# Sphere centres in mm, rounded to 0.01 mm, from the manufacturer's description evaluated independently;
# joint_0 to joint_15.
ALLEGRO_TIPS = {
    "zero": (
        [0.0] * 16,
        {
            "index": [0.0, 55.31, 133.44],
            "middle": [0.0, 0.0, 136.2],
            "ring": [0.0, -55.31, 133.44],
            "thumb": [-13.2, 167.7, -86.07],
        },
    ),
    "random": (
        [0.118, 1.424, 1.287, 0.189, -0.188, 1.382, -0.164, 1.288]
        + [0.279, 0.649, 0.397, 0.287, 0.552, 0.459, 0.736, 0.879],
        {
            "index": [75.31, 49.21, -38.7],
            "middle": [103.08, -19.61, 19.02],
            "ring": [88.27, -25.71, 85.29],
            "thumb": [64.22, 82.19, -9.51],
        },
    ),
}
# Origins in mm of the flange, panda_link8, from the Denavit-Hartenberg table of Franka's documentation.
PANDA_FLANGE = {
    "zero": ([0.0] * 7, [88.0, 0.0, 926.0]),
    "ready": ([0.0, -0.7854, 0.0, -2.35619, 0.0, 1.5708, 0.7854], [306.89, 0.0, 590.28]),
    "random": ([-2.829, -1.084, 1.113, -2.47, -0.756, -0.003, 1.912], [82.47, -199.32, 537.83]),
}
# Franka's modified Denavit-Hartenberg parameters a, d in m and alpha in rad, frame 1 to flange.
PANDA_DH = [
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
    (0.0, 0.107, 0.0),
]
# The manufacturer's masses in kg: palm, three fingers and a thumb with four links and a tip each.
ALLEGRO_MASSES = [0.4154, *3 * (0.0119, 0.065, 0.0355, 0.0096, 0.0168), 0.0176, 0.0119, 0.038, 0.0388, 0.0168]


class Scene:
    """Models in a finalized discrete plant; the first link of each named file is welded to the world."""

    def __init__(self, *paths: Path, welded: tuple[str, ...] = ()):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="sap")
        self.plant, self.scene_graph = AddMultibodyPlant(config, builder)
        parser = Parser(self.plant)
        # A model that reaches for something outside the package, or that Drake only half understands, fails.
        parser.SetStrictParsing()
        for path in paths:
            parser.AddModels(path)
        for link in welded:
            self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(link))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def set_joints(self, positions: dict[str, float]) -> None:
        for name, value in positions.items():
            self.plant.GetJointByName(name).set_angle(self.context, value)

    def collides(self) -> bool:
        return self.plant.get_geometry_query_input_port().Eval(self.context).HasCollisions()


@pytest.fixture(scope="module")
def panda() -> Scene:
    return Scene(models_dir() / "sdf" / "panda.sdf", welded=("panda_link0",))


@pytest.fixture(scope="module")
def allegro() -> HandModel:
    return HandModel(load_hand("allegro_right"))


def _facts(name: str) -> dict:
    path = FACTS_DIR / name
    if not path.is_file():
        pytest.skip(f"the facts {name} are not at hand")
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _tips_mm(hand: HandModel, by_number: list[float]) -> dict[str, np.ndarray]:
    named = {f"joint_{i}": angle for i, angle in enumerate(by_number)}
    tips = hand.fingertips(np.array([named[name] for name in hand.joint_names]))
    return dict(zip(hand.finger_names, tips * 1e3, strict=True))


@pytest.mark.parametrize("case", ALLEGRO_TIPS)
def test_allegro_fingertips_agree_with_the_manufacturers_description(allegro, case):
    """Exact kinematics reproduce independently computed fingertip points to 0.1 mm."""
    q, wanted = ALLEGRO_TIPS[case]
    for finger, tip in _tips_mm(allegro, q).items():
        np.testing.assert_allclose(tip, wanted[finger], atol=0.1)


def test_allegro_agrees_with_the_fact_sheet(allegro):
    """Every forward-kinematics check, joint limit and mass of the fact sheet holds."""
    facts = _facts("allegro.yaml")
    for case in facts["fk_check"].values():
        for finger, tip in _tips_mm(allegro, case["q"]).items():
            np.testing.assert_allclose(tip, case["sphere_center_mm"][finger], atol=0.1)
    limits = {
        joint["name"].removesuffix(".0"): (joint["lower_rad"], joint["upper_rad"])
        for joint in facts["kinematics_right"]
        if joint["type"] == "revolute"
    }
    assert len(limits) == 16
    for name, lower, upper in zip(allegro.joint_names, allegro.lower, allegro.upper, strict=True):
        assert (lower, upper) == pytest.approx(limits[name], abs=1e-9)


@pytest.mark.parametrize("case", PANDA_FLANGE)
def test_panda_flange_agrees_with_the_data_sheet(panda, case):
    """The flange lies where Franka's link table puts it, to 0.1 mm."""
    q, wanted = PANDA_FLANGE[case]
    panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(q)})
    flange = panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context)
    np.testing.assert_allclose(flange.translation() * 1e3, wanted, atol=0.1)


def test_panda_agrees_with_its_denavit_hartenberg_table(panda, rng):
    """The flange's pose is the product of Franka's link transforms, for any joint positions."""
    for q in rng.uniform(-2, 2, (20, 7)):
        panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(q)})
        X = RigidTransform()
        for (a, d, alpha), theta in zip(PANDA_DH, [*q, 0.0], strict=True):
            X = X @ RigidTransform(RotationMatrix.MakeXRotation(alpha), [a, 0, 0])
            X = X @ RigidTransform(RotationMatrix.MakeZRotation(theta), [0, 0, 0])
            X = X @ RigidTransform([0, 0, d])
        flange = panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context)
        np.testing.assert_allclose(flange.GetAsMatrix4(), X.GetAsMatrix4(), atol=1e-9)


def test_panda_agrees_with_the_fact_sheet(panda):
    """Link origins, flange orientation and all limits of the fact sheet hold."""
    facts = _facts("panda.yaml")
    for case in facts["fk_check"].values():
        panda.set_joints({f"panda_joint{i + 1}": angle for i, angle in enumerate(case["q"])})
        for link, origin in case["link_origins_mm"].items():
            X_WL = panda.plant.GetFrameByName(link).CalcPoseInWorld(panda.context)
            np.testing.assert_allclose(X_WL.translation() * 1e3, origin, atol=0.1)
        R = panda.plant.GetFrameByName("panda_link8").CalcPoseInWorld(panda.context).rotation().matrix()
        np.testing.assert_allclose(R, case["link8_rotation_rowmajor"], atol=1e-4)
    for fact in facts["kinematics"][:7]:
        joint = panda.plant.GetJointByName(fact["name"])
        assert joint.position_lower_limit() == fact["lower_rad"]
        assert joint.position_upper_limit() == fact["upper_rad"]
        assert joint.velocity_upper_limit() == fact["velocity_rad_s"]
        assert joint.acceleration_upper_limit() == fact["acceleration_rad_s2"]
        actuator = panda.plant.GetJointActuatorByName(fact["name"])
        assert actuator.effort_limit() == fact["effort_Nm"]
        reflected = actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia()
        assert reflected == pytest.approx(facts["reflected_inertia_kgm2"][fact["name"]], rel=1e-6)


def test_allegro_collides_with_itself_as_often_as_its_meshes_do(allegro, rng):
    """A third of uniform joint positions collide: 34.3 %, measured once on the same primitives elsewhere."""
    rate = allegro.collides(rng.uniform(allegro.lower, allegro.upper, (20_000, 16))).mean()
    assert rate == pytest.approx(0.3431, abs=0.01)


def test_panda_collides_with_itself_as_often_as_its_meshes_do(panda, rng):
    """3.2 % of uniform joint positions collide; exact triangle tests of Franka's meshes give 2.9 %."""
    joints = [panda.plant.GetJointByName(f"panda_joint{i}") for i in range(1, 8)]
    limits = [(joint.position_lower_limit(), joint.position_upper_limit()) for joint in joints]
    hits = 0
    for q in rng.uniform(*np.transpose(limits), (5000, 7)):
        panda.set_joints({joint.name(): angle for joint, angle in zip(joints, q, strict=True)})
        hits += panda.collides()
    assert hits / 5000 == pytest.approx(0.0321, abs=0.01)


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


def test_total_masses_are_those_of_the_hardware(allegro, panda):
    """The hand weighs the sum of the manufacturer's link masses, the arm 17.99 kg."""
    context = allegro.plant.CreateDefaultContext()
    assert allegro.plant.CalcTotalMass(context) == pytest.approx(sum(ALLEGRO_MASSES))
    assert panda.plant.CalcTotalMass(panda.context) == pytest.approx(17.99)


def test_every_finger_weighs_on_its_joints(allegro):
    """The mass of a link with its tip lies beyond its joint, and merging keeps the tip's mass."""
    link = allegro.plant.GetBodyByName("link_3")
    assert link.default_mass() == pytest.approx(0.0096 + 0.0168)
    # Two point masses: the link's own at 9.59 mm, the tip's at 26.7 - 1.21 mm.
    wanted = (0.0096 * 9.59 + 0.0168 * 25.49) / 0.0264
    assert link.default_com()[2] * 1e3 == pytest.approx(wanted, abs=0.01)


def test_default_positions_lie_inside_the_limits_and_free_of_contact(allegro):
    """The pose a hand is loaded in respects every limit, joint_12's positive lower limit included."""
    q = allegro.default_position
    assert ((allegro.lower <= q) & (q <= allegro.upper)).all()
    assert allegro.lower[allegro.joint_names.index("joint_12")] > 0
    assert not allegro.collides(q)


def test_allegro_actuators_hold_their_position(allegro):
    """All sixteen joints have an actuator with implicit PD gains of 1 and 0.1 and 0.7 N·m."""
    actuators = [allegro.plant.get_joint_actuator(index) for index in allegro.plant.GetJointActuatorIndices()]
    assert sorted(actuator.joint().name() for actuator in actuators) == sorted(allegro.joint_names)
    for actuator in actuators:
        assert actuator.has_controller()
        gains = actuator.get_controller_gains()
        assert (gains.p, gains.d, actuator.effort_limit()) == (1.0, 0.1, 0.7)
        assert actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia() == pytest.approx(1e-4)
        assert actuator.joint().velocity_upper_limit() == 7


def test_panda_actuators_hold_their_position(panda):
    """All seven joints have an actuator with the gains of a joint impedance controller."""
    p, d = [600, 600, 600, 600, 250, 150, 50], [50, 50, 50, 30, 15, 15, 5]
    assert panda.plant.num_actuators() == 7
    for i in range(7):
        actuator = panda.plant.GetJointActuatorByName(f"panda_joint{i + 1}")
        assert actuator.has_controller()
        assert (actuator.get_controller_gains().p, actuator.get_controller_gains().d) == (p[i], d[i])


def test_the_hand_moves_to_its_desired_positions(allegro):
    """Under SAP at 2 ms, gravity off, every joint reaches its target within 0.02 rad in 1.5 s."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="sap"), builder
    )
    (hand,) = Parser(plant).AddModels(models_dir() / "sdf" / "allegro_right.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.set_gravity_enabled(hand, False)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = {name: value for name, value in zip(allegro.joint_names, allegro.default_position, strict=True)}
    for name, value in start.items():
        plant.GetJointByName(name).set_angle(context, value)
    order = [plant.get_joint_actuator(index).joint().name() for index in plant.GetJointActuatorIndices(hand)]
    target = np.array([start[name] + 0.2 for name in order])
    plant.get_desired_state_input_port(hand).FixValue(context, np.concatenate([target, 0 * target]))
    simulator.AdvanceTo(1.5)
    reached = np.array([plant.GetJointByName(name).get_angle(context) for name in order])
    np.testing.assert_allclose(reached, target, atol=0.02)


@pytest.mark.parametrize("path", SDF_FILES, ids=lambda path: path.stem)
def test_models_need_no_file_but_themselves(path):
    """No model refers to a mesh, a texture, another package or an address."""
    text = path.read_text(encoding="utf-8").replace("http://drake.mit.edu", "")
    for reference in ("<mesh", "<uri", "package://", "drake_models", "http", "<include"):
        assert reference not in text


@pytest.mark.parametrize("name", ["allegro_right", "panda"])
def test_robots_look_like_more_than_their_collision_shapes(name):
    """Every link has coloured visual geometry of its own."""
    scene = Scene(models_dir() / "sdf" / f"{name}.sdf")
    inspector = scene.scene_graph.model_inspector()
    for frame in inspector.GetAllFrameIds():
        if frame == inspector.world_frame_id():
            continue
        visuals = inspector.GetGeometries(frame, Role.kIllustration)
        assert len(visuals) >= 3
        colours = {
            tuple(inspector.GetIllustrationProperties(id).GetProperty("phong", "diffuse").rgba)
            for id in visuals
        }
        assert len(colours) >= 2


def test_friction_of_fingertips_exceeds_that_of_the_shells(allegro):
    """Tip spheres and cylinders have a friction of 0.9, everything else 0.6."""
    inspector = allegro.scene_graph.model_inspector()
    frictions = {}
    for id in inspector.GetAllGeometryIds(Role.kProximity):
        name = inspector.GetName(id).split("::")[-1]
        friction = inspector.GetProximityProperties(id).GetProperty("material", "coulomb_friction")
        frictions.setdefault("tip" in name, []).append(friction.static_friction())
    assert frictions[True] == [0.9] * 8
    assert set(frictions[False]) == {0.6}


def test_there_are_ten_objects_named_after_their_files():
    """Each object is one free link that bears the file's name."""
    assert len(OBJECTS) >= 10
    for path in OBJECTS:
        scene = Scene(path)
        assert scene.plant.num_bodies() == 2
        assert scene.plant.GetBodyByName(path.stem).is_floating_base_body()


def test_the_objects_span_what_the_hand_should_manage():
    """Among them are a wide, a tall, a tiny (2 cm) and a heavy (0.5 kg) one, none of them absurd."""
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
