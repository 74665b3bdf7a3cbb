"""Each system by itself: fix the inputs, advance, evaluate."""

import dataclasses
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from system_bench import SystemBench, joint_plant

from geort_drake import (
    GloveReplay,
    Recording,
    RetargetingSystem,
    add_hand_model,
    load_hand,
    load_retargeter,
    synthesize_play,
)
from geort_drake.errors import FrameError, GeortError, HandError, RecordingError
from geort_drake.simulation.task import PERIOD, Outcome
from geort_drake.simulation.tasks.grasp import GraspPhase, GraspSettings, judgement
from geort_drake.systems.glove import GloveRecorder
from geort_drake.systems.joint_limits import JointLimits
from geort_drake.systems.port_values import pose_to_vector
from geort_drake.systems.retargeting_status import EASING, HELD_NOT_FINITE, HELD_OUT_OF_RANGE, SETTLING
from geort_drake.systems.retargeting_system import TRACKING
from geort_drake.systems.wrist_to_arm import Clutch

JOINTS = ("thumb_a", "thumb_b", "index_a")


def small_recording(frames: int = 12, rate: float = 100.0) -> Recording:
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(frames, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Recording(
        t=np.arange(frames) / rate,
        p_HK=synthesize_play(3, duration_s=1.0).p_HK[:frames],
        valid=np.arange(frames) % 5 != 4,
        X_WH=np.column_stack([quaternions, rng.normal(0, 0.2, (frames, 3))]),
        metadata={"side": "right"},
    )


def test_replay_holds_each_sample_until_the_next():
    """Between two samples the older one is given; times are compared up to rounding."""
    recording = small_recording()
    bench = SystemBench(GloveReplay(recording))
    for time, sample in ((0.0, 0), (0.0099, 0), (0.01, 1), (0.035, 3), (0.06 - 5e-10, 6), (9.0, 11)):
        bench.context.SetTime(time)
        np.testing.assert_array_equal(bench.value("keypoints").reshape(21, 3), recording.p_HK[sample])
        assert bench.value("valid")[0] == recording.valid[sample]
        np.testing.assert_allclose(bench.value("wrist_pose").translation(), recording.X_WH[sample, 4:])
    with pytest.raises(RecordingError, match="without frames"):
        GloveReplay(small_recording(frames=0))


def test_what_is_no_hand_in_the_wrist_frame_is_not_replayed():
    """As reading a file refuses it: other units, frames and sides."""
    recording = small_recording()
    for factor, message in ((1e3, "right if lengths were in mm"), ([-1, 1, 1], "of the other side")):
        with pytest.raises(GeortError, match=message):
            GloveReplay(dataclasses.replace(recording, p_HK=recording.p_HK * factor))
    with pytest.raises(GeortError, match="must be given in the wrist frame H"):
        GloveReplay(dataclasses.replace(recording, p_HK=recording.p_HK + np.float32(0.1)))


def test_recording_a_replay_gives_the_recording_back():
    """GloveRecorder keeps what GloveReplay plays: same keypoints, wrist poses and gaps."""
    recording = small_recording()
    builder = DiagramBuilder()
    replay = builder.AddSystem(GloveReplay(recording))
    recorder = builder.AddSystem(GloveRecorder(0.01))
    for name in ("keypoints", "wrist_pose", "valid"):
        builder.Connect(replay.GetOutputPort(name), recorder.GetInputPort(name))
    Simulator(builder.Build()).AdvanceTo(0.1105)
    again = recorder.recording({"side": "right"})
    assert len(again.t) == len(recording.t)
    np.testing.assert_allclose(again.t, recording.t, atol=1e-9)
    np.testing.assert_array_equal(again.p_HK, recording.p_HK)
    np.testing.assert_array_equal(again.valid, recording.valid)
    np.testing.assert_allclose(again.X_WH[:, 4:], recording.X_WH[:, 4:], atol=1e-12)


def retargeting_bench(retarget, latency=0.0, **timing) -> SystemBench:
    plant = joint_plant(("index_a", "thumb_a", "thumb_b"))
    limits = JointLimits(np.full(3, -2.0), np.full(3, 2.0), 1e9, 1e12)
    system = RetargetingSystem(
        retarget, *plant, joint_names=JOINTS, limits=limits, latency=latency, ease_at_start=False
    )
    bench = SystemBench(system, **timing)
    bench.fix(valid=1.0)
    return bench


def first_three(keypoints):
    return keypoints[4, :3]


def test_retargeting_orders_joints_as_the_plant_does():
    """Values are matched by name, velocities belong to positions, and there is no direct feedthrough."""
    bench = retargeting_bench(first_three)
    assert not bench.system.HasAnyDirectFeedthrough()
    keypoints = np.zeros((21, 3))
    keypoints[4] = [0.1, 0.2, 0.25]
    bench.fix(keypoints=keypoints)
    bench.advance()
    desired = bench.value("desired_state")
    np.testing.assert_allclose(desired[:3], [0.25, 0.1, 0.2])
    np.testing.assert_allclose(desired[3:], np.array([0.25, 0.1, 0.2]) / 0.01)
    bench.advance()
    np.testing.assert_allclose(bench.value("desired_state")[3:], 0, atol=1e-12)


def test_retargeting_holds_when_the_map_gives_no_number():
    """One NaN among the joint targets holds them all, and the next good answer is followed."""
    answers = iter([[0.1, 0.1, 0.1], [0.2, np.nan, 0.2], [0.3, 0.3, 0.3]])

    def own(keypoints):  # returns a list, and changes what it gets
        keypoints += 0.2
        return next(answers)

    bench = retargeting_bench(own)
    held = [(0.1, HELD_NOT_FINITE), *[(0.1, SETTLING)] * 3]
    for step, (wanted, state) in enumerate([(0.1, TRACKING), *held, (0.3, EASING)]):
        bench.fix(keypoints=np.full(63, 1e-3 * step))
        bench.advance()
        np.testing.assert_allclose(bench.value("desired_state")[:3], wanted)
        assert bench.value("status").state == state


def test_retargeting_holds_where_the_map_refuses_the_frame_of_the_keypoints():
    """One frame of the other hand holds the joints and stops no simulation; the next good one is followed."""

    def own(keypoints):
        if keypoints[0, 0] < 0.0:
            raise FrameError("as of a left hand")
        return keypoints[4, :3]

    bench = retargeting_bench(own)
    for x, wanted, state in (
        (1e-3, 1e-3, TRACKING),
        (-1e-3, 1e-3, HELD_OUT_OF_RANGE),
        *[(2e-3, 1e-3, SETTLING)] * 3,
        (2e-3, 2e-3, TRACKING),
    ):
        bench.fix(keypoints=np.full(63, x))
        bench.advance()
        np.testing.assert_allclose(bench.value("desired_state")[:3], wanted)
        assert bench.value("status").state == state


@pytest.mark.parametrize(("latency", "updates"), [(0.0, 0.01), (0.008, 0.01), (0.01, 0.01), (0.014, 0.014)])
def test_retargeting_outputs_after_its_latency_and_as_often_as_it_can(latency, updates):
    """What comes out at any time was made of the keypoints of the last update that is `latency` ago."""
    bench = retargeting_bench(first_three, latency, period=0.001)
    start = bench.value("desired_state")[:3]
    for millisecond in range(300):
        bench.fix(keypoints=np.full(63, 1e-3 * millisecond))
        bench.advance()
        answered = np.floor((millisecond - 1e3 * latency) / (1e3 * updates) + 1e-6)
        wanted = start if answered < 0 else np.full(3, answered * updates)
        np.testing.assert_allclose(bench.value("desired_state")[:3], wanted, atol=1e-9)


def test_retargeting_needs_the_plants_joints_and_limits_and_a_start_within_them():
    """Lists of joints in place of a plant are refused; a joint without an initial position starts at 0."""
    start, limits = dict.fromkeys(JOINTS, 0.5), JointLimits([0] * 3, [0.4] * 3)
    for joints, names, options, message in (
        (("index_a", "thumb_a", "ring_a"), JOINTS, {}, r"thumb_b.*ring_a"),
        (
            JOINTS,
            JOINTS,
            {"initial_positions": start},
            r"'thumb_a' must be within \[0, 0.4\] rad",
        ),
        (JOINTS, (*JOINTS, JOINTS[0]), {}, r"different joints"),
        (JOINTS, None, {}, r"give `joint_names`"),
        (JOINTS[:2], JOINTS[:2], {}, r"shape \(3,\), but 2 joints"),
    ):
        with pytest.raises(HandError, match=message):
            RetargetingSystem(first_three, *joint_plant(joints), joint_names=names, limits=limits, **options)
    with pytest.raises(TypeError):
        RetargetingSystem(first_three, JOINTS, JOINTS, {})
    system = RetargetingSystem(
        first_three, *joint_plant(JOINTS), joint_names=JOINTS, initial_positions={"index_a": 0.2}
    )
    np.testing.assert_array_equal(SystemBench(system).value("desired_state"), [0, 0, 0.2, 0, 0, 0])


def test_models_that_commands_cannot_respect_are_refused_by_joint():
    """So is a model that is not of the plant, for which Drake ends the process."""
    for low, high, speeds, message in (
        (-np.inf, np.inf, (-1, 1), r"position limits of 'index_a' must be finite and apart: -inf, inf"),
        (0.1, 0.1, (-1, 1), "position limits of 'index_a' must be finite and apart"),
        (-1, 1, (0, 0), "velocity limits of 'index_a' must be on both sides of 0"),
    ):
        plant, model = joint_plant(JOINTS)
        joint = plant.GetJointByName("index_a")
        joint.set_position_limits([low], [high])
        joint.set_velocity_limits(*([speed] for speed in speeds))
        with pytest.raises(HandError, match=message):
            RetargetingSystem(first_three, plant, model, joint_names=JOINTS)
    plant, model = joint_plant(JOINTS)
    plant.GetJointByName("index_a").set_velocity_limits([-1.0], [3.0])
    assert JointLimits.of_plant(plant, model, 5.0).speed[list(JOINTS).index("index_a")] == 1.0
    for other in (None, "hand", ModelInstanceIndex(99)):
        with pytest.raises(HandError, match="must be a model instance of the plant"):
            RetargetingSystem(first_three, plant, other, joint_names=JOINTS)


def test_a_map_of_another_hand_whose_joints_have_the_same_names_is_refused():
    """Allegro and LEAP both have joint_0 to joint_15; limits that are given are the caller's word."""
    retarget = load_retargeter("allegro_right")
    plant = MultibodyPlant(0.0)
    allegro, leap = (add_hand_model(plant, name) for name in ("allegro_right", "leap_right"))
    plant.Finalize()
    with pytest.raises(HandError, match=r"'joint_13' moves .* for allegro_right, and from -0\.470 to 2\.443"):
        RetargetingSystem(retarget, plant, leap)
    RetargetingSystem(retarget, plant, leap, limits=JointLimits.of_plant(plant, leap))
    RetargetingSystem(retarget, plant, allegro)


@pytest.mark.parametrize(
    ("joint", "lower", "upper", "fits"),
    [
        ("index_q1", 0.0, 1.0, True),
        ("index_q1", -2.0, 2.5, False),
        ("thumb_q1", 0.0, 1.0, False),
        ("thumb_q1", -2.0, 2.0, True),
    ],
)
def test_a_joint_that_others_follow_may_have_narrower_limits_in_the_map(joint, lower, upper, fits):
    """So that the followers keep to theirs; Ability's index_q1 is followed, and thumb_q1 is not."""
    joints = [name for finger in load_hand("ability_right").fingers for name in finger.joints]
    plant, model = joint_plant(tuple(joints))  # from −2 to 2 rad each
    limits = np.tile([-2.0, 2.0], (len(joints), 1))
    limits[joints.index(joint)] = lower, upper
    retarget = SimpleNamespace(
        joint_names=joints, lower=limits[:, 0], upper=limits[:, 1], robot_hands=("ability_right",)
    )
    with nullcontext() if fits else pytest.raises(HandError, match=f"'{joint}' moves from"):
        RetargetingSystem(retarget, plant, model)


@pytest.mark.parametrize("is_welded", [True, False])
def test_a_map_for_the_hand_of_the_other_side_is_refused(is_welded):
    """Both Allegro hands have joints of the same names and limits."""
    for name, other in (("allegro_right", "allegro_left"), ("allegro_left", "allegro_right")):
        plant = MultibodyPlant(0.0)
        model = add_hand_model(plant, name)
        if is_welded:
            base = plant.GetFrameByName(load_hand(name).base_frame, model)
            plant.WeldFrames(plant.world_frame(), base, RigidTransform(RollPitchYaw(1, 2, 3), [1, 2, 3]))
        plant.Finalize()
        RetargetingSystem(load_retargeter(name), plant, model)
        with pytest.raises(HandError, match=f"is for {other}, but the plant has a hand of the other side"):
            RetargetingSystem(load_retargeter(other), plant, model)


def test_limits_and_start_come_from_the_plant_and_an_unconnected_valid_port_counts_as_tracked():
    """Without `valid`, good keypoints are followed."""
    system = RetargetingSystem(first_three, *joint_plant(JOINTS), joint_names=JOINTS)
    bench = SystemBench(system)
    for _ in range(200):
        bench.fix(keypoints=np.full(63, 0.25) + 1e-6 * bench.ticks)
        bench.advance()
    assert bench.value("status").state == TRACKING
    np.testing.assert_allclose(bench.value("desired_state")[:3], 0.25, atol=1e-3)
    with pytest.raises(HandError, match=r"lower \(3,\), upper \(2,\)"):
        JointLimits(np.zeros(3), np.ones(2))


def test_clutch_moves_the_hand_by_what_the_wrist_moved_and_survives_a_gap():
    """Translation and rotation are relative to the engagement; after a gap, to where the arm was held."""
    X_WB0 = RigidTransform(RotationMatrix.MakeXRotation(0.5), [0.4, 0.1, 0.3])
    bench = SystemBench(Clutch(X_WB0, 0.01))

    def at(X_WH, valid, commanded=X_WB0):
        bench.fix(wrist_pose=X_WH, valid=valid, commanded_pose=commanded)
        bench.advance()
        return bench.value("hand_pose")

    first = RigidTransform(RotationMatrix.MakeZRotation(1.0), [5, 5, 5])
    np.testing.assert_allclose(at(first, 1.0).GetAsMatrix4(), X_WB0.GetAsMatrix4(), atol=1e-12)
    turn = RotationMatrix.MakeYRotation(0.3)
    moved = RigidTransform(turn @ first.rotation(), first.translation() + [0.1, 0, -0.05])
    target = at(moved, 1.0)
    np.testing.assert_allclose(target.translation(), X_WB0.translation() + [0.1, 0, -0.05], atol=1e-12)
    np.testing.assert_allclose(target.rotation().matrix(), (turn @ X_WB0.rotation()).matrix(), atol=1e-12)
    far = RigidTransform([9, 9, 9])
    # The arm has not come all the way to the target, and is held where it is.
    held = RigidTransform(target.rotation(), target.translation() - [0.02, 0, 0])
    for valid in (0.0, 1.0):
        np.testing.assert_allclose(at(far, valid, held).GetAsMatrix4(), held.GetAsMatrix4(), atol=1e-12)


def judged(heights, contacts, x=None, palm=None):
    """Feeds each height, contact vector, place x and palm's force ten times; the outcome."""
    links = ["a", "b", "palm"]
    judge = judgement(GraspSettings(), links, [], lambda X_WO: X_WO.translation()[2] - 0.02, 0.1)
    outcome = Outcome()
    for step, (height, contact) in enumerate(zip(heights, contacts, strict=True)):
        seen = {
            "object_pose": pose_to_vector(RigidTransform([0.5 if x is None else x[step], 0, 0.12 + height])),
            "contact": np.array(contact, float),
            "link_contact": np.array([*contact, 0.0 if palm is None else palm[step]]),
        }
        for repeat in range(10):
            outcome = judge(outcome.replace(t=PERIOD * (10 * step + repeat)), seen)
            if outcome.over:
                return outcome
    return outcome


def test_the_judge_needs_the_height_for_the_whole_hold_and_names_the_links_that_hold():
    """Ten centimetres for two seconds is a success, timed from the beginning of the hold.

    Here the palm touches during the lift, and for 0.2 s of the hold.
    """
    heights, contacts, palm = [0, 0, 0.05] + [0.12] * 25, [[0, 0]] + [[1, 1]] * 27, np.zeros(28)
    palm[1:3] = palm[10:12] = 1.0
    outcome = judged(heights, contacts, palm=palm)
    assert outcome.success
    assert outcome.completion_time == pytest.approx(0.3)
    assert list(outcome.metrics["phase_times"]) == ["REACH", "GRASP", "LIFT", "HOLD", "DONE"]
    holding = outcome.metrics["holding"]
    assert holding["a"] == pytest.approx(2.0, abs=0.02) and holding["palm"] == pytest.approx(0.2)
    palm[10:12] = 0.0
    assert list(judged(heights, contacts, palm=palm).metrics["holding"]) == ["a", "b"]
    short = judged(heights[:15], contacts[:15])
    assert not short.success and short.phase == GraspPhase.HOLD


def test_the_judge_does_not_count_a_dropped_or_thrown_object():
    """A drop restarts the hold; an object below its support ends the trial."""
    heights = [0, 0.05, 0.12, 0.0, 0.12] + [0.11] * 10
    contacts = [[1, 1], [9, 1], [1, 1], [0, 0], [1, 1]] + [[1, 1]] * 10
    outcome = judged(heights, contacts)
    assert np.isclose(outcome.memory["held_since"], 0.4)
    assert outcome.metrics["peak_height"] == pytest.approx(0.12)
    fallen = judged([0, 0, -0.1, 0.2], [[1, 0], [0, 0], [0, 0], [1, 1]])
    assert fallen.phase == GraspPhase.THROWN and fallen.over and not fallen.success
    # The last phase with a touch is not the furthest one nor the throw: here what threw it was one finger.
    outcome = judged([0.0, 0.0, 0.0, 0.0, -0.1], [[1, 1], [0, 0], [1, 0], [0, 0], [0, 0]])
    assert outcome.phase == GraspPhase.THROWN and outcome.text == "thrown: touch"


def test_the_judge_ends_when_the_object_strays_out_of_the_hand():
    """Far from its start and touched by nothing it is thrown, at any height; in the hand it is not."""
    far = [0.5, 0.9, 0.9]
    thrown = judged([0.0, 0.0, 0.0], [[1, 0], [0, 0], [1, 1]], x=far)
    assert thrown.phase == GraspPhase.THROWN and thrown.over
    carried = judged([0.0, 0.05, 0.05], [[1, 1], [1, 1], [1, 1]], x=far)
    assert carried.phase == GraspPhase.LIFT
    flying = judged([0.0, 0.15, 0.15], [[1, 1], [0, 0], [1, 0]])
    assert list(flying.metrics["phase_times"]) == ["GRASP", "REACH", "TOUCH"]
