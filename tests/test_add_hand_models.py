"""Models to add: what they collide with, meshes, features of MJCF, and more than a hand in one file."""

import dataclasses as dc
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
import trimesh
from hand_family import HandSpec, write_hand
from pydrake.geometry import MakeRenderEngineVtk, Mesh, RenderEngineVtkParams, Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake import Hand, load_hand
from geort_drake.cli import run_command
from geort_drake.errors import HandError, OutputError, UnknownNameError
from geort_drake.hands.assembly import detach_from_world, parse_model
from geort_drake.hands.collision import HandClearance, collision_shapes
from geort_drake.hands.geometry import surface_points
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.conversion import convert_model, unreadable_meshes
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model_files import read_couplings
from geort_drake.retargeting.collision import CollisionGaps

# A rigid part that hangs on the index finger's last link, off its axes, and how far it reaches along them.
PARTS = {
    "urdf": '<link name="nail"><visual><origin xyz="0.001 0.002 0.003"/><geometry>'
    '<box size="0.01 0.02 0.03"/></geometry></visual></link><joint name="glue" type="fixed">'
    '<parent link="index_l3"/><child link="nail"/><origin xyz="0 0 0.02"/></joint></robot>',
    "sdf": '<link name="nail"><pose relative_to="index_l3">0 0 0.02 0 0 0</pose><visual name="v">'
    "<pose>0.001 0.002 0.003 0 0 0</pose><geometry><box><size>0.01 0.02 0.03</size></box></geometry></visual>"
    '</link><joint name="glue" type="fixed"><parent>index_l3</parent><child>nail</child></joint></model>',
}
ENDS = {"urdf": "</robot>", "sdf": "</model>"}


def drawn_alone(folder, kind: str):
    """A hand of the family with visual geometry alone, and a part welded to one link."""
    changes = {"<geom ": '<geom contype="0" conaffinity="0" '}
    if kind != "xml":
        changes = {r"(</?)collision": r"\1visual", ENDS[kind]: PARTS[kind]}
    return write_hand(folder, HandSpec(3, kind, mimic=False), changes=changes)


def reach(hand: Hand, link: str, role: Role) -> np.ndarray:
    """(2, 3) bounds, along a link's axes, of its geometry and that of links welded to it, m."""
    inspector, points = hand.scene_graph.model_inspector(), []
    owner = hand.plant.GetBodyByName(link)
    context = hand.plant.CreateDefaultContext()
    for body in hand.plant.GetBodiesWeldedTo(owner):
        X_LB = body.body_frame().CalcPose(context, owner.body_frame())
        for id in inspector.GetGeometries(hand.plant.GetBodyFrameIdOrThrow(body.index()), role):
            points.append((X_LB @ inspector.GetPoseInFrame(id) @ surface_points(inspector, id).T).T)
    return np.array([np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)])


@pytest.mark.parametrize(
    "kind", ["urdf", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("sdf", "xml"))]
)
def test_bare_links_collide_with_what_is_drawn(kind, tmp_path):
    """Collision geometry is as large as the visual geometry; the checks then find no fault."""
    model = drawn_alone(tmp_path, kind)
    assert "--hulls" in examine(Hand(propose(model)[0]))[0]
    description = propose(model, hulls=True)[0]
    drawn = ["palm", *(f"{f}_l{n}" for f in ("thumb", "index", "middle") for n in range(4))]
    bare = {"thumb_l0", "thumb_l3", "index_l0", "middle_l0"}
    assert set(description.collide_as_drawn) == set(drawn) - bare | ({"nail"} if kind in PARTS else set())
    hand = Hand(description)
    for link in description.collide_as_drawn:
        found, wanted = (reach(hand, link, role) for role in (Role.kProximity, Role.kIllustration))
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert not any("without collision" in text or "no collision" in text for text in examine(hand))
    assert not propose(write_hand(tmp_path, HandSpec(3, kind)), hulls=True)[0].collide_as_drawn


# A box off its mesh's origin, longer along z than along y, m.
CORNERS = np.array(np.meshgrid([-0.022, -0.002], [-0.033, 0.033], [0.0, 0.08])).reshape(3, -1).T
BOX = trimesh.convex.convex_hull(CORNERS)


def _glb() -> bytes:
    """With z up, twice as large, below a node of half the size."""
    scene = trimesh.Scene()
    scene.add_geometry(BOX.copy().apply_scale(2), transform=np.diag([0.5, 0.5, 0.5, 1]))
    return scene.export(file_type="glb")


def _dae() -> bytes:
    """In centimetres, with an up axis that does not count, below a node of twice the size."""
    text = BOX.copy().apply_scale(50).export(file_type="dae").decode()
    text = text.replace("<up_axis>", '<unit name="centimeter" meter="0.01"/><up_axis>')
    return text.replace("<instance_geometry", "<scale>2 2 2</scale><instance_geometry").encode()


MESHES = {
    "palm.stl": BOX.export(file_type="stl"),
    "text.STL": BOX.export(file_type="stl_ascii").encode(),
    "palm.glb": _glb(),
    "palm.ply": BOX.export(file_type="ply"),
    "palm.dae": _dae(),
}


def _with_mesh(folder: Path, kind: str, name: str) -> Path:
    """A hand of the family whose palm is a mesh."""
    changes = {
        '<origin xyz="-0.012 0 0.04" rpy="0 0 0"/>': "",
        '<box size="0.02 0.066 0.08"/>': f'<mesh filename="package://parts/{name}"/>',
        "<inertial>": '<inertial><origin xyz="-0.012 0 0.04"/>',
    }
    if kind == "xml":
        head = f'<asset><mesh file="{name}"/></asset><compiler meshdir="parts"/><worldbody>'
        changes = {"<worldbody>": head, '<geom type="box".*?/>': f'<geom type="mesh" mesh="{name[:4]}"/>'}
    (folder / "parts").mkdir()
    (folder / "parts" / name).write_bytes(MESHES[name])
    return write_hand(folder, HandSpec(4, kind, mimic=False), changes=changes)


def test_the_command_describes_a_copy(tmp_path):
    """Of a mesh that Drake cannot read, telling materials of one name apart.

    Model and folders of another kind do not change.
    """
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    drawn = "<visual><geometry><sphere radius='0.001'/></geometry>"
    colours = (
        f'{drawn}<material name="m"><color rgba="0 0 0.{n} 1"/></material></visual>' for n in range(99)
    )
    model.write_text(re.sub("</link>", lambda _: next(colours) + "</link>", model.read_text()))
    before = model.read_bytes()
    output = tmp_path / "described" / "hand.yaml"
    output.parent.mkdir()
    for _ in range(2):
        run_command("hand add", [str(model), "--output", str(output), "--quiet", "--overwrite"])
    notes = output.parent / "hand_model" / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(OutputError, match="is no earlier copy of hand"):
        run_command("hand add", [str(model), "--output", str(output), "--overwrite"])
    assert model.read_bytes() == before
    Hand(output)


@pytest.mark.parametrize(("kind", "name"), [*(("urdf", name) for name in MESHES), ("xml", "palm.stl")])
def test_a_hull_replaces_a_mesh(kind, name, tmp_path):
    """In its place and unit, also when moved: STL of both kinds, binary glTF with z up, PLY, COLLADA."""
    model = _with_mesh(tmp_path, kind, name)
    assert [mesh.name for mesh in unreadable_meshes(model)] == [name] * (kind == "urdf")
    if kind == "urdf":  # MuJoCo reads those of MJCF
        convert_model(model, tmp_path / "copy")
        model = (tmp_path / "copy").rename(tmp_path / "moved") / model.name
        assert unreadable_meshes(model) == []
    hand = Hand(propose(model)[0])
    assert len(hand.plant.GetCollisionGeometriesForBody(hand.plant.GetBodyByName("palm"))) == 1
    bounds = [CORNERS.min(axis=0), CORNERS.max(axis=0)]
    np.testing.assert_allclose(reach(hand, "palm", Role.kProximity), bounds, atol=1e-6)


@pytest.mark.parametrize("kind", ["urdf", "xml"])
def test_meshes_get_the_normals_that_drakes_renderers_require(kind, tmp_path):
    """STL has none; a diagram with a camera would refuse the hand."""
    model = _with_mesh(tmp_path, kind, "palm.stl")
    if kind == "urdf":
        model.write_text(model.read_text().replace("collision", "visual"))
        model = convert_model(model, tmp_path / "copy")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    parse_model(plant, model)
    inspector = scene_graph.model_inspector()
    shapes = [inspector.GetShape(id) for id in inspector.GetAllGeometryIds(Role.kIllustration)]
    assert any(isinstance(shape, Mesh) for shape in shapes)


def test_hulls_that_overlap_near_a_joint_are_ignored_and_told(tmp_path):
    """The hull of the palm reaches beyond the knuckles, where it blocks links that it should not touch."""
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    model.write_text(model.read_text().replace('palm.stl"', 'palm.stl" scale="1 1 2"'))
    description, notes = propose(convert_model(model, tmp_path / "copy"))
    assert description.ignored_collisions == [["middle_l1", "palm"]]
    assert "overlapping shapes are ignored: 'middle_l1' and 'palm'" in "\n".join(notes)
    assert not any("touch in" in fault for fault in examine(Hand(description)))
    description.ignored_collisions = []
    assert any("touch in" in fault for fault in examine(Hand(description)))


def test_training_and_guard_see_the_hulls_that_drake_sees(tmp_path):
    """A wedge as palm leaves half of its box empty, and fingers bend into that half."""
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    side = ((-0.022, 0), (-0.022, 0.08), (0.07, 0))
    wedge = np.array([[x, y, z] for y in (-0.033, 0.033) for x, z in side])
    trimesh.convex.convex_hull(wedge).export(tmp_path / "parts" / "palm.stl")
    hand = Hand(propose(convert_model(model, tmp_path / "copy"))[0])
    q = hand.sample(500, seed=1)
    collides = hand.collides_beyond_tips(q)
    gaps = CollisionGaps(hand.kinematics(), collision_shapes(hand))
    assert 0.1 < collides.mean() < 0.9
    assert ((gaps.least(torch.tensor(q).float(), 0.002).numpy() < 0) == collides).mean() > 0.95

    clearance, context, counts = HandClearance(hand, 0.002), hand.contact_context(), [0, 0]
    watched = {frozenset(pair) for pair in clearance.pairs}
    for angles in q:
        found = hand.query(angles, context).ComputeSignedDistancePairwiseClosestPoints(0.01)
        distance = min((f.distance for f in found if {f.id_A, f.id_B} in watched), default=0.01)
        if not 0.002 <= distance <= 0.0035:  # edges of enlarged geometries lie between
            assert bool(clearance.near(angles).pairs) == (distance < 0.002)
            counts[distance < 0.002] += 1
    assert min(counts) > 100


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"short", "not a readable .stl mesh"),
        (MESHES["text.STL"].replace(b"vertex -", b"vertex nan"), "not a readable .stl mesh"),
        (None, "missing"),
    ],
    ids=["cut off", "not finite", "missing"],
)
def test_an_unusable_mesh_is_named(content, message, tmp_path):
    model = _with_mesh(tmp_path, "urdf", "palm.stl")
    mesh = tmp_path / "parts" / "palm.stl"
    mesh.unlink() if content is None else mesh.write_bytes(content)
    with pytest.raises(HandError, match=message) as error:
        convert_model(model, tmp_path / "copy")
    assert str(mesh) in str(error.value)
    assert not (tmp_path / "copy").exists()


def write_mjcf(folder: Path, body: str, more: str = "") -> Path:
    path = folder / "model.xml"
    world = f"<worldbody><body name='root'>{body}</body></worldbody>"
    path.write_text(f"<mujoco><compiler angle='radian'/>{world}{more}</mujoco>", encoding="utf-8")
    return path


MASS = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'


def in_drake(path: Path):
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    hand = parse_model(plant, path)
    detach_from_world(plant, hand)
    plant.Finalize()
    return plant, scene_graph, hand


JOINTS = {
    "plain": '<joint name="k" axis="1 2 0"/>',
    "reference": '<joint name="k" axis="1 0 0" ref="0.4" range="-1 1"/>',
    "off the origin": '<joint name="k" axis="0 1 0" pos="0.1 0.2 0.3" ref="-0.3"/>',
    "slide": '<joint name="k" type="slide" axis="0 1 1" ref="0.05" pos="0.1 0 0"/>',
    "three": '<joint name="k" axis="1 0 0" pos="0.1 0 0"/>'
    '<joint name="l" axis="0 1 0" ref="0.2" pos="0 0.1 0"/>'
    '<joint name="m" type="slide" axis="0 0 1" ref="0.1"/>',
}


@pytest.mark.parametrize("joints", JOINTS)
def test_a_link_lies_where_mujoco_has_it(joints, tmp_path, rng):
    """To 1e-9 m, with references, joints off the origin, several joints of one body, and frames."""
    tip = f'<body name="tip" pos="1 2 2" quat="1 2 3 4">{MASS}</body>'
    tip = f'<frame pos="0 0 1" euler="0.1 0.2 0.3">{tip}</frame>'
    inner = f'{MASS}<body name="f" pos="0.01 0 0" euler="0.3 0 0">{MASS}{JOINTS[joints]}{tip}</body>'
    path = write_mjcf(tmp_path, inner)
    m = mujoco.MjModel.from_xml_path(str(path))
    data, names = mujoco.MjData(m), [m.joint(number).name for number in range(m.njnt)]
    plant, *_ = in_drake(path)
    context = plant.CreateDefaultContext()
    starts = [plant.GetJointByName(name).default_positions()[0] for name in names]
    np.testing.assert_allclose(starts, m.qpos0)
    for q in (m.qpos0, *rng.uniform(-1, 1, (3, m.nq))):
        data.qpos = q
        mujoco.mj_kinematics(m, data)
        for name, angle in zip(names, q, strict=True):
            position = plant.GetPositions(context)
            position[plant.GetJointByName(name).position_start()] = angle
            plant.SetPositions(context, position)
        X = plant.GetFrameByName("tip").CalcPose(context, plant.GetFrameByName("root"))
        np.testing.assert_allclose(X.translation(), data.body("tip").xpos, atol=1e-9)
        np.testing.assert_allclose(X.rotation().matrix().ravel(), data.body("tip").xmat, atol=1e-9)


@pytest.mark.parametrize("servo", ['position kp="7"', 'general biastype="affine" gainprm="7" biasprm="0 -7"'])
def test_mjcf_is_read_as_mujoco_reads_it(servo, tmp_path):
    """Axis, limits, gain and size reach inner classes, also through a class without joint, geom or motor.

    Files name others relative to the first. A link does not touch its parent. A servo's force is limited by
    its range of force, not by that of its input. Surroundings are left out.
    """
    tag = servo.split()[0]
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "classes.xml").write_text(
        '<mujoco><default><joint axis="0 1 0"/><default class="a"><joint axis="1 0 0" range="0 1"/>'
        f'<geom type="sphere" size="0.03"/><{servo} ctrlrange="0 1" forcerange="-5 5"/>'
        '<default class="b"><site/><default class="c"><geom rgba="1 0 0 1"/></default></default>'
        "</default></default></mujoco>",
        encoding="utf-8",
    )
    path = write_mjcf(
        tmp_path,
        f'{MASS}<geom class="c"/><body name="f" pos="0.01 0 0">{MASS}<geom class="c"/>'
        '<joint name="j" class="c" armature="0.01" damping="0.2"/></body>',
        f'<include file="parts/classes.xml"/><actuator><{tag} joint="j" class="c"/></actuator>'
        '<worldbody><geom size="9"/><body name="table"><geom size="1"/></body></worldbody>',
    )
    plant, scene_graph, _ = in_drake(path)
    joint, inspector = plant.GetJointByName("j"), scene_graph.model_inspector()
    np.testing.assert_allclose(joint.revolute_axis(), [1, 0, 0])
    assert (joint.position_lower_limit(), joint.position_upper_limit()) == (0, 1)
    assert joint.default_damping() == 0.2
    (motor,) = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    assert (motor.get_controller_gains().p, motor.effort_limit()) == (7, 5)
    assert motor.default_rotor_inertia() == 0.01
    shapes = [inspector.GetShape(id) for id in inspector.GetAllGeometryIds(Role.kProximity)]
    assert [shape.radius() for shape in shapes] == [0.03, 0.03]
    assert not inspector.GetCollisionCandidates() and not plant.HasBodyNamed("table")


def tendon(coefficients: dict[str, float], settings: str = "", more: str = "") -> tuple[str, str]:
    joints = f'{MASS}<body>{MASS}<joint name="a"/><body>{MASS}<joint name="b"/>'
    joints += f'<body>{MASS}<joint name="c"/></body></body></body>'
    parts = "".join(f'<joint joint="{joint}" coef="{c}"/>' for joint, c in coefficients.items())
    return joints, f'<tendon><fixed name="t" {settings}>{parts}</fixed></tendon>{more}'


OPPOSITE = {"a": -0.008, "b": 0.007}
NARROW = 'range="-0.001 0.001"'
MOTOR = '<actuator><position tendon="t"/></actuator>'
OUTER_MOTOR = '<actuator><motor joint="b"/></actuator>'
TIGHT = f'<default><default class="tight"><tendon {NARROW} limited="true"/></default></default>'
FIXED_LENGTH = '<equality><tendon tendon1="t" polycoef="0.5 0 0 0 0"/></equality>'


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (tendon(OPPOSITE, 'range="0.013 0.015"'), [("b", "a", 8 / 7, 2.0)]),
        (tendon(OPPOSITE, 'class="tight"', TIGHT), [("b", "a", 8 / 7, 0.0)]),
        (tendon({"b": 1, "a": -1}, more=FIXED_LENGTH), [("b", "a", 1.0, 0.5)]),
        (tendon({"a": 2, "b": 1}, more=MOTOR), [("b", "a", 0.5, 0.0)]),
        (tendon(OPPOSITE, NARROW, OUTER_MOTOR), [("a", "b", 7 / 8, 0.0)]),
        (tendon(OPPOSITE, 'range="-0.01 0.01"'), []),
        (tendon({"a": 1, "b": 1, "c": 1}, NARROW), []),
        (tendon({"a": 1, "b": 1}, more=MOTOR.replace("/><", '/><motor joint="b"/><')), []),
        (tendon(OPPOSITE, more=FIXED_LENGTH.replace("/>", ' active="false"/>')), []),
        (
            tendon(OPPOSITE, NARROW, '<equality><joint joint1="a" joint2="b"/></equality>'),
            [("a", "b", 1.0, 0.0)],
        ),
    ],
    ids=["range", "class", "equality", "motor", "outer leads"]
    + ["loose", "three joints", "motors of both", "inactive", "equality of joints"],
)
def test_a_tendon_couples_two_joints(model, expected, tmp_path):
    """By its range, its class's, a fixed length, or one motor; a joint with a motor leads.

    Loose or inactive ones couple nothing, nor those of three joints, or of joints with motors or an equality.
    """
    couplings, notes = read_couplings(write_mjcf(tmp_path, *model))
    assert [dc.astuple(each) for each in couplings] == [pytest.approx(each) for each in expected]
    assert ("assuming equal stiffness" in " ".join(notes)) == (expected == [("b", "a", 0.5, 0.0)])


def test_ignored_parts_are_named(tmp_path):
    """Closed loops, and tendons of other kinds that motors pull."""
    more = '<equality><connect body1="index_l3" body2="middle_l3" anchor="0 0 0"/></equality>'
    more += '<tendon><spatial name="rope"><site site="one"/><site site="two"/></spatial></tendon>'
    more += '<actuator><motor tendon="rope"/></actuator>'
    sites = {
        '(<body name="palm">)': r'\1<site name="one"/>',
        '(<body name="index_l3".*?>)': r'\1<site name="two"/>',
    }
    model = write_hand(tmp_path, HandSpec(3, "xml"), changes={"</mujoco>": f"{more}</mujoco>", **sites})
    notes = " ".join(propose(model)[1])
    assert "move independently: 'rope'" in notes and "closed loop at 'index_l3' and 'middle_l3'" in notes


INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'


def _robot(folder, arm_joints: int, legs: int = 0, hands=("left", "right"), fingers: int = 3):
    """A URDF of a torso with an arm on each side, each with a hand, and with legs of three joints."""
    moves = '<origin xyz="0 0.1 0.1"/><axis xyz="1 0 0"/>'
    moves += '<limit lower="-1" upper="1" effort="9" velocity="2"/>'
    lines = [f'<link name="torso">{INERTIAL}</link>']

    def chain(name, count, kind="revolute"):
        parent = "torso"
        for number in range(count):
            link = f"{name}_{number}"
            lines.append(f'<link name="{link}">{INERTIAL}</link><joint name="{link}_joint" type="{kind}">')
            lines.append(f'<parent link="{parent}"/><child link="{link}"/>{moves}</joint>')
            parent = link
        return parent

    for side in hands:
        text = write_hand(folder, HandSpec(fingers, mimic=False, side=side), side).read_text(encoding="utf-8")
        inside = text[text.index(">") + 1 : text.rindex("<")]
        lines.append(re.sub(r'(name|link)="', rf'\1="{side}_', inside))
        ends = f'<parent link="{chain(f"{side}_arm", arm_joints)}"/><child link="{side}_palm"/>'
        lines.append(f'<joint name="{side}_mount" type="fixed">{ends}</joint>')
    for number in range(legs):
        chain(f"leg{number}", 3)
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot">{"".join(lines)}</robot>', encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("arm_joints", "legs", "hands", "message"),
    [
        (7, 2, ("left", "right"), "start at each of 'torso', 'left_palm', 'right_palm'; give it as --palm"),
        (2, 0, ("left", "right"), "several chains of joints start at each of 'left_palm', 'right_palm'"),
        (0, 0, ("left", "right"), "6 chains of movable revolute joints start at its palm"),
        (7, 2, ("right",), "start at each of 'torso', 'right_palm'"),
    ],
    ids=["humanoid", "two short arms", "no arms", "one hand with legs"],
)
def test_more_than_one_hand_is_refused(tmp_path, arm_joints, legs, hands, message):
    """Fingers of both would be taken for one hand's; the message lists the possible palms."""
    with pytest.raises(HandError, match=message):
        propose(_robot(tmp_path, arm_joints, legs, hands))


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_named_palm_of_a_robot_is_described(tmp_path, side):
    """With its own fingers; all other joints are held, in one note."""
    robot = _robot(tmp_path, 7, legs=2)
    run_command("hand add", [str(robot), "--palm", f"{side}_palm", "--output", str(tmp_path / "hand.yaml")])
    description = load_hand(tmp_path / "hand.yaml")
    assert (description.side, description.base_pose.relative_to) == (side, f"{side}_palm")
    assert [joint.partition("_")[0] for joint in description.joint_names] == [side] * 11
    assert "as each belongs to no finger: " in (tmp_path / "hand.yaml").read_text(encoding="utf-8")
    unknown = r"unknown link of the model 'hand'; choose one of: .*left_palm"
    with pytest.raises(UnknownNameError, match=unknown):
        propose(robot, palm="hand")


def test_one_hand_may_have_an_arm_or_a_folding_palm(tmp_path):
    """An arm that carries all fingers, or a joint of the palm that carries two of four."""
    names = propose(_robot(tmp_path, 7, hands=("right",)))[0].finger_names
    assert names == ["thumb", "index", "middle"]
    fold = (
        f'<link name="fold">{INERTIAL}</link><joint name="fold" type="revolute"><parent link="palm"/>'
        '<child link="fold"/><axis xyz="0 0 1"/><limit lower="0" upper="0.4" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    changes = {r'(<joint name="(middle|ring)_j0".*?<parent link=")palm': r"\1fold", "</robot>": fold}
    description, notes = propose(write_hand(tmp_path, HandSpec(4, mimic=False), changes=changes))
    assert description.finger_names == ["thumb", "index", "middle", "ring"]
    assert "as each moves 2 fingers at once: 'fold'" in "\n".join(notes)


@pytest.mark.slow
def test_of_two_hands_in_one_file_the_named_one_is_described(tmp_path):
    """Each with a root, followers and motors of its own; the other one's joints are held, its parts loose."""
    parts = {"worldbody": "", "equality": "", "actuator": ""}
    for side, fingers in (("left", 4), ("right", 3)):
        text = write_hand(tmp_path, HandSpec(fingers, "xml", side=side), side).read_text(encoding="utf-8")
        text = re.sub(r'(name|joint\d?)="', rf'\1="{side}_', text)
        for part in parts:
            parts[part] += re.search(rf"<{part}>(.*)</{part}>", text, re.DOTALL)[1]
    inside = "".join(f"<{part}>{text}</{part}>" for part, text in parts.items())
    model = tmp_path / "both.xml"
    model.write_text(f'<mujoco model="both"><compiler angle="radian"/>{inside}</mujoco>', encoding="utf-8")
    with pytest.raises(HandError, match=r"not clear: .* at each of 'left_palm', 'right_palm'"):
        propose(model)
    for side, fingers in (("left", 4), ("right", 3)):
        description = propose(model, palm=f"{side}_palm")[0]
        assert (description.side, len(description.fingers)) == (side, fingers)
        assert {joint.partition("_")[0] for joint in description.joint_names} == {side}
        assert "fall freely" in " ".join(examine(Hand(description)))
