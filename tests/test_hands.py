"""Hand descriptions, the exact hand model and its digest."""

import shutil

import numpy as np
import pytest
import torch
import trimesh
from hand_family import HandSpec, write_hand
from model_scene import SHIPPED_HANDS

from geort_drake.errors import HandError
from geort_drake.hands.collision_shapes import collision_shapes
from geort_drake.hands.description import load_hand, write_description
from geort_drake.hands.importers.checks import nearest_pinch
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.model import HandModel
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics


def _uniform(hand: HandModel, rng, count: int) -> np.ndarray:
    return rng.uniform(hand.lower, hand.upper, (count, len(hand.joint_names)))


# -- descriptions


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
        (_set("colour", "red"), r"hand\.yaml is malformed.*colour"),
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
        HandModel(load()).kinematics()


# -- the model


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_shipped_hands_start_free_and_pinch(name):
    """No self-collision at the start; the thumb's tip reaches every other one."""
    hand = HandModel(load_hand(name))
    assert not hand.collides(hand.default_position)
    kinematics = NumpyKinematics(hand.kinematics())
    for number in range(1, len(hand.finger_names)):
        assert nearest_pinch(kinematics, number) < 1.8 * hand.tip_radius


def test_a_mirrored_left_hand_equals_the_right_one(allegro, allegro_left, rng):
    """In the mirror, limits, kinematics, wrist and collision shapes of a left hand are those of the right."""
    for name in ("joint_names", "lower", "upper"):
        np.testing.assert_array_equal(getattr(allegro_left, name), getattr(allegro, name))
    q = torch.tensor(_uniform(allegro, rng, 20))
    ours, theirs = allegro_left.kinematics().mirrored(), allegro.kinematics()
    torch.testing.assert_close(ours.fingertips(q), theirs.fingertips(q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.p_BW, theirs.p_BW, atol=1e-12)
    ours, theirs = collision_shapes(allegro_left).mirrored(), collision_shapes(allegro)
    for field in ("joint", "half", "radius", "pairs"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    np.testing.assert_allclose(ours.X_JS, theirs.X_JS, atol=1e-12)


def test_the_mount_is_the_wrist_and_not_part_of_the_hand(allegro_copy):
    """It defines the wrist, is optional, and does not change the digest."""
    facts, load = allegro_copy
    mounted = HandModel(load())
    np.testing.assert_allclose(mounted.p_BW, [0, 0, -0.095], atol=1e-12)
    del facts["mount"]
    bare = HandModel(load())
    np.testing.assert_array_equal(bare.p_BW, np.zeros(3))
    assert bare.digest == mounted.digest


def test_kinematics_survive_an_offset_base_and_welded_links(allegro_copy, rng, tmp_path):
    """With a base frame away from its link, and a tip on a welded link, torch agrees with Drake to 1e-9 m."""
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
    hand = HandModel(load())
    q = _uniform(hand, rng, 50)
    tips = hand.kinematics().fingertips(torch.tensor(q))
    np.testing.assert_allclose(tips.numpy(), hand.fingertips(q), atol=1e-9)


def test_a_joint_that_no_finger_lists_is_held_at_its_default(allegro_copy, rng):
    """The finger has one joint less, and moves like the whole one with that joint at this angle."""
    facts, load = allegro_copy
    whole = HandModel(load())
    facts["fingers"][1]["joints"].remove("joint_0")
    facts["default_positions"]["joint_0"] = 0.2
    hand = HandModel(load())
    q = _uniform(hand, rng, 20)
    np.testing.assert_allclose(hand.kinematics().fingertips(torch.tensor(q)), hand.fingertips(q), atol=1e-9)
    at = whole.joint_names.index("joint_0")
    np.testing.assert_allclose(whole.fingertips(np.insert(q, at, 0.2, axis=1)), hand.fingertips(q), atol=1e-9)


# -- the digest


def _described(folder, model):
    write_description(propose(model).description, folder / "hand.yaml")
    return HandModel(load_hand(folder / "hand.yaml"))


def _palm_mesh(depth: float) -> str:
    return trimesh.creation.box((depth, 0.04, 0.07)).export(file_type="obj")


def test_the_digest_covers_collision_meshes(tmp_path):
    """But neither unused files nor the folder."""
    folder = tmp_path / "mine"
    folder.mkdir()
    model = write_hand(folder, HandSpec(3), changes={"<box .*?/>": '<mesh filename="palm.obj"/>'})
    (folder / "palm.obj").write_text(_palm_mesh(0.03))
    digest = _described(folder, model).digest
    (folder / "other.obj").write_text(_palm_mesh(0.02))
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert HandModel(load_hand(tmp_path / "elsewhere" / "hand.yaml")).digest == digest
    (folder / "palm.obj").write_text(_palm_mesh(0.031))
    assert HandModel(load_hand(folder / "hand.yaml")).digest != digest


@pytest.mark.parametrize("kind", ["sdf", "xml"])
def test_the_digest_covers_included_files(kind, tmp_path):
    """A whole SDF model in another's file, and actuators in a file of their own in MJCF."""
    (tmp_path / "parts").mkdir()
    inner = write_hand(tmp_path / "parts", HandSpec(3, kind), "inner")
    text = inner.read_text()
    outer = tmp_path / f"hand.{kind}"
    if kind == "sdf":
        include = "<include merge='true'><uri>package://parts/inner.sdf</uri></include>"
        outer.write_text(f'<sdf version="1.11"><model name="outer">{include}</model></sdf>')
        change = ("<mass>0.03</mass>", "<mass>0.04</mass>")
    else:
        begin = text.index("<actuator>")
        end = text.index("</actuator>") + len("</actuator>")
        inner.write_text(f"<mujoco>{text[begin:end]}</mujoco>")
        outer.write_text(text[:begin] + '<include file="parts/inner.xml"/>' + text[end:])
        change = ('kp="1"', 'kp="2"')
    before = _described(tmp_path, outer).digest
    assert HandModel(load_hand(tmp_path / "hand.yaml")).digest == before
    inner.write_text(inner.read_text().replace(*change))
    assert HandModel(load_hand(tmp_path / "hand.yaml")).digest != before


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("allegro_left", "800cb801fb4a12d0"),
        ("allegro_right", "06a693eef3b0f675"),
        ("leap_right", "59d2d7f8cb1425a2"),
    ],
)
def test_shipped_hands_keep_their_digest(name, start):
    """Saved checkpoints fit a hand with the same digest only."""
    assert HandModel(load_hand(name)).digest.startswith(start)
