"""Models of more than a hand: refused without the palm's name, described with it."""

import re

import pytest
from hand_family import HandSpec, write_hand

from geort_drake.cli import run_command
from geort_drake.errors import HandError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.hands.importers.proposal import propose

INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'


def _robot(folder, arm_joints: int, legs: int = 0, hands=("left", "right"), fingers: int = 3):
    """A URDF of a torso with an arm on each side, each with a hand, and with legs of three joints."""
    limit = '<limit lower="-1" upper="1" effort="9" velocity="2"/>'
    lines = [f'<link name="torso">{INERTIAL}</link>']

    def chain(name, count, kind="revolute"):
        parent = "torso"
        for number in range(count):
            link = f"{name}_{number}"
            lines.append(f'<link name="{link}">{INERTIAL}</link>')
            lines.append(
                f'<joint name="{link}_joint" type="{kind}"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="0 0.1 0.1"/><axis xyz="1 0 0"/>{limit}</joint>'
            )
            parent = link
        return parent

    for side in hands:
        text = write_hand(folder, HandSpec(fingers, mimic=False, side=side), side).read_text(encoding="utf-8")
        inside = text[text.index(">") + 1 : text.rindex("<")]
        lines.append(re.sub(r'(name|link)="', rf'\1="{side}_', inside))
        end = chain(f"{side}_arm", arm_joints)
        lines.append(
            f'<joint name="{side}_mount" type="fixed"><parent link="{end}"/>'
            f'<child link="{side}_palm"/></joint>'
        )
    for number in range(legs):
        chain(f"leg{number}", 3)
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot">{"".join(lines)}</robot>', encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("arm_joints", "legs", "hands", "message"),
    [
        (7, 2, ("left", "right"), "of 'torso', 'left_palm', 'right_palm'; give the palm as --palm"),
        (2, 0, ("left", "right"), "leave each of 'torso', 'left_palm', 'right_palm'"),
        (0, 0, ("left", "right"), "6 chains of joints leave its palm, the link 'torso'"),
        (7, 2, ("right",), "leave each of 'torso', 'right_palm'"),
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
    run_command("add-hand", [str(robot), "--palm", f"{side}_palm", "--output", str(tmp_path / "hand.yaml")])
    description = load_hand(tmp_path / "hand.yaml")
    assert description.side == side
    assert description.base_pose.relative_to == f"{side}_palm"
    assert {joint.partition("_")[0] for joint in description.joint_names} == {side}
    assert len(description.joint_names) == 11
    text = (tmp_path / "hand.yaml").read_text(encoding="utf-8")
    assert "as each belongs to no finger: " in text
    with pytest.raises(
        UnknownNameError, match=r"unknown link of the model 'hand'; choose one of: .*left_palm"
    ):
        propose(robot, palm="hand")


def test_one_hand_may_have_an_arm_or_a_folding_palm(tmp_path):
    """An arm that carries all fingers, or a joint of the palm that carries two of four."""
    described = propose(_robot(tmp_path, 7, hands=("right",))).description
    assert described.finger_names == ["thumb", "index", "middle"]
    fold = (
        f'<link name="fold">{INERTIAL}</link><joint name="fold" type="revolute"><parent link="palm"/>'
        '<child link="fold"/><axis xyz="0 0 1"/><limit lower="0" upper="0.4" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    changes = {r'(<joint name="(middle|ring)_j0".*?<parent link=")palm': r"\1fold", "</robot>": fold}
    proposal = propose(write_hand(tmp_path, HandSpec(4, mimic=False), changes=changes))
    assert proposal.description.finger_names == ["thumb", "index", "middle", "ring"]
    assert "as each moves 2 fingers at once: 'fold'" in "\n".join(proposal.notes)


def test_of_two_hands_in_one_file_the_named_one_is_described(tmp_path):
    """Each with a root, followers and motors of its own; the other hand's joints are held."""
    parts = {"worldbody": "", "equality": "", "actuator": ""}
    for side, fingers in (("left", 4), ("right", 3)):
        text = write_hand(tmp_path, HandSpec(fingers, "xml", side=side), side).read_text(encoding="utf-8")
        text = re.sub(r'(name|joint\d?)="', rf'\1="{side}_', text)
        for part in parts:
            parts[part] += re.search(rf"<{part}>(.*)</{part}>", text, re.DOTALL)[1]
    inside = "".join(f"<{part}>{text}</{part}>" for part, text in parts.items())
    model = tmp_path / "both.xml"
    model.write_text(f'<mujoco model="both"><compiler angle="radian"/>{inside}</mujoco>', encoding="utf-8")
    for side, fingers in (("left", 4), ("right", 3)):
        description = propose(model, palm=f"{side}_palm").description
        assert (description.side, len(description.fingers)) == (side, fingers)
        assert {joint.partition("_")[0] for joint in description.joint_names} == {side}
