"""What Drake does not read in MJCF: defaults from classes further out, tendons that couple, loops."""

import dataclasses as dc
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hand_family import HandSpec, write_hand
from pydrake.geometry import Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.errors import HandError
from geort_drake.hands.importers.conversion import convert_model, drake_misreadings
from geort_drake.hands.importers.couplings import (
    coupling_notes,
    read_couplings,
    tendon_couplings,
)
from geort_drake.hands.importers.proposal import propose
from geort_drake.hands.mjcf import inherit_defaults
from geort_drake.hands.model import HandModel

# The fingers' hinges take axis and range from two classes further out; "inner" has a joint of its own again.
CLASSES = """<default><joint damping="0.1"/>
  <default class="hand"><joint axis="0 1 0" range="0 1.5"/>
    <default class="between"><geom group="3"/><default class="inner"><joint range="0 1"/></default></default>
  </default>
  <default class="drawn"><geom group="2"/></default>
</default>"""


def tree(body: str, head: str = "") -> ET.Element:
    return ET.fromstring(f"<mujoco>{head}<worldbody><body>{body}</body></worldbody></mujoco>")


def joint_settings(model: ET.Element, name: str) -> dict[str, str]:
    default = next(node for node in model.iter("default") if node.get("class") == name)
    return default.find("joint").attrib


def test_classes_get_what_those_further_out_have():
    """Two classes down, with what the class itself sets, and in a class that sets nothing of the kind."""
    model = tree('<joint class="inner"/><geom class="between"/>', CLASSES)
    assert inherit_defaults(model) == ["inner"]
    assert joint_settings(model, "inner") == {"axis": "0 1 0", "range": "0 1", "damping": "0.1"}
    assert joint_settings(model, "between") == {"axis": "0 1 0", "range": "0 1.5", "damping": "0.1"}
    assert joint_settings(model, "drawn") == {"damping": "0.1"}
    assert inherit_defaults(model) == []


@pytest.mark.parametrize(
    ("body", "lacking"),
    [
        ('<joint class="hand"/><geom class="drawn"/><geom class="between"/>', []),
        ('<body childclass="between"><joint/></body>', ["between"]),
        ('<body childclass="between"><joint class="hand"/></body>', []),
        ("<joint/>", []),
    ],
)
def test_only_classes_that_joints_and_shapes_take_are_named(body, lacking):
    """By their own class, or that of the bodies around them."""
    assert inherit_defaults(tree(body, CLASSES)) == lacking


def test_drake_reads_what_was_handed_down(tmp_path):
    """Axis, limits, gain and size, through a class that has neither joint nor shape nor motor."""
    model = tree(
        '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="j" class="c"/><geom class="c"/>',
        '<compiler angle="radian"/><default><default class="a"><joint axis="1 0 0" range="0 1"/>'
        '<geom type="sphere" size="0.03"/><position kp="7"/>'
        '<default class="b"><site/><default class="c"><geom rgba="1 0 0 1"/></default></default>'
        '</default></default><actuator><position joint="j" class="c"/></actuator>',
    )
    assert inherit_defaults(model) == ["c"]
    model.set("model", "handed_down")
    path = tmp_path / "model.xml"
    path.write_text(ET.tostring(model, encoding="unicode"), encoding="utf-8")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    Parser(plant).AddModels(path)
    joint, inspector = plant.GetJointByName("j"), scene_graph.model_inspector()
    np.testing.assert_allclose(joint.revolute_axis(), [1, 0, 0])
    assert (joint.position_lower_limit(), joint.position_upper_limit()) == (0, 1)
    (motor,) = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    assert motor.get_controller_gains().p == 7
    (geometry,) = inspector.GetAllGeometryIds(Role.kProximity)
    assert inspector.GetShape(geometry).radius() == 0.03


@pytest.fixture
def classy(tmp_path) -> Path:
    """A hand of the family that has its limits from a class, through one that has no joint."""
    model = write_hand(tmp_path, HandSpec(3, "xml", mimic=False))
    text = model.read_text().replace('range="0.0 1.5"', 'class="inner"')
    classes = CLASSES.replace(' axis="0 1 0"', "").replace('<joint range="0 1"/>', "")
    model.write_text(text.replace("<worldbody>", f"{classes}<worldbody>"), encoding="utf-8")
    return model


def test_a_copy_has_the_limits_that_the_model_means(classy, tmp_path):
    """The same hand as without classes; the model itself is refused, as Drake gives it no limits."""
    (said,) = drake_misreadings(classy)
    assert said.endswith("the default classes inner")
    hand = HandModel(propose(convert_model(classy, tmp_path / "copy")).description)
    plain = HandModel(propose(write_hand(tmp_path, HandSpec(3, "xml", mimic=False), "plain")).description)
    assert hand.joint_names == plain.joint_names
    np.testing.assert_allclose(hand.lower, plain.lower)
    np.testing.assert_allclose(hand.upper, plain.upper)
    with pytest.raises(HandError, match=r"Drake loses defaults of the classes inner.*geort-drake add-hand"):
        propose(classy)


# -- tendons

JOINTS = '<joint name="a"/><body><joint name="b"/><body><joint name="c"/></body></body>'
MOTOR = '<actuator><position tendon="t"/></actuator>'


def fixed(coefficients: dict[str, float], settings: str = "", more: str = "") -> ET.Element:
    parts = "".join(f'<joint joint="{joint}" coef="{c}"/>' for joint, c in coefficients.items())
    return tree(JOINTS, f'<tendon><fixed name="t" {settings}>{parts}</fixed></tendon>{more}')


OPPOSITE = {"a": -0.008, "b": 0.007}
NARROW = 'range="-0.001 0.001"'
TENDON_CLASSES = f'<default><default class="tight"><tendon {NARROW} limited="true"/></default></default>'


@pytest.mark.parametrize(
    ("model", "wanted"),
    [
        (fixed(OPPOSITE, NARROW), ("b", "a", 8 / 7, 0.0)),
        (fixed(OPPOSITE, 'range="0.013 0.015"'), ("b", "a", 8 / 7, 2.0)),
        (fixed(OPPOSITE, 'class="tight"', TENDON_CLASSES), ("b", "a", 8 / 7, 0.0)),
        (fixed({"b": 1, "a": -1}, more='<equality><tendon tendon1="t" polycoef="0.5 0 0 0 0"/></equality>'),
         ("b", "a", 1.0, 0.5)),
        (fixed({"a": 1, "b": 1}, more=MOTOR), ("b", "a", 1.0, 0.0)),
        (fixed({"a": 2, "b": 1}, more=MOTOR), ("b", "a", 0.5, 0.0)),
        (fixed(OPPOSITE, NARROW, '<actuator><motor joint="b"/></actuator>'), ("a", "b", 7 / 8, 0.0)),
    ],
)  # fmt: skip
def test_a_tendon_that_couples_two_joints(model, wanted):
    """By its range, its class's, an equality of its length, or one motor; the one with a motor leads."""
    (found,) = tendon_couplings(model)
    joint, follows, ratio, offset = dc.astuple(found.coupling)
    assert (joint, follows) == wanted[:2]
    assert (ratio, offset) == (pytest.approx(wanted[2]), pytest.approx(wanted[3]))
    assert found.assumed == ("<actuator><position" in ET.tostring(model, encoding="unicode"))
    assert bool(coupling_notes(model)) == found.assumed


@pytest.mark.parametrize(
    "model",
    [
        fixed(OPPOSITE, 'range="-0.01 0.01"'),
        fixed(OPPOSITE, NARROW + ' limited="false"'),
        fixed(OPPOSITE, NARROW, '<compiler autolimits="false"/>'),
        fixed(OPPOSITE),
        fixed(OPPOSITE, 'class="tight"'),
        fixed({"a": 1}, NARROW),
        fixed({"a": 1, "b": 1, "c": 1}, NARROW),
        fixed({"a": 1, "b": 1}, more=MOTOR.replace("/><", '/><motor joint="b"/><')),
        fixed(OPPOSITE, more='<equality><tendon tendon1="t" active="false"/></equality>'),
    ],
)
def test_other_tendons_couple_nothing(model):
    """Loose ones, such as limits of a single joint, and those of joints that have motors themselves."""
    assert tendon_couplings(model) == []


@pytest.mark.parametrize("kept", ["tendon", "both"])
def test_what_follows_is_read_from_tendons_like_from_an_equality(kept, tmp_path):
    """Of the family's hand, 0.8 q + 0.1; where there are both, once."""
    model = write_hand(tmp_path, HandSpec(3, "xml"))
    wanted = [dc.astuple(c) for c in read_couplings(model)]
    text = model.read_text()
    tendons = "".join(
        f'<fixed name="t{i}" range="0.0999 0.1001"><joint joint="{leader}" coef="-{ratio}"/>'
        f'<joint joint="{joint}" coef="1"/></fixed>'
        for i, (joint, leader, ratio, _) in enumerate(wanted)
    )
    text = text.replace("<actuator>", f"<tendon>{tendons}</tendon><actuator>")
    if kept == "tendon":
        text = re.sub("<equality>.*</equality>", "", text)
    model.write_text(text, encoding="utf-8")
    found = [dc.astuple(c) for c in read_couplings(model)]
    assert [row[:2] for row in found] == [row[:2] for row in wanted]
    np.testing.assert_allclose([row[2:] for row in found], [row[2:] for row in wanted])


def test_what_is_not_read_is_named(tmp_path):
    """Closed loops, and tendons that pull otherwise."""
    model = write_hand(tmp_path, HandSpec(3, "xml"))
    text = model.read_text().replace(
        "</mujoco>",
        '<equality><connect body1="index_l3" body2="middle_l3" anchor="0 0 0"/></equality>'
        '<tendon><spatial name="rope"/></tendon><actuator><motor tendon="rope"/></actuator></mujoco>',
    )
    model.write_text(text, encoding="utf-8")
    notes = " ".join(propose(model).notes)
    assert "'rope'" in notes
    assert "'index_l3' and 'middle_l3'" in notes
