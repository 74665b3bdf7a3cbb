"""From a model file to a hand description, its notes and checks, and to training and simulation."""

from functools import partial

import numpy as np
import pytest
import torch
import yaml
from grasp_setup import Constant, resting_glove, started
from hand_family import HandSpec, joint_name, write_hand
from light_training import LIGHT
from pydrake.geometry import Role
from pydrake.math import RollPitchYaw

from geort_drake import (
    Hand,
    evaluate,
    load_hand,
    load_scenario,
    make_trial_diagram,
    synthesize_play,
    train_map,
)
from geort_drake.cli import run_command
from geort_drake.cli.simulate import try_out
from geort_drake.errors import HandError, OutputError
from geort_drake.hands.collision import HandClearance, collision_shapes
from geort_drake.hands.description import write_description
from geort_drake.hands.importers.arrangement import finger_by_name
from geort_drake.hands.importers.checks import examine
from geort_drake.hands.importers.proposal import propose
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.retargeting.collision import CollisionGaps
from geort_drake.retargeting.kinematics import fingertips
from geort_drake.retargeting.numpy_kinematics import NumpyKinematics

# The family: every number of fingers, format and kind of oddity, each with some of the others.
FAMILY = [
    HandSpec(2, "urdf", mimic=False, names="plain", turn=(90, 0, 180)),
    HandSpec(3, "sdf", mimic=True, names="odd", turn=(35, 20, -50), collision=False),
    HandSpec(4, "xml", mimic=True, names="odd", turn=(0, -90, 0), side="left"),
    HandSpec(5, "urdf", mimic=True, names="plain", turn=(-70, 25, 160), side="left"),
]


@pytest.mark.parametrize("spec", FAMILY, ids=lambda spec: f"{spec.fingers}-{spec.kind}-{spec.names}")
def test_fingers_base_and_side_are_found(spec, tmp_path):
    """The proposal equals the specification; tips without geometry are guessed. The next command fits."""
    description = propose(write_hand(tmp_path, spec))[0]
    assert (description.side, description.finger_names) == (spec.side, spec.finger_names)
    for number, finger in enumerate(description.fingers):
        # Thumbs have three joints; of four, the last one follows where there is mimicry.
        count = 3 if number == 0 or spec.mimic else 4
        assert finger.joints == [joint_name(spec, number, joint) for joint in range(count)]
        assert finger.tip_radius == pytest.approx(0.008)
        length = 0.032 if number == 0 else 0.02
        wanted = length if spec.collision else 0.8 * (0.045 if number == 0 else 0.028)
        assert np.linalg.norm(finger.tip_point) == pytest.approx(wanted, abs=1e-4)
    R_PB = RollPitchYaw(np.deg2rad(description.base_pose.rpy_deg)).ToRotationMatrix().matrix()
    turned = np.arccos(np.clip(0.5 * (np.trace(spec.R_BP @ R_PB) - 1), -1, 1))
    assert np.rad2deg(turned) < 4.0
    followers = [coupling.joint for coupling in description.couplings]
    assert followers == [joint_name(spec, f, 3) for f in range(1, spec.fingers)] * spec.mimic
    write_description(description, tmp_path / "hand.yaml")
    suggested = try_out(tmp_path, str(tmp_path / "hand.yaml"))
    assert (" grasp " if spec.fingers > 2 else " explore ") in suggested


@pytest.mark.parametrize(
    "names",
    ["thumb index medium ring pinky", "rh_THJ5 rh_FFJ4 rh_MFJ4 rh_RFJ4 rh_LFJ4", "th_x if_x mf_x rf_x lf_x"],
)
def test_fingers_are_known_by_usual_names(names):
    """Words, and two letters in either case; other words that contain these do not count."""
    assert [finger_by_name([name]) for name in names.split()] == list(FINGER_NAMES)
    assert not finger_by_name(["shift_j0"])


def test_the_order_of_named_fingers_tells_the_side(tmp_path):
    """Also without a ring finger, and where the thumb lies on the little finger's side."""
    changes = {"0.015 0.04 0.03": "0.015 -0.06 0.03", "ring": "little"}
    description = propose(write_hand(tmp_path, HandSpec(4, mimic=False), changes=changes))[0]
    assert description.side == "right"
    assert description.finger_names == ["thumb", "index", "middle", "little"]


@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_kinematics_and_collision_shapes_are_drakes_also_on_followers(kind, tmp_path, rng):
    """Torch and NumPy agree with Drake on fingertips; NumPy's Jacobian is torch's.

    Shapes lie where Drake has them; and the clearance's gradient is that of its gaps.
    """
    coupled = Hand(propose(write_hand(tmp_path, HandSpec(4, kind)))[0])
    q = rng.uniform(coupled.lower, coupled.upper, (40, len(coupled.joint_names)))
    p_BF, kinematics = coupled.fingertips(q), coupled.kinematics()
    np.testing.assert_allclose(fingertips(kinematics, torch.tensor(q)), p_BF, atol=1e-12)
    found, J = NumpyKinematics(kinematics).fingertips_and_jacobians(q)
    np.testing.assert_allclose(found, p_BF, atol=1e-12)
    by_torch = torch.autograd.functional.jacobian(partial(fingertips, kinematics), torch.tensor(q[0]))
    np.testing.assert_allclose(J[0], by_torch, atol=1e-12)
    mirrored = fingertips(kinematics.mirrored(), torch.tensor(q))
    np.testing.assert_allclose(mirrored, p_BF * [1, -1, 1], atol=1e-12)

    gaps = CollisionGaps(kinematics, collision_shapes(coupled))
    _, p_BS = gaps.poses(torch.tensor(q[:3], dtype=torch.float32))
    plant, inspector = coupled.plant, coupled.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    names = [*coupled.joint_names, *coupled.couplings.names]
    ids = sorted(inspector.GetAllGeometryIds(Role.kProximity), key=lambda id: id.get_value())
    for row, angles in enumerate(coupled.couplings.with_followers(q[:3])):
        for name, angle in zip(names, angles, strict=True):
            plant.GetJointByName(name).set_angle(context, angle)
        for number, geometry in enumerate(ids):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            X_BS = plant.EvalBodyPoseInWorld(context, body) @ inspector.GetPoseInFrame(geometry)
            np.testing.assert_allclose(p_BS[row, number], X_BS.translation(), atol=1e-6)
    clearance = HandClearance(coupled, 0.05)
    near = clearance.near(q[0])
    step = 1e-6 * rng.normal(size=q[0].size)
    moved = clearance.near(q[0] + step)
    both = [pair for pair in near.pairs if pair in moved.pairs]
    here, there = ([found.pairs.index(pair) for pair in both] for found in (near, moved))
    change = moved.gap[there] - near.gap[here]
    assert len(both) > 5
    # Between two edges the gradient is only approximate, so the median is compared.
    assert np.median(np.abs(change - near.gradient[here] @ step)) < 0.05 * np.linalg.norm(step) * 0.05


@pytest.mark.slow
@pytest.mark.usefixtures("light_evaluation")
def test_from_a_model_file_to_an_evaluated_retargeter(tmp_path):
    """One command describes the hand, one trains for it; no code knows its joints."""
    model = write_hand(tmp_path, spec := FAMILY[2])
    file = tmp_path / "mine.yaml"
    run_command("hand add", [str(model), "--output", str(file), "--rrd", str(tmp_path / "mine.rrd")])
    assert b"tips/index" in (tmp_path / "mine.rrd").read_bytes()
    play = synthesize_play(seed=1, duration_s=60.0, rate_hz=30.0, side=spec.side)
    settings = LIGHT["geort"] | {"steps": 3}
    retarget = train_map(hand := Hand(file), play, show_progress=False, settings=settings)
    q = retarget(synthesize_play(seed=2, duration_s=1.0, rate_hz=30.0).p_HK.astype(float))
    assert ((hand.lower <= q) & (q <= hand.upper)).all()
    figures = evaluate(retarget, hand, play)
    for name in ("motion_preservation", "flatness", "gain_p95_p5", "self_collision"):
        assert np.isfinite(figures[name]), name


def test_a_description_is_written_as_it_is_read(tmp_path):
    """The file names the model beside it, begins with the notes, and is not replaced unasked."""
    model = write_hand(tmp_path, HandSpec(3))
    file = tmp_path / "hand.yaml"
    run_command("hand add", [str(model), "--name", "mine", "--output", str(file)])
    text = file.read_text(encoding="utf-8")
    first, second, *_ = text.splitlines()
    assert first == "# Made by geort-drake hand add from hand.urdf." and "no position controllers" in second
    assert yaml.safe_load(text)["model"] == "hand.urdf"
    assert load_hand(file) == propose(model, "mine")[0]
    with pytest.raises(OutputError, match=r"hand\.yaml exists"):
        run_command("hand add", [str(model), "--output", str(file)])
    run_command("hand add", [str(model), "--output", str(file), "--overwrite"])
    assert load_hand(file).name == "hand"


def _swapped(description):
    first, second = description.fingers[1:3]
    first.joints, second.joints = second.joints, first.joints
    first.tip_link, second.tip_link = second.tip_link, first.tip_link


# Changes to the text of a model and to its description, and what the checks find then.
FAULTS = {
    "degrees": ({r'("thumb_j1".*?)upper="1.5"': r'\1upper="0.01"'}, None, "moves only from 0 to 1 deg"),
    "turn": ({r'("thumb_j1".*?)upper="1.5"': r'\1upper="90"'}, None, "more than a full turn"),
    "unit": ({'"0 0 0.042"': '"0 0 42"'}, None, "index is 42 m long: is it a finger, and are model and"),
    "bare": ({"<(/?)collision>": r"<\1drawn>"}, None, "no collision geometry"),
    "massless": ({"<inertial>.*?</inertial>": ""}, None, "links without mass"),
    "palm": ({'"0.02 0.066 0.08"': '"0.02 0.066 0.16"'}, None, "touch in"),
    "side": ({}, lambda d: setattr(d, "side", "left"), "thumb lies on the little finger's side of a left"),
    "tip": ({}, lambda d: setattr(d.fingers[3], "tip_point", [0, 0, -0.2]), "thumb and ring touch at 16 mm"),
    "order": ({}, _swapped, "the fingers index, middle, ring do not lie in this order"),
    "none": ({r'(<link name="index_l1">)<inertial>.*?</inertial>': r"\1"}, None, ""),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named(fault, tmp_path):
    """In a model that is described, changed, written and read; else nothing is found."""
    changes, change, finding = FAULTS[fault]
    description = propose(write_hand(tmp_path, HandSpec(4, mimic=False), changes=changes))[0]
    if change:
        change(description)
    write_description(description, tmp_path / "hand.yaml")
    found = "\n".join(examine(Hand(tmp_path / "hand.yaml")))
    assert finding in found and bool(finding) == bool(found)


def test_permanent_contacts_are_ignored(tmp_path):
    """Links that always overlap are found, and their contact is ignored."""
    thick = {'<box size="0.02 0.066 0.08"/>': '<box size="0.06 0.066 0.125"/>'}
    description = propose(write_hand(tmp_path, HandSpec(4, mimic=False), changes=thick))[0]
    assert ["index_l1", "palm"] in description.ignored_collisions
    hand = Hand(description)
    assert not hand.collides(hand.default_position)
    description.ignored_collisions = []
    assert Hand(description).collides(hand.default_position)


def test_a_joint_that_moves_several_fingers_is_held_and_the_thumbs_name_suffices(tmp_path):
    """A joint with followers in two fingers cannot belong to one; a note names it. Others need no names."""
    changes = {'<mimic joint="middle_j2"': '<mimic joint="index_j2"', "index": "one", "middle": "two"}
    description, notes = propose(write_hand(tmp_path, HandSpec(4), changes=changes))
    assert description.finger_names == ["thumb", "index", "middle", "ring"]
    assert "one_j2" not in description.joint_names
    notes = "\n".join(notes)
    assert "each moves 2 fingers at once: 'one_j2'" in notes
    assert "the fingers other than the thumb are named by their places" in notes
    Hand(description).kinematics()


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("urdf", {'joint="index_j2"': 'joint="wrist"'}, "'wrist'"),
        ("urdf", {'multiplier="0.8"': 'multiplier="four"'}, "four"),
        ("xml", {"0.8 0 0 0": "0.8 0.3 0 0"}, "by a polynomial"),
        ("urdf", {"revolute": "prismatic"}, "0 chains of movable revolute joints"),
        (
            "urdf",
            {r'("index_j[0-9]".*?)lower="[^"]*" upper="[^"]*"': r'\1lower="0" upper="0"'},
            "a finger cannot move: 'index_j0' has no position limits, or no range between them, 'index_j1'",
        ),
        ("urdf", {"</robot>": ""}, "not XML"),
        ("urdf", {"(?s)<link.*</joint>": ""}, "no links"),
        ("urdf", {"</robot>": '<finger xmlns="xacro"/></robot>'}, "expand them first"),
        ("xml", {"<worldbody>": '<include file="gone.xml"/><worldbody>'}, "gone.xml"),
        ("xml", {"(</?)mujoco": r"\1mujocoinclude"}, "give the file that includes it"),
    ],
)
def test_models_that_cannot_be_used_are_refused(kind, change, message, tmp_path):
    model = write_hand(tmp_path, HandSpec(3, kind), changes=change)
    with pytest.raises(HandError, match=message) as error:
        propose(model)
    assert str(model) in str(error.value)


@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_on_the_arm_only_listed_joints_are_commanded(kind, tmp_path):
    """A replayed glove moves a described hand in the shipped scenario; followers follow without motors."""
    model = write_hand(tmp_path, HandSpec(4, kind))
    write_description(propose(model)[0], tmp_path / "mine.yaml")
    hand = Hand(tmp_path / "mine.yaml")
    retarget = Constant(hand, 0.5 * (hand.lower + hand.upper))
    scenario = load_scenario(hand=str(tmp_path / "mine.yaml"))
    parts = make_trial_diagram(scenario, retarget, resting_glove(0.4))
    simulator = started(parts)
    simulator.AdvanceTo(0.4)
    context = parts.plant.GetMyContextFromRoot(simulator.get_context())
    leader, follower = (
        parts.plant.GetJointByName(name).get_angle(context) for name in ("index_j2", "index_j3")
    )
    assert leader > 0.3
    assert follower == pytest.approx(0.8 * leader + 0.1, abs=2e-3)
    arm_joints = 7
    assert parts.plant.num_actuators() == arm_joints + len(hand.joint_names)
