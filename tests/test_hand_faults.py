"""Faults of published hand models, each in a small hand of five fingers, and what add-hand makes of it."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from geort_drake import Hand
from geort_drake.cli import run_command
from geort_drake.errors import HandError
from geort_drake.hands.description import HandDescription
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model_files import read_couplings

FINGERS = ("thumb", "index", "middle", "ring", "little")
INERTIA = '<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
INERTIAL = f'<inertial><mass value="0.02"/>{INERTIA}</inertial>'
MASS = '<inertial mass="0.02" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>'
LENGTH = 0.045  # m, of the links


def finger_origin(finger: str, side: str) -> np.ndarray:
    """The origin of a finger's first joint: knuckles side by side along y, the thumb beside the palm."""
    sign = 1.0 if side == "right" else -1.0
    if finger == "thumb":
        return np.array([0.01, 0.045 * sign, 0.03])
    return np.array([0.0, sign * 0.02 * (2.5 - FINGERS.index(finger)), 0.1])


def write_urdf(
    folder: Path,
    side: str = "left",
    offset: float = 0.0,
    leader: str = "",
    drawn: float = 0.0,
    geometry: bool = True,
    changes: dict[str, str] | None = None,
    name: str = "hand.urdf",
) -> Path:
    """A hand whose fingers point along +z of the palm and bend to +x, each with spread, mcp and pip joints.

    Args:
        offset: distance in front of the spread joint at which the mcp joint lies, m.
        leader: if "mcp" or "pip", there are no spread joints, and the other of both joints follows this one.
        drawn: angle by which mcp and pip joints of fingers are bent where their positions are zero, rad.
        geometry: whether there is any.
        changes: texts to replace, which must occur.
    """

    def link(name: str, length: float) -> str:
        form = f'<cylinder radius="0.006" length="{length}"/>'
        shape = f'<origin xyz="0 0 {length / 2}"/><geometry>{form}</geometry>'
        shapes = f"<visual>{shape}</visual><collision>{shape}</collision>" if geometry and length else ""
        return f'<link name="{name}">{INERTIAL}{shapes}</link>'

    lines = [link("palm", 0.09)]
    for finger in FINGERS:
        thumb, origin, parent = finger == "thumb", finger_origin(finger, side), "palm"
        for kind in ("spread", "mcp", "pip"):
            if leader and kind == "spread":
                continue
            bent = 0.0 if thumb or kind == "spread" else drawn
            axis, limits, mimic = "0 1 0", (0.0 - bent, 1.4 - bent), ""
            if kind == "spread":
                axis, limits = "1 0 0", (-0.26, 0.26)
            if thumb:
                # It lies across the palm, and bends to the fingers.
                axis = "0 0 1" if kind == "spread" else "0 1 0"
            if leader and not thumb and kind != leader:
                ratio = 0.9 if leader == "mcp" else 1 / 0.9
                mimic = f'<mimic joint="{finger}_{leader}" multiplier="{ratio}"/>'
            name_of_link = f"{finger}_{kind}_link"
            lines.append(link(name_of_link, 0.0 if kind == "spread" else LENGTH))
            lines.append(
                f'<joint name="{finger}_{kind}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{name_of_link}"/><origin xyz="{" ".join(map(str, origin))}" rpy="0 {bent} 0"/>'
                f'<axis xyz="{axis}"/>'
                f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="5"/>{mimic}</joint>'
            )
            parent = name_of_link
            origin = np.array([offset, 0, 0]) if kind == "spread" else np.array([0, 0, LENGTH])
    text = f'<robot name="family_{side}">' + "\n".join(lines) + "</robot>"
    for old, new in (changes or {}).items():
        assert old in text, old
        text = text.replace(old, new)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def write_mjcf(folder: Path, reference: float = 0.0, palm: bool = True, thumb_geom: str = "0 0 0.02") -> Path:
    """The same hand without spread joints in MJCF; with a reference, rad, pip joints follow mcp joints."""
    fingers = ""
    for finger in FINGERS:
        origin = " ".join(map(str, finger_origin(finger, "right")))
        geom = '<geom type="capsule" size="0.006" fromto="0 0 0.006 0 0 0.035"/>'
        last = geom
        if finger == "thumb":
            last = f'<geom type="sphere" size="0.006" pos="{thumb_geom}" group="3"/>'
            last += '<geom type="sphere" size="0.006" pos="0 0 0.02" contype="0" conaffinity="0"/>'
        fingers += (
            f'<body name="{finger}_1" pos="{origin}">{MASS}{geom}'
            f'<joint name="{finger}_mcp" axis="0 1 0" range="-0.6 1.4" ref="{reference}"/>'
            f'<body name="{finger}_2" pos="0 0 {LENGTH}">{MASS}{last}'
            f'<joint name="{finger}_pip" axis="0 1 0" range="-0.6 1.6"/></body></body>'
        )
    box = '<geom type="box" size="0.01 0.04 0.045" pos="-0.012 0 0.045"/>'
    equalities = "".join(
        f'<joint joint1="{finger}_pip" joint2="{finger}_mcp" polycoef="0.1 0.7 0 0 0"/>'
        for finger in FINGERS[1:]
        if reference
    )
    world = f'<body name="palm">{MASS}{box}{fingers}</body>' if palm else box + fingers
    path = folder / "hand.xml"
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody>{world}</worldbody>'
        f"<equality>{equalities}</equality></mujoco>",
        encoding="utf-8",
    )
    return path


def assert_upright(description: HandDescription, side: str) -> None:
    """Asserts the side, five fingers, and a base with the axes of the palm."""
    assert description.side == side and description.finger_names == list(FINGERS)
    R_PB = RollPitchYaw(np.deg2rad(description.base_pose.rpy_deg)).ToRotationMatrix()
    np.testing.assert_allclose(R_PB.matrix(), np.eye(3), atol=1e-4)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("offset", [-0.011, 0.0, 0.011, 0.02])
def test_the_base_does_not_depend_on_where_spread_joints_lie(side, offset, tmp_path):
    """Bent fingers reach farther from a spread joint behind the mcp joint than straight ones do."""
    assert_upright(propose(write_urdf(tmp_path, side, offset))[0], side)


@pytest.mark.parametrize("leader", ["mcp", "pip"])
def test_the_base_does_not_depend_on_which_joint_leads(leader, tmp_path):
    """The side, and the fingers' reach, are the same whether mcp or pip has the motor."""
    hand = Hand(propose(write_urdf(tmp_path, leader=leader))[0])
    assert_upright(hand.description, "left")
    reach = hand.fingertips(np.zeros(len(hand.joint_names)))[1:, 2].max()
    p_BK = hand.kinematics().fingers[1].X_PJ[0, 2, 3]
    assert reach - p_BK == pytest.approx(2 * LENGTH - 0.006, abs=0.003)


def test_fingers_whose_links_are_angled_are_not_taken_for_bent(tmp_path):
    """With far joints in front of the near ones, a finger is longest where it is bent by 26 degrees."""
    place = f'<origin xyz="0.0 0.0 {LENGTH}" rpy="0 0.0 0"/>'
    changes = {place: place.replace("0.0 0.0", "0.022 0.0", 1)}
    assert_upright(propose(write_urdf(tmp_path, changes=changes))[0], "left")


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("leader", ["mcp", "pip"])
def test_the_base_does_not_depend_on_how_far_coupled_fingers_are_bent_as_drawn(leader, side, tmp_path):
    """A relaxed hand has its zero positions in the middle of its joints' ranges."""
    assert_upright(propose(write_urdf(tmp_path, side, leader=leader, drawn=0.7))[0], side)


def test_a_base_across_the_palms_axes_is_told(tmp_path):
    """As of independent joints that are drawn bent: the first one is taken to be straight."""
    notes = "\n".join(propose(write_urdf(tmp_path, drawn=0.7))[1])
    assert "no axes of the palm's link lie along the fingers" in notes


@pytest.mark.parametrize(
    ("turn", "finding"),
    [
        (
            (0, 0, 90),
            r"index \(joints 'index_spread', 'index_mcp', 'index_pip'\) bends \d+ degrees away from",
        ),
        (
            (0, 80, 0),
            r"middle \(joints 'middle_spread', .*\) points \d+ degrees away from \+z of the hand base",
        ),
        ((0, 0, 180), r"ring \(joints 'ring_spread', .*\) bends \d+ degrees away from \+x of the hand base"),
    ],
)
def test_a_turned_base_is_named(turn, finding, tmp_path):
    """Fingers must point to +z and bend to +x; before the turn there is no such finding."""
    description = propose(write_urdf(tmp_path))[0]
    assert "of the hand base" not in "\n".join(examine(Hand(description)))
    description.base_pose.rpy_deg = list(map(float, turn))
    found = "\n".join(examine(Hand(description)))
    assert re.search(finding, found), found


def test_couplings_are_in_deviations_from_references(tmp_path):
    """MuJoCo's equality holds at every angle; the hand starts where MuJoCo does."""
    model = write_mjcf(tmp_path, reference=-0.35)
    couplings, _ = read_couplings(model)
    assert {c.joint: (c.ratio, c.offset) for c in couplings}["index_pip"] == pytest.approx(
        (0.7, 0.1 + 0.7 * 0.35)
    )
    assert_upright(propose(model)[0], "right")
    hand = Hand(propose(model)[0])
    m = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(m)
    for q in hand.sample(5):
        (row,) = hand.couplings.with_followers(q[None])
        for name, angle in zip([*hand.joint_names, *hand.couplings.names], row, strict=True):
            data.joint(name).qpos = angle
        mujoco.mj_forward(m, data)
        assert np.abs(data.efc_pos[: len(couplings)]).max() < 1e-9
        base = hand.description.base_pose.translation
        for finger, p_BF in zip(hand.description.fingers, hand.fingertips(q), strict=True):
            body = data.body(finger.tip_link)
            p_WF = body.xmat.reshape(3, 3) @ finger.tip_point + body.xpos
            np.testing.assert_allclose(p_BF + base, p_WF, atol=1e-9)


def test_the_world_may_be_the_palm(tmp_path):
    """MuJoCo's conversion of a URDF fuses the base into the world; its geoms are then the palm's."""
    hand = Hand(propose(write_mjcf(tmp_path, palm=False))[0])
    assert_upright(hand.description, "right")
    assert hand.description.base_pose.relative_to == "worldbody"
    assert hand.plant.GetCollisionGeometriesForBody(hand.plant.GetBodyByName("worldbody"))


@pytest.mark.parametrize("inner", [False, True])
def test_a_package_is_known_by_its_package_xml(inner, tmp_path):
    """Whatever its folder is called, and also if an inner folder has the package's name."""
    folder = tmp_path / "my-hand-main"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes").mkdir()
    if inner:
        (folder / "my_hand").mkdir()
    (folder / "meshes" / "palm.obj").write_text(
        "v 0 0 0\nv .01 0 0\nv 0 .01 0\nv 0 0 .09\nf 1 2 3\nf 1 2 4\n"
    )
    palm = '<cylinder radius="0.006" length="0.09"/>'
    model = write_urdf(
        folder / "urdf", changes={palm: '<mesh filename="package://my_hand/meshes/palm.obj"/>'}
    )
    if not inner:
        with pytest.raises(
            HandError, match=r"the package 'my_hand' is in no folder above .*<name>my_hand</name>"
        ):
            propose(model)
    (folder / "package.xml").write_text("<package>\n  <name> my_hand </name>\n</package>")
    assert_upright(propose(model)[0], "left")
    # Another encoding, and other names before the package's.
    text = (
        "<package><!-- <name>old</name> --><author><name>José</name></author><name>my_hand</name></package>"
    )
    (folder / "package.xml").write_text(
        f'<?xml version="1.0" encoding="ISO-8859-1"?>{text}', encoding="latin-1"
    )
    assert_upright(propose(model)[0], "left")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('lower="0.0" upper="1.4"', 'lower="1.4" upper="0.0"', r"joint 'thumb_mcp' has its limits swapped"),
        ('joint name="ring_pip"', 'joint name="ring_mcp"', r"2 joints are called 'ring_mcp'"),
        ('link name="ring_pip_link"', 'link name="ring_mcp_link"', r"2 links are called 'ring_mcp_link'"),
        ('multiplier="0.9"', 'multiplier="0"', r"joint 'index_pip' follows 'index_mcp' by a multiplier of 0"),
        (
            'lower="0.0" upper="1.4"',
            'lower="0.0" upper="x"',
            r"joint 'thumb_mcp': upper must be a number; given: x",
        ),
        ('velocity="5"', 'velocity="-5"', r"joint 'thumb_mcp' has the negative velocity limit -5 rad/s"),
    ],
)
def test_unusable_values_are_named(old, new, message, tmp_path):
    """With their joint or link."""
    with pytest.raises(HandError, match=message):
        propose(write_urdf(tmp_path, leader="mcp", changes={old: new}))


@pytest.mark.parametrize(
    ("leader", "old", "new", "message"),
    [
        (
            "",
            '<parent link="palm"/><child link="index_spread_link"/>',
            '<parent link="index_pip_link"/><child link="index_spread_link"/>',
            r"the joints 'index_.*', 'index_.*', 'index_.*' form a loop",
        ),
        (
            "",
            '<parent link="middle_mcp_link"/><child link="middle_pip_link"/>',
            '<parent link="middle_mcp_link"/><child link="index_pip_link"/>',
            r"the joints 'index_pip' and 'middle_pip' both move 'index_pip_link'",
        ),
        # Drake itself refuses two joints between the same links.
        (
            "mcp",
            '<parent link="palm"/><child link="index_mcp_link"/>',
            '<parent link="index_pip_link"/><child link="index_mcp_link"/>',
            r"joint 'index_mcp' .* joint 'index_pip' .* is not allowed",
        ),
    ],
)
def test_joints_that_form_no_tree_are_named(leader, old, new, message, tmp_path):
    with pytest.raises(HandError, match=message):
        propose(write_urdf(tmp_path, leader=leader, changes={old: new}))


def test_a_finger_without_limits_is_not_left_out(tmp_path):
    """Otherwise the other fingers would get other names: without the thumb, the middle finger became it."""
    path = write_mjcf(tmp_path)
    text = re.sub(r'(name="thumb_\w+" axis="0 1 0") range="[^"]*"', r"\1", path.read_text("utf-8"))
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HandError, match="a finger cannot move: 'thumb_mcp' has no position limits"):
        propose(path)


def test_fingers_that_one_motor_moves_are_held(tmp_path):
    """As the ring and little fingers of some hands; the others are described."""
    changes = {'<mimic joint="little_mcp"': '<mimic joint="ring_mcp"'}
    model = write_urdf(tmp_path, leader="mcp", changes=changes)
    joint = '<joint name="little_mcp" type="revolute">'
    head, _, tail = model.read_text("utf-8").partition(joint)
    follower = tail.replace("</joint>", '<mimic joint="ring_mcp"/></joint>', 1)
    model.write_text(head + joint + follower, encoding="utf-8")
    description, notes = propose(model)
    assert description.finger_names == ["thumb", "index", "middle"]
    assert "as each moves 2 fingers at once: 'ring_mcp'" in "\n".join(notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="ring_mcp" axis="0 1 0" range="-0.6 1.4"', 'name="ring_mcp" axis="0 1 0" range="1.4 -0.6"',
         r"joint 'ring_mcp' has the ends of its range swapped: 1.4 is above -0.6"),
        ("</mujoco>", '<actuator><position name="a" joint="ring_mcp" ctrlrange="1 0"/></actuator></mujoco>',
         r"actuator 'a' has the ends of its ctrlrange swapped"),
    ],
)  # fmt: skip
def test_swapped_ends_of_a_range_in_mjcf_are_named(old, new, message, tmp_path):
    """MuJoCo takes such a range for none, so that the joint would be held."""
    path = write_mjcf(tmp_path)
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(HandError, match=message):
        propose(path)


def test_a_tip_far_from_its_finger_is_found(tmp_path):
    """Collision geometry beside the finger, as of a mesh that was exported in another frame."""
    assert "the tip of" not in "\n".join(examine(Hand(propose(write_mjcf(tmp_path))[0])))
    description = propose(write_mjcf(tmp_path, thumb_geom="-0.05 0.1 -0.05"))[0]
    found = "\n".join(examine(Hand(description)))
    assert "the tip of thumb lies 122 mm from its last joint 'thumb_pip'" in found
    assert "mm beside the visual geometry of 'thumb_2', which joint 'thumb_pip' moves" in found


def test_a_velocity_limit_of_zero_counts_as_unknown(tmp_path):
    """Exporters write it; a note names the joint, and the hand has no such limit."""
    joint = '<joint name="middle_mcp" type="revolute">'
    model = write_urdf(tmp_path)
    head, _, tail = model.read_text().partition(joint)
    model.write_text(head + joint + tail.replace('effort="1" velocity="5"', 'effort="0" velocity="0"', 1))
    description, notes = propose(model)
    assert "the velocity limit 0 of joint 'middle_mcp' counts as unknown" in "\n".join(notes)
    joint = Hand(description).plant.GetJointByName("middle_mcp")
    assert joint.velocity_upper_limit() == np.inf


def test_a_hand_without_geometry_is_recorded(tmp_path):
    """With its frames and fingertips."""
    model = write_urdf(tmp_path, geometry=False)
    files = {"--output": tmp_path / "hand.yaml", "--rrd": tmp_path / "hand.rrd"}
    options = [str(part) for option in files.items() for part in option]
    assert run_command("hand add", [str(model), *options]) == 0
    assert b"tips/index" in (tmp_path / "hand.rrd").read_bytes()
