"""Hand descriptions: finding, reading and checking them."""

import pytest
from model_scene import SHIPPED_HANDS

from geort_drake.errors import HandError, UnknownNameError
from geort_drake.hands.description import hand_names, load_hand
from geort_drake.hands.model import HandModel
from geort_drake.resources import models_dir


def test_fingers_come_thumb_first_and_joints_finger_by_finger():
    """The order of q is the description's, whatever order the plant has."""
    hand = load_hand("allegro_right")
    assert hand.finger_names == ["thumb", "index", "middle", "ring"]
    assert hand.joint_names == [f"joint_{i}" for i in (12, 13, 14, 15, *range(12))]
    assert [finger.human_keypoint for finger in hand.fingers] == [4, 8, 12, 16]


def test_hands_have_the_names_of_their_files(monkeypatch, tmp_path):
    """The shipped ones, and one that a user puts beside them."""
    assert set(SHIPPED_HANDS) <= set(hand_names())
    (tmp_path / "hands").mkdir()
    text = (models_dir() / "hands" / "leap_right.yaml").read_text(encoding="utf-8")
    (tmp_path / "hands" / "mine.yaml").write_text(text.replace("name: leap_right", "name: mine"))
    monkeypatch.setattr("geort_drake.hands.description.models_dir", lambda: tmp_path)
    assert hand_names() == ["mine"]
    assert load_hand("mine").name == "mine"


def test_unknown_hand_lists_the_choices():
    """The error for an unknown name lists the known ones."""
    with pytest.raises(UnknownNameError, match=r"unknown hand 'alegro'.*allegro_right"):
        load_hand("alegro")


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
        (_set("model", "nothing.sdf"), r"nothing\.sdf is missing"),
        (_set("side", "middle"), r"side must be one of left, right; given: 'middle'"),
        (_set("base_frame", "palm"), r"base_frame names the frame or link 'palm'.*base_link"),
        (_set("fingers.1.tip_link", "tip"), r"fingers\.index\.tip_link names.*'tip'.*link_3"),
        (_set("fingers.1.joints", ["joint_12", "joint_1"]), r"every joint once; given: twice: joint_12"),
        (_set("fingers.1.name", "pinky"), r"fingers\[1\]\.name must be one of thumb.*'pinky'"),
        (_set("fingers.1.tip_radius", -0.01), r"tip_radius must be positive"),
        (_set("default_positions.joint_12", 0.0), r"joint_12 must be within its limits.*0\.263.*given: 0"),
        (_set("mount.frame", "wrist"), r"mount\.frame names the frame or link 'wrist'.*mount"),
        (_set("colour", "red"), r"hand\.yaml is malformed.*colour"),
    ],
)
def test_bad_descriptions_name_what_is_wrong(allegro_copy, change, message):
    """Every error names the field, what was expected, what was given, and the choices."""
    facts, load = allegro_copy
    change(facts)
    with pytest.raises(HandError, match=f"(?s){message}"):
        HandModel(load())


def test_joints_that_form_no_finger_are_refused(allegro_copy):
    """A chain needs all of its moving joints, base to tip."""
    facts, load = allegro_copy
    joints = facts["fingers"][1]["joints"]
    facts["fingers"][1]["joints"] = joints[::-1]
    with pytest.raises(HandError, match=r"finger 'index': its joints must be listed base to tip"):
        HandModel(load()).kinematics()


def test_missing_or_unreadable_files_are_named(tmp_path):
    """A missing description, and a model that is no SDF, are reported by path."""
    with pytest.raises(HandError, match=r"absent\.yaml is missing"):
        load_hand(tmp_path / "absent.yaml")
    (tmp_path / "broken.sdf").write_text("<sdf>", encoding="utf-8")
    hand = load_hand("allegro_right")
    hand.model = str(tmp_path / "broken.sdf")
    with pytest.raises(HandError, match=r"broken\.sdf: not XML"):
        HandModel(hand)
