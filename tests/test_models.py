"""The robots, the furniture and the objects in models/sdf, against data sheets and physics."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.geometry import Box, Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.hands.mirror import left_sdf
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
# Centres of the pads' round ends in mm in the published palm frame: x along the fingers, y towards the index
# side, z out of the back; joint_0 to joint_15.
LEAP_TIPS = {
    "zero": (
        [0.0] * 16,
        {
            "index": [122.0, 8.1, -20.4],
            "middle": [121.9, -37.3, -20.4],
            "ring": [121.9, -82.7, -20.4],
            "thumb": [-81.4, 128.5, -21.4],
        },
    ),
    "random": (
        [1.038, 1.703, 0.982, 2.015, -0.596, 0.094, 0.959, -0.26]
        + [-0.972, 0.996, 0.609, 1.843, 1.188, 1.028, 0.34, -0.543],
        {
            "index": [-47.03, 12.14, -49.18],
            "middle": [79.8, -0.4, -83.79],
            "ring": [-20.78, -71.52, -82.31],
            "thumb": [-79.04, 41.27, -140.49],
        },
    ),
}
# That frame in base_link: origin in m, axes as columns.
LEAP_PALM = RigidTransform(RotationMatrix.MakeYRotation(-np.pi / 2), [-0.0187, 0.038, 0.007])
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


@pytest.fixture(scope="module")
def allegro_left() -> HandModel:
    return HandModel(load_hand("allegro_left"))


@pytest.fixture(scope="module")
def leap() -> HandModel:
    return HandModel(load_hand("leap_right"))


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


@pytest.mark.parametrize("case", LEAP_TIPS)
def test_leap_fingertips_agree_with_the_published_description(leap, case):
    """Exact kinematics reproduce independently computed fingertip points to 0.1 mm."""
    q, wanted = LEAP_TIPS[case]
    for finger, tip in _tips_mm(leap, q).items():
        in_palm = LEAP_PALM.inverse() @ (tip / 1e3)
        np.testing.assert_allclose(in_palm * 1e3, wanted[finger], atol=0.1)


def test_leap_agrees_with_the_fact_sheet(leap):
    """Every forward-kinematics check, joint limit and mass of the fact sheet holds."""
    facts = _facts("leap.yaml")
    for case in facts["fk_check"].values():
        for finger, tip in _tips_mm(leap, case["q_joint0_to_15"]).items():
            in_palm = LEAP_PALM.inverse() @ (tip / 1e3)
            wanted = case["primitive_tip_center_in_palm_lower_mm"][finger]
            np.testing.assert_allclose(in_palm * 1e3, wanted, atol=0.1)
    limits = {
        f"joint_{joint['name']}": (joint["lower_rad"], joint["upper_rad"])
        for joint in facts["kinematics_right"]
        if joint["type"] == "revolute"
    }
    assert len(limits) == 16
    for name, lower, upper in zip(leap.joint_names, leap.lower, leap.upper, strict=True):
        assert (lower, upper) == pytest.approx(limits[name], abs=1e-9)
    shapes = facts["proposed_inertials"]["shapes"]
    masses = [shapes[name]["mass_kg"] for name in ("palm_lower", "thumb_temp_base", "thumb_pip")]
    masses += [shapes[name]["mass_kg"] for name in ("thumb_dip", "thumb_fingertip")]
    masses += 3 * [shapes[name]["mass_kg"] for name in ("mcp", "pip", "dip", "fingertip")]
    assert sum(masses) == pytest.approx(leap.plant.CalcTotalMass(leap.plant.CreateDefaultContext()))


def test_leap_links_weigh_where_their_material_is(leap):
    """No centre of mass lies on its joint, as all of the public model do; each is inside its link."""
    query = leap.scene_graph.get_query_output_port().Eval(
        leap.scene_graph.GetMyContextFromRoot(leap.diagram.CreateDefaultContext())
    )
    context = leap.plant.GetMyContextFromRoot(leap.diagram.CreateDefaultContext())
    for index in range(1, leap.plant.num_bodies()):
        body = leap.plant.get_body(BodyIndex(index))
        assert np.linalg.norm(body.default_com()) > 0.005, body.name()
        p_WC = body.EvalPoseInWorld(context) @ body.default_com()
        frame = leap.plant.GetBodyFrameIdOrThrow(body.index())
        own = set(leap.scene_graph.model_inspector().GetGeometries(frame, Role.kProximity))
        distances = [d.distance for d in query.ComputeSignedDistanceToPoint(p_WC, 0.05) if d.id_G in own]
        assert min(distances) < 0.003, body.name()


def test_leap_inertias_are_about_the_links_own_axes(leap):
    """A link is hardest to turn about the axes across its longest side; of three public links none agrees."""
    for name, longest in (("index_pip", 0), ("thumb_base", 0), ("thumb_pip", 1)):
        body = leap.plant.GetBodyByName(name)
        M = body.default_spatial_inertia().Shift(body.default_com())
        moments = M.CalcRotationalInertia().get_moments()
        assert np.argmin(moments) == longest, name


def test_leap_thumb_base_has_its_box_where_its_servo_is(leap):
    """The public model has it mirrored in the joint, at +7.5 mm."""
    inspector = leap.scene_graph.model_inspector()
    frame = leap.plant.GetBodyFrameIdOrThrow(leap.plant.GetBodyByName("thumb_base").index())
    (box,) = inspector.GetGeometries(frame, Role.kProximity)
    assert inspector.GetPoseInFrame(box).translation()[0] == pytest.approx(-0.0075)


def test_leap_thumb_limits_are_not_shifted_by_a_joint(leap):
    """Another public model gives joint_14 the limits of joint_13."""
    for name, limits in (("joint_13", (-0.47, 2.443)), ("joint_14", (-1.2, 1.9))):
        number = leap.joint_names.index(name)
        assert (leap.lower[number], leap.upper[number]) == limits


def test_left_allegro_is_made_from_the_right_one():
    """The committed file is what `left_sdf` makes, so that there is one source."""
    folder = models_dir() / "sdf"
    made = left_sdf((folder / "allegro_right.sdf").read_text(encoding="utf-8"))
    assert (folder / "allegro_left.sdf").read_text(encoding="utf-8") == made


def test_what_cannot_be_mirrored_is_refused():
    """Meshes, other units and a model that is no right hand are named."""
    text = (models_dir() / "sdf" / "allegro_right.sdf").read_text(encoding="utf-8")
    for change, message in (
        (("<sphere>", "<mesh>"), "<mesh"),
        (("<pose>0 0", '<pose degrees="true">0 0'), "degrees="),
        (('name="allegro_right"', 'name="allegro"'), "ends in '_right'"),
        (("<xyz>0 0 1<", "<xyz>0 1<"), "'0 1' must be 3 numbers"),
    ):
        with pytest.raises(HandError, match=message):
            left_sdf(text.replace(*change))


def test_left_allegro_moves_as_the_mirror_image(allegro, allegro_left, rng):
    """Equal limits; at equal angles every body is where the reflection puts it, to 1e-9."""
    np.testing.assert_array_equal(allegro_left.lower, allegro.lower)
    np.testing.assert_array_equal(allegro_left.upper, allegro.upper)
    assert allegro_left.joint_names == allegro.joint_names
    M = np.diag([1.0, -1.0, 1.0, 1.0])
    hands, contexts = (allegro, allegro_left), []
    for hand in hands:
        contexts.append(hand.plant.GetMyMutableContextFromRoot(hand.diagram.CreateDefaultContext()))
    for q in rng.uniform(allegro.lower, allegro.upper, (50, 16)):
        for hand, context in zip(hands, contexts, strict=True):
            for name, angle in zip(hand.joint_names, q, strict=True):
                hand.plant.GetJointByName(name).set_angle(context, angle)
        for index in range(1, allegro.plant.num_bodies()):
            name = allegro.plant.get_body(BodyIndex(index)).name()
            X, X_left = (
                hand.plant.GetBodyByName(name).EvalPoseInWorld(context).GetAsMatrix4()
                for hand, context in zip(hands, contexts, strict=True)
            )
            np.testing.assert_allclose(X_left, M @ X @ M, atol=1e-9)
    q = rng.uniform(allegro.lower, allegro.upper, (200, 16))
    np.testing.assert_allclose(
        allegro_left.fingertips(q), allegro.fingertips(q) * [1, -1, 1], rtol=0, atol=1e-9
    )


def test_left_allegro_weighs_and_looks_as_the_mirror_image(allegro, allegro_left):
    """Masses, centres, inertias, and every shape's kind, size and place are reflected."""
    M = np.diag([1.0, -1.0, 1.0])
    X_M = np.diag([1.0, -1.0, 1.0, 1.0])
    inspectors = [hand.scene_graph.model_inspector() for hand in (allegro, allegro_left)]
    for index in range(1, allegro.plant.num_bodies()):
        body = allegro.plant.get_body(BodyIndex(index))
        left = allegro_left.plant.GetBodyByName(body.name())
        assert left.default_mass() == body.default_mass()
        np.testing.assert_allclose(left.default_com(), M @ body.default_com(), atol=1e-12)
        J, J_left = (
            b.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3() for b in (body, left)
        )
        np.testing.assert_allclose(J_left, M @ J @ M, atol=1e-12)
        for role in (Role.kProximity, Role.kIllustration):
            shapes, shapes_left = (
                {
                    inspector.GetName(id).split("::")[-1]: (
                        inspector.GetShape(id),
                        inspector.GetPoseInFrame(id),
                    )
                    for id in inspector.GetGeometries(hand.plant.GetBodyFrameIdOrThrow(b.index()), role)
                }
                for hand, b, inspector in zip((allegro, allegro_left), (body, left), inspectors, strict=True)
            )
            assert shapes.keys() == shapes_left.keys()
            for name, (shape, X) in shapes.items():
                shape_left, X_left = shapes_left[name]
                assert str(shape_left) == str(shape)
                # A primitive is its own mirror image, so its pose may be reflected like a frame.
                np.testing.assert_allclose(X_left.GetAsMatrix4(), X_M @ X.GetAsMatrix4() @ X_M, atol=1e-12)


def test_left_allegro_collides_where_the_right_one_does(allegro, allegro_left, rng):
    """The same label at the same angles, but where a contact is a matter of rounding."""
    q = rng.uniform(allegro.lower, allegro.upper, (1000, 16))
    assert (allegro.collides(q) == allegro_left.collides(q)).mean() > 0.999


def test_left_allegro_lacks_the_errors_of_the_public_ones(allegro_left):
    """Ring roll, thumb offset, thumb box and finger numbers, each as the right hand's mirror image.

    At zero the ring's tip is 23.6 mm off in one public model, the thumb's 10 mm in another, which also
    calls the finger opposite to the thumb the index.
    """
    tips = _tips_mm(allegro_left, [0.0] * 16)
    np.testing.assert_allclose(tips["ring"], [0.0, 55.31, 133.44], atol=0.1)
    np.testing.assert_allclose(tips["thumb"], [-13.2, -167.7, -86.07], atol=0.1)
    fingers = {finger.name: finger for finger in allegro_left.description.fingers}
    assert fingers["index"].joints == [f"joint_{i}" for i in range(4)]
    assert fingers["ring"].joints == [f"joint_{i}" for i in range(8, 12)]
    assert np.sign(tips["index"][1]) == np.sign(tips["thumb"][1]) == -1
    inspector = allegro_left.scene_graph.model_inspector()
    frame = allegro_left.plant.GetBodyFrameIdOrThrow(allegro_left.plant.GetBodyByName("link_12").index())
    boxes = [
        inspector.GetPoseInFrame(id).translation()[1]
        for id in inspector.GetGeometries(frame, Role.kProximity)
        if isinstance(inspector.GetShape(id), Box)
    ]
    assert max(boxes) < 0 and min(boxes) == pytest.approx(-0.009)


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


def test_leap_collides_with_itself_as_often_as_its_meshes_do(leap, rng):
    """Four of five uniform joint positions collide: 79.1 % with these primitives, 78.5 % with the meshes."""
    rate = leap.collides(rng.uniform(leap.lower, leap.upper, (5000, 16))).mean()
    assert rate == pytest.approx(0.7912, abs=0.02)


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


def test_total_masses_are_those_of_the_hardware(allegro, allegro_left, leap, panda):
    """The hands weigh the sum of the published link masses, the arm 17.99 kg."""
    for hand, mass in ((allegro, sum(ALLEGRO_MASSES)), (allegro_left, sum(ALLEGRO_MASSES)), (leap, 0.746)):
        assert hand.plant.CalcTotalMass(hand.plant.CreateDefaultContext()) == pytest.approx(mass)
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


@pytest.mark.parametrize(
    ("name", "wanted", "speed"),
    [
        ("allegro_right", (1.0, 0.1, 0.7), 7),
        ("allegro_left", (1.0, 0.1, 0.7), 7),
        ("leap_right", (3.0, 0.17, 0.95), 8.48),
    ],
)
def test_hand_actuators_hold_their_position(name, wanted, speed):
    """All sixteen joints have an actuator with implicit PD gains and a torque limit."""
    hand = HandModel(load_hand(name))
    actuators = [hand.plant.get_joint_actuator(index) for index in hand.plant.GetJointActuatorIndices()]
    assert sorted(actuator.joint().name() for actuator in actuators) == sorted(hand.joint_names)
    for actuator in actuators:
        assert actuator.has_controller()
        gains = actuator.get_controller_gains()
        assert (gains.p, gains.d, actuator.effort_limit()) == wanted
        assert actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia() == pytest.approx(1e-4)
        assert actuator.joint().velocity_upper_limit() == speed


def test_panda_actuators_hold_their_position(panda):
    """All seven joints have an actuator with the gains of a joint impedance controller."""
    p, d = [600, 600, 600, 600, 250, 150, 50], [50, 50, 50, 30, 15, 15, 5]
    assert panda.plant.num_actuators() == 7
    for i in range(7):
        actuator = panda.plant.GetJointActuatorByName(f"panda_joint{i + 1}")
        assert actuator.has_controller()
        assert (actuator.get_controller_gains().p, actuator.get_controller_gains().d) == (p[i], d[i])


@pytest.mark.parametrize("name", ["allegro_right", "leap_right"])
def test_the_hand_moves_to_its_desired_positions(name):
    """Under SAP at 2 ms, gravity off, every joint reaches its target within 0.02 rad in 1.5 s."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="sap"), builder
    )
    model = HandModel(load_hand(name))
    (hand,) = Parser(plant).AddModels(models_dir() / "sdf" / f"{name}.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.set_gravity_enabled(hand, False)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = dict(zip(model.joint_names, model.default_position, strict=True))
    for joint, value in start.items():
        plant.GetJointByName(joint).set_angle(context, value)
    order = [plant.get_joint_actuator(index).joint().name() for index in plant.GetJointActuatorIndices(hand)]
    target = np.array([start[joint] + 0.2 for joint in order])
    plant.get_desired_state_input_port(hand).FixValue(context, np.concatenate([target, 0 * target]))
    simulator.AdvanceTo(1.5)
    reached = np.array([plant.GetJointByName(joint).get_angle(context) for joint in order])
    np.testing.assert_allclose(reached, target, atol=0.02)


@pytest.mark.parametrize("path", SDF_FILES, ids=lambda path: path.stem)
def test_models_need_no_file_but_themselves(path):
    """No model refers to a mesh, a texture, another package or an address."""
    text = path.read_text(encoding="utf-8").replace("http://drake.mit.edu", "")
    for reference in ("<mesh", "<uri", "package://", "drake_models", "http", "<include"):
        assert reference not in text


@pytest.mark.parametrize("name", [*hand_names(), "panda"])
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


@pytest.mark.parametrize("name", hand_names())
def test_friction_of_fingertips_exceeds_that_of_the_shells(name):
    """The two shapes of each tip have a friction of 0.9, everything else 0.6."""
    hand = HandModel(load_hand(name))
    inspector = hand.scene_graph.model_inspector()
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
