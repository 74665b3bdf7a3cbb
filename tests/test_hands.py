"""Hand descriptions, the exact hand model, its digest, and contacts on the links of fingers and palm."""

import shutil

import numpy as np
import pytest
import torch
import trimesh
from grasp_setup import stage_of
from hand_family import HandSpec, write_hand
from model_scene import SHIPPED_HANDS
from pydrake.geometry import Convex
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from geort_drake import Hand, load_scenario
from geort_drake.errors import HandError
from geort_drake.hands.assembly import HandInPlant, add_hand_model
from geort_drake.hands.collision import collision_shapes
from geort_drake.hands.description import CouplingDescription, HandDescription, write_description
from geort_drake.hands.importers.checks import nearest_pinch
from geort_drake.hands.importers.proposal import propose
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.simulation.world import _on_lattice


def _uniform(hand: Hand, rng, count: int) -> np.ndarray:
    return rng.uniform(hand.lower, hand.upper, (count, len(hand.joint_names)))


def _set(path: str, value):
    """A function that puts `value` at a dotted path of the description."""

    def apply(facts):
        *parents, last = path.split(".")
        for key in parents:
            facts = facts[int(key) if isinstance(facts, list) else key]
        facts[last] = value

    return apply


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("side", "middle"), r"side must be one of left, right; given: 'middle'"),
        (_set("base_frame", "palm"), r"base_frame names the frame or link 'palm'.*base_link"),
        (_set("fingers.1.joints", ["joint_12", "joint_1"]), r"every joint once; given: twice: joint_12"),
        (_set("fingers.1.tip_radius", -0.01), r"tip_radius must be positive"),
        (_set("default_positions.joint_12", 0.0), r"joint_12 must be within its limits.*0\.263.*given: 0"),
        (_set("fingers.1.radius", 3), r"hand\.yaml is malformed: unknown field 'fingers\.1\.radius'; choose"),
        (_set("couplings", [{"joint": j, "follows": k} for j, k in ("xy", "yx")]), "'x' follows itself"),
        (
            _set("fingers.1.joints", [f"joint_{i}" for i in (3, 2, 1, 0)]),
            "finger 'index': its joints must be listed base to tip",
        ),
    ],
)
def test_bad_descriptions_name_what_is_wrong(allegro_copy, change, message):
    facts, load = allegro_copy
    change(facts)
    with pytest.raises(HandError, match=f"(?s){message}"):
        Hand(load()).kinematics()


DIGESTS = ["9bb76b37a45136d0", "06a693eef3b0f675", "59d2d7f8cb1425a2"]


@pytest.mark.parametrize(("name", "digest"), [*zip(SHIPPED_HANDS, DIGESTS, strict=True)])
def test_shipped_hands_start_free_and_pinch(name, digest):
    """No self-collision at the start; the thumb's tip reaches every other one. Saved maps fit."""
    hand = Hand(name)
    assert hand.digest.startswith(digest)
    assert not hand.collides(hand.default_position)
    for number in range(1, len(hand.finger_names)):
        assert nearest_pinch(hand, number) < 1.8 * hand.tip_radius


def test_a_mirrored_left_hand_equals_the_right_one(allegro, allegro_left, rng):
    """In the mirror, limits, kinematics, wrist and collision shapes of a left hand are those of the right."""
    for name in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(allegro_left, name), getattr(allegro, name))
    q = _uniform(allegro, rng, 20)
    # In the manufacturer's left hand, spread joints turn about the same axis as in the right one.
    opposite = np.where(np.isin(allegro_left.joint_names, ["joint_0", "joint_4", "joint_8"]), -1, 1)
    tips = allegro_left.fingertips(opposite * q) * [1, -1, 1]
    np.testing.assert_allclose(tips, allegro.fingertips(q), atol=1e-9)
    ours, theirs = allegro_left.kinematics().mirrored(), allegro.kinematics()
    np.testing.assert_allclose(ours.p_BW, theirs.p_BW, atol=1e-12)
    ours, theirs = collision_shapes(allegro_left), collision_shapes(allegro)
    for field in ("joint", "radius", "pairs"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    ours, theirs = (CollisionGaps(allegro.kinematics(), shapes) for shapes in (ours, theirs))
    q = torch.tensor(q).float()
    np.testing.assert_allclose(ours.least(q, 0.01), theirs.least(q, 0.01), atol=1e-6)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_allegro_has_the_manufacturers_numbers_and_signs(side):
    """Joints 0 to 3 are at y = 43.5 mm: the right hand's index finger, and the left hand's ring finger.

    All spread joints turn about +z. From Wonik's descriptions of the hands.
    """
    hand = Hand(f"allegro_{side}")
    context = hand.plant.CreateDefaultContext()
    fingers = {joint: finger.name for finger in hand.description.fingers for joint in finger.joints}
    names = ["index", "middle", "ring"] if side == "right" else ["ring", "middle", "index"]
    joints, places = ("joint_0", "joint_4", "joint_8"), (0.0435, 0.0, -0.0435)
    for name, finger, y in zip(joints, names, places, strict=True):
        joint = hand.plant.GetJointByName(name)
        X_BJ = joint.frame_on_parent().CalcPoseInWorld(context)  # the base is welded to the world
        assert fingers[name] == finger
        assert X_BJ.translation()[1] == pytest.approx(y, abs=1e-4)
        assert (X_BJ.rotation() @ joint.revolute_axis())[2] > 0.99


def test_the_mount_is_the_wrist_and_not_part_of_the_hand(allegro_copy):
    """It defines the wrist, is optional, and does not change the digest, as another fingertip does."""
    facts, load = allegro_copy
    mounted = Hand(load())
    np.testing.assert_allclose(mounted.p_BW, [0, 0, -0.095], atol=1e-12)
    del facts["mount"]
    bare = Hand(load())
    assert not bare.p_BW.any() and bare.digest == mounted.digest
    facts["fingers"][0]["tip_point"] = [0.0, 0.0, 0.05]
    assert Hand(load()).digest != bare.digest


def test_kinematics_survive_offset_bases_welded_links_and_held_joints(allegro_copy, rng, tmp_path):
    """With a base frame away from its link, and a tip on a welded link, torch agrees with Drake to 1e-9 m.

    A joint that no finger lists is held at its default: the finger moves like the whole one with it there.
    """
    facts, load = allegro_copy
    sdf = tmp_path / "hand.sdf"
    extra = """
    <frame name="tilted_base" attached_to="base_link"><pose>0.01 -0.02 0.03 0.3 -0.2 0.5</pose></frame>
    <link name="nail">
      <pose relative_to="index_tip">0.001 0.002 0.003 0.1 0.2 0.3</pose>
      <inertial><mass>0.001</mass></inertial>
    </link>
    <joint name="nail_weld" type="fixed"><parent>link_3</parent><child>nail</child></joint>
  </model>"""
    sdf.write_text(sdf.read_text(encoding="utf-8").replace("  </model>", extra), encoding="utf-8")
    facts["base_frame"] = "tilted_base"
    facts["fingers"][1].update(tip_link="nail", tip_point=[0.004, -0.003, 0.002])
    whole = Hand(load())
    facts["fingers"][1]["joints"].remove("joint_0")
    facts["default_positions"]["joint_0"] = 0.2
    hand = Hand(load())
    q = _uniform(hand, rng, 50)
    q_whole = np.insert(q, whole.joint_names.index("joint_0"), 0.2, axis=1)
    for model, positions in ((hand, q), (whole, q_whole), (whole, _uniform(whole, rng, 50))):
        tips = fingertips(model.kinematics(), torch.tensor(positions)).numpy()
        np.testing.assert_allclose(tips, model.fingertips(positions), atol=1e-9)
    np.testing.assert_allclose(whole.fingertips(q_whole), hand.fingertips(q), atol=1e-9)


@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_the_digest_covers_meshes_and_included_files(kind, tmp_path):
    """A collision mesh, a whole SDF model in another's file, and actuators in a file of their own in MJCF.

    But neither unused files nor the folder.
    """
    folder, outer = tmp_path / "mine", tmp_path / "mine" / f"hand.{kind}"
    parts = folder / "parts"
    parts.mkdir(parents=True)
    if kind == "urdf":
        inner, change = parts / "palm.obj", ("0.0150", "0.0155")
        inner.write_text(trimesh.creation.box((0.03, 0.04, 0.07)).export(file_type="obj"))
        write_hand(folder, HandSpec(3), changes={"<box .*?/>": '<mesh filename="parts/palm.obj"/>'})
    else:
        inner = write_hand(parts, HandSpec(3, kind), "inner")
        text = inner.read_text()
    if kind == "sdf":
        include = "<include merge='true'><uri>package://parts/inner.sdf</uri></include>"
        outer.write_text(f'<sdf version="1.11"><model name="outer">{include}</model></sdf>')
        change = ("<mass>0.03</mass>", "<mass>0.04</mass>")
    elif kind == "xml":
        begin = text.index("<actuator>")
        end = text.index("</actuator>") + len("</actuator>")
        inner.write_text(f"<mujoco>{text[begin:end]}</mujoco>")
        outer.write_text(text[:begin] + '<include file="parts/inner.xml"/>' + text[end:])
        change = ('kp="1"', 'kp="2"')
    write_description(propose(outer)[0], folder / "hand.yaml")
    digest = Hand(folder / "hand.yaml").digest
    (parts / "other.obj").write_text("o unused")
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert Hand(tmp_path / "elsewhere" / "hand.yaml").digest == digest
    assert change[0] in inner.read_text()
    inner.write_text(inner.read_text().replace(*change))
    assert Hand(folder / "hand.yaml").digest != digest


@pytest.fixture
def description(tmp_path) -> HandDescription:
    """Three fingers; one motor of the index moves three links, two of them followers."""
    hand = propose(write_hand(tmp_path, HandSpec(3)))[0]
    hand.fingers[1].joints.remove("index_j2")
    hand.couplings.append(CouplingDescription("index_j2", "index_j1", 0.5))
    return hand


def _seen(description: HandDescription, text: str = "{}"):
    """That hand in the shipped scenario with a ball.

    Returns the stage, its plant's context, and what looks at a port with the ball's centre at p_BO.
    """
    scenario, builder = load_scenario(text=text), DiagramBuilder()
    scenario.object.name = "sphere"
    stage = stage_of(builder, scenario, description)
    plant, thing, view = stage.plant, stage.handled.body, builder.GetSubsystemByName("scene_view")
    root = builder.Build().CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    base = plant.GetFrameByName(description.base_frame, stage.hand)

    def look(port: str, p_BO) -> np.ndarray:
        X_WO = RigidTransform(base.CalcPoseInWorld(context) @ np.asarray(p_BO))
        plant.SetFloatingBaseBodyPoseInWorldFrame(context, thing, X_WO)
        return view.GetOutputPort(port).Eval(view.GetMyContextFromRoot(root))

    return stage, context, look


def _in_base(stage, description: HandDescription, context, link: str) -> RigidTransform:
    base = stage.plant.GetFrameByName(description.base_frame, stage.hand)
    return stage.plant.GetBodyByName(link, stage.hand).body_frame().CalcPose(context, base)


def test_a_finger_has_all_links_that_its_motors_move(description):
    """Including followers; held links belong to the palm."""
    description.fingers[2].joints.remove("middle_j0")
    stage, *_ = _seen(description)
    plant, hand = stage.plant, stage.hand
    parts = HandInPlant(plant, description, hand)
    names = [[body.name() for body in links] for links in parts.finger_links()]
    links = {"thumb": range(3), "index": range(4), "middle": range(1, 4)}
    assert names[:3] == [[f"{finger}_l{i}" for i in numbers] for finger, numbers in links.items()]
    assert [body.name() for body in parts.palm_links()] == ["palm", "middle_l0"]
    with pytest.raises(HandError, match="cannot be added to a plant that is finalized"):
        add_hand_model(plant, description)


@pytest.mark.parametrize("link", ["index_l1", "index_l2", "index_l3"])
def test_contact_on_a_follower_counts_for_its_finger(description, link):
    """An object that overlaps one link of the index is in contact with the index alone."""
    stage, context, look = _seen(description)
    # Beside the middle of the link, on the thumb's side, where no other finger is.
    p_BL = _in_base(stage, description, context, link).translation()
    contact = look("contact", p_BL + [0.0, 0.031, 0.01])
    assert contact[1] > 0.1
    assert contact[0] == contact[2] == 0.0


def test_self_contact_equals_collisions_beyond_tips(allegro):
    """Links of the Allegro that touch count, two fingertips do not."""
    stage, context, look = _seen(allegro.description)
    q = np.random.default_rng(0).uniform(allegro.lower, allegro.upper, (2000, len(allegro.lower)))
    beyond, touching = allegro.collides_beyond_tips(q), allegro.collides(q)
    tips_alone = touching & ~beyond
    assert min(beyond.sum(), (~touching).sum(), tips_alone.sum()) >= 3
    for row, expected in [*zip(q[:60], beyond[:60], strict=True), *((r, False) for r in q[tips_alone])]:
        for name, angle in zip(allegro.joint_names, row, strict=True):
            stage.plant.GetJointByName(name, stage.hand).set_angle(context, angle)
        assert look("self_contact", [1.0, 0.0, 0.0]).tolist() == [float(expected)]


@pytest.mark.parametrize(("text", "soft"), [("{fingertip_modulus: 0}", False), ("{}", True)])
def test_touch_is_felt_with_rigid_fingertips_and_with_soft_ones_as_by_default(text, soft, allegro):
    """A ball 1 mm deep in one fingertip presses on it, by a point or by a surface."""
    stage, context, look = _seen(allegro.description, text)
    index = allegro.description.fingers[1]
    # In front of the finger pad; the ball's radius is 30 mm.
    p_LO = np.array(index.tip_point) + [index.tip_radius + 0.029, 0.0, 0.0]
    p_BO = _in_base(stage, allegro.description, context, index.tip_link) @ p_LO
    contact = look("contact", p_BO)
    results = stage.plant.get_contact_results_output_port().Eval(context)
    assert (results.num_hydroelastic_contacts() > 0) == soft
    assert contact[1] > 0.05 and contact[[0, 2, 3]].max() == 0
    assert look("self_contact", p_BO)[0] == 0


def test_a_soft_fingertip_has_no_degenerate_triangles(rng):
    """Published hulls have vertices that nearly coincide; Drake refuses triangles without an area."""
    p = rng.normal(size=(3, 500))
    p *= 0.01 / np.linalg.norm(p, axis=0)
    p = np.hstack([p, p + rng.normal(0, 1e-7, p.shape)])

    def doubled_areas(shape: Convex) -> np.ndarray:
        hull = shape.GetConvexHull()
        faces = [hull.element(i) for i in range(hull.num_faces())]
        corners = [[hull.vertex(f.vertex(k)) for k in range(f.num_vertices())] for f in faces]
        fans = [(c[0], c[k], c[k + 1]) for c in corners for k in range(1, len(c) - 1)]
        return np.array([np.linalg.norm(np.cross(b - a, c - a)) for a, b, c in fans])

    turn = RotationMatrix(RollPitchYaw(0.3, 0.7, 0.1)).matrix()
    thin = turn @ (np.array([[10.0], [10.0], [0.2]]) * rng.choice([-1e-3, 1e-3], (3, 40)))
    for small in (thin, 0.02 * p):  # pieces of published models
        assert doubled_areas(_on_lattice(Convex(small, "tip"), "tip")).min() > 1e-10
    coarse = _on_lattice(Convex(p, "tip"), "tip")
    assert doubled_areas(Convex(p, "tip")).min() < 1e-10
    assert doubled_areas(coarse).min() > 0.99e-6
    hull = coarse.GetConvexHull()
    radii = [np.linalg.norm(hull.vertex(v)) for v in range(hull.num_vertices())]
    assert 0.009 < min(radii) and max(radii) < 0.011
