"""MJCF features that Drake ignores: defaults from outer classes, coupling tendons, closed loops."""

import dataclasses as dc
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hand_family import HandSpec, write_hand
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from geort_drake.hands.assembly import parse_model
from geort_drake.hands.importers.couplings import tendon_couplings
from geort_drake.hands.importers.proposal import propose


def tree(body: str, head: str = "") -> ET.Element:
    return ET.fromstring(f"<mujoco>{head}<worldbody><body>{body}</body></worldbody></mujoco>")


def test_settings_reach_inner_classes(tmp_path):
    """Axis, limits, gain and size, through a class without a joint, geom or motor, in an included file."""
    (tmp_path / "classes.xml").write_text(
        '<mujoco><default><default class="a"><joint axis="1 0 0" range="0 1"/>'
        '<geom type="sphere" size="0.03"/><position kp="7"/>'
        '<default class="b"><site/><default class="c"><geom rgba="1 0 0 1"/></default></default>'
        "</default></default></mujoco>",
        encoding="utf-8",
    )
    model = tree(
        '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="j" class="c"/><geom class="c"/>',
        '<compiler angle="radian"/><include file="classes.xml"/><actuator><position joint="j" class="c"/>'
        "</actuator>",
    )
    path = tmp_path / "model.xml"
    path.write_text(ET.tostring(model, encoding="unicode"), encoding="utf-8")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=0.001)
    parse_model(plant, path, "model")
    joint, inspector = plant.GetJointByName("j"), scene_graph.model_inspector()
    np.testing.assert_allclose(joint.revolute_axis(), [1, 0, 0])
    assert (joint.position_lower_limit(), joint.position_upper_limit()) == (0, 1)
    (motor,) = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    assert motor.get_controller_gains().p == 7
    (geometry,) = inspector.GetAllGeometryIds(Role.kProximity)
    assert inspector.GetShape(geometry).radius() == 0.03


def tendon(coefficients: dict[str, float], settings: str = "", more: str = "") -> ET.Element:
    joints = '<joint name="a"/><body><joint name="b"/><body><joint name="c"/></body></body>'
    parts = "".join(f'<joint joint="{joint}" coef="{c}"/>' for joint, c in coefficients.items())
    return tree(joints, f'<tendon><fixed name="t" {settings}>{parts}</fixed></tendon>{more}')


OPPOSITE = {"a": -0.008, "b": 0.007}
NARROW = 'range="-0.001 0.001"'
MOTOR = '<actuator><position tendon="t"/></actuator>'
TIGHT = f'<default><default class="tight"><tendon {NARROW} limited="true"/></default></default>'
FIXED_LENGTH = '<equality><tendon tendon1="t" polycoef="0.5 0 0 0 0"/></equality>'


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (tendon(OPPOSITE, 'range="0.013 0.015"'), ("b", "a", 8 / 7, 2.0, False)),
        (tendon(OPPOSITE, 'class="tight"', TIGHT), ("b", "a", 8 / 7, 0.0, False)),
        (tendon({"b": 1, "a": -1}, more=FIXED_LENGTH), ("b", "a", 1.0, 0.5, False)),
        (tendon({"a": 2, "b": 1}, more=MOTOR), ("b", "a", 0.5, 0.0, True)),
        (tendon(OPPOSITE, NARROW, '<actuator><motor joint="b"/></actuator>'), ("a", "b", 7 / 8, 0.0, False)),
    ],
    ids=["range", "class", "equality", "motor", "outer leads"],
)
def test_a_tendon_couples_two_joints(model, expected):
    """By its range, its class's, a fixed length, or one motor; a joint with a motor leads."""
    (found,) = tendon_couplings(model)
    assert (*dc.astuple(found.coupling), found.assumed) == pytest.approx(expected)


@pytest.mark.parametrize(
    "model",
    [
        tendon(OPPOSITE, 'range="-0.01 0.01"'),
        tendon(OPPOSITE, NARROW, '<compiler autolimits="false"/>'),
        tendon({"a": 1, "b": 1, "c": 1}, NARROW),
        tendon({"a": 1, "b": 1}, more=MOTOR.replace("/><", '/><motor joint="b"/><')),
        tendon(OPPOSITE, more=FIXED_LENGTH.replace("/>", ' active="false"/>')),
    ],
    ids=["loose", "no limits", "three joints", "motors of both", "inactive"],
)
def test_other_tendons_couple_nothing(model):
    """Loose or inactive ones, and those of joints with motors or of more than two joints."""
    assert tendon_couplings(model) == []


def test_ignored_parts_are_named(tmp_path):
    """Closed loops, and tendons of other kinds that motors pull."""
    more = '<equality><connect body1="index_l3" body2="middle_l3" anchor="0 0 0"/></equality>'
    more += '<tendon><spatial name="rope"/></tendon><actuator><motor tendon="rope"/></actuator>'
    model = write_hand(tmp_path, HandSpec(3, "xml"), changes={"</mujoco>": f"{more}</mujoco>"})
    notes = " ".join(propose(model).notes)
    assert "tendon 'rope'" in notes
    assert "closed loop at 'index_l3' and 'middle_l3'" in notes
