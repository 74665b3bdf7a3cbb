"""Whole grasps: through a known map, from a recording, after free play, and with a faulty glove."""

import dataclasses as dc
import json
from functools import cache

import numpy as np
import pyarrow.parquet as pq
import pytest
from grasp_setup import (
    Constant,
    allegro,
    centred_map,
    human_with,
    person_who_plays,
    planned_goal,
    resting_glove,
    retarget_and_play,
    scenario_with,
)
from pydrake.math import RigidTransform
from system_bench import SystemBench

from geort_drake import Recording, load_retargeter, run_trial, synthesize_play
from geort_drake.people.synthetic.hand import HumanHand
from geort_drake.people.synthetic.population import sample_person
from geort_drake.retargeting import METHODS
from geort_drake.retargeting.store import shipped_maps
from geort_drake.simulation.person.goal import GraspGoal
from geort_drake.simulation.task import TrialResult
from geort_drake.simulation.tasks.grasp import GraspPhase
from geort_drake.simulation.trial import _POPULATION, TrialBuilder, seen_fingertips, select_reachable
from geort_drake.simulation.worn_glove import WornGlove, WornGloveConfig

KINDS = ("command", "measured")
# A shorter hold than a benchmark's, to save time.
TEXT = "{task_settings: {hold_time: 0.5}, timeout: 15.0}"


@cache
def lifted(name: str = "cylinder") -> tuple[TrialResult, Recording]:
    """An object grasped by the simulated operator through the centred map."""
    human = human_with(name)
    return run_trial(scenario_with(name, TEXT), centred_map(), human)


def test_the_cylinder_is_lifted_through_a_known_map():
    """The result tells a plausible story: touched, grasped, lifted above 10 cm, held."""
    result, glove = lifted()
    assert result.success and result.outcome == "success"
    assert (result.object, result.seed, result.attempts) == ("cylinder", 0, 1)
    assert result.first_attempt is True
    order = [result.metrics["phase_times"][name] for name in ("REACH", "TOUCH", "LIFT", "HOLD", "DONE")]
    assert order == sorted(order)
    assert set(result.metrics["phase_times"]) <= {phase.name for phase in GraspPhase}
    assert 2.0 < result.completion_time < 12.0
    assert result.simulated_time == pytest.approx(result.metrics["phase_times"]["DONE"], abs=0.011)
    assert 0.10 < result.metrics["peak_height"] < 0.20
    assert result.metrics["tip_success"] and set(result.metrics["holding"]) <= {"link_15", "link_3", "link_7"}
    assert result.operator_phase in ("lift", "hold") and 0 <= result.self_contact <= 1
    # At least the weight of 0.1 kg held by friction of two sides, at most what the motors can do.
    assert 0.3 < result.peak_force < 20.0
    assert result.wall_time > 0
    # The glove's data cover the trial at the operator's rate and stay a human hand's.
    assert glove.rate_hz == pytest.approx(100, rel=1e-3)
    assert glove.t[-1] == pytest.approx(result.simulated_time, abs=0.02)
    assert glove.valid.all() and np.isfinite(glove.p_HK).all()
    assert glove.X_WH is not None and np.ptp(glove.X_WH[:, 6]) > 0.1
    assert glove.metadata["outcome"] == "success" and glove.metadata["side"] == "right"
    again = json.loads(json.dumps(result.to_json(), allow_nan=False))
    common = {field.name for field in dc.fields(TrialResult)} - {"metrics"}
    assert set(again) == common | set(result.metrics)


@pytest.mark.slow
def test_the_gloves_recording_played_again_grasps_again(tmp_path):
    """Saved, loaded and replayed, the operator's hand and wrist lift the object at the same time."""
    result, glove = lifted()
    glove.save(tmp_path / "session.npz")
    scenario = scenario_with("cylinder", TEXT)
    again, glove_again = run_trial(scenario, centred_map(), Recording.load(tmp_path / "session.npz"))
    assert again.success
    assert again.completion_time == pytest.approx(result.completion_time, abs=0.1)
    assert again.attempts is None and again.first_attempt is None and again.operator_phase is None
    count = min(len(glove.t), len(glove_again.t))
    np.testing.assert_allclose(glove_again.p_HK[:count], glove.p_HK[:count], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["block_tiny", "bottle"])
def test_objects_are_lifted_by_the_other_grips(name):
    result, _ = lifted(name)
    assert result.success and result.attempts == 1


def test_an_object_that_falls_off_its_support_ends_the_trial():
    """Beside the plinth the object falls to the table: thrown, long before the timeout."""
    scenario = scenario_with("cylinder", "{object: {position: [0.5, 0.35]}}")
    result, _ = run_trial(scenario, Constant(), resting_glove(2.0))
    assert result.outcome == "thrown: reach" and not result.success
    assert result.simulated_time < 1.0
    assert result.metrics["phase_times"]["THROWN"] == pytest.approx(result.simulated_time, abs=0.011)


def test_the_time_in_self_contact_is_the_trials():
    """A hand that crosses two fingers touches itself almost all the time; one at rest never does."""
    fist = Constant()
    # The two fingers' joints that swing them sideways, towards each other.
    for name, angle in (("joint_0", -0.45), ("joint_4", 0.45)):
        fist.q[fist.joint_names.index(name)] = angle
    scenario = scenario_with("cylinder", "{timeout: 1.0}")
    crossed, _ = run_trial(scenario, fist, resting_glove(2.0))
    assert 0.5 < crossed.self_contact < 1.0
    rest, _ = run_trial(scenario, Constant(), resting_glove(2.0))
    assert rest.self_contact == 0.0


def test_the_recording_shows_what_fingertips_are_asked_for_and_how_hard_joints_work(tmp_path):
    """Commanded fingertips by exact kinematics, torques within limits, and what was simulated."""
    from rerun_world import entities, read

    path = tmp_path / "trial.rrd"
    scenario = scenario_with("cylinder", "{timeout: 0.5, retargeting: {latency: 0.005}}")
    human = human_with()
    run_trial(scenario, centred_map(), human, path, {"method": "affine"})
    table = pq.read_table(path.with_suffix(".parquet"))
    signals = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    for kind in KINDS:
        posture = [signals[f"arm.{kind}.{joint}"][0] for joint in scenario.arm_posture]
        np.testing.assert_allclose(posture, list(scenario.arm_posture.values()), atol=1e-3)
    hand, fingers = allegro(), allegro().finger_names
    joints = [f"{finger.name}.{joint}" for finger in hand.description.fingers for joint in finger.joints]
    q = {kind: np.stack([signals[f"joints.{kind}.{joint}"] for joint in joints], 1) for kind in KINDS}
    apart = np.linalg.norm(hand.fingertips(q["command"]) - hand.fingertips(q["measured"]), axis=2)
    distance = np.stack([signals[f"fingertips.distance.{finger}"] for finger in fingers], 1)
    np.testing.assert_allclose(distance, 1e3 * apart, atol=0.01)
    shares = {name: value for name, value in signals.items() if ".torque_share." in name}
    assert len(shares) == len(hand.joint_names) + len(scenario.arm_posture)
    assert max(np.abs(share).max() for share in shares.values()) <= 1 + 1e-9
    times, seen = read(path, "/world/seen/fingertips", "Ellipsoids3D:centers")
    begun = np.array([len(points) > 0 for points in seen])
    np.testing.assert_array_equal(begun, np.array(times) >= scenario.operator.visual_delay - 1e-9)
    assert {"/world/fingertips/commanded", "/world/object/path", "/world/seen/object"} <= entities(path)
    (body,) = (e for e in entities(path) if e.startswith("/world/") and e.endswith("/cylinder"))
    places = read(path, body, "Transform3D:translation")[1]
    trail = read(path, "/world/object/path", "Points3D:positions")[1]
    np.testing.assert_allclose(np.ravel(trail), np.ravel(places), atol=1e-6)

    def said(name):
        return read(path, "/__properties/run", name)[1][0].item()

    facts = {name: said(name) for name in ("method", "hand", "object", "seed", "retargeting_delay_ms")}
    assert facts == {
        "method": "affine", "hand": "allegro_right", "object": "cylinder", "seed": 0,
        "retargeting_delay_ms": 5.0,
    }  # fmt: skip
    for package in ("geort_drake", "drake", "rerun", "numpy", "torch"):
        assert said(package)[0].isdigit()


def moved(goal: GraspGoal, shift: float) -> GraspGoal:
    """The grasp with its open fingertips shifted."""
    return dc.replace(goal, p_BF_open=goal.p_BF_open + [0.0, 0.0, shift])


def test_the_first_plan_that_free_play_reaches_is_kept():
    """Within its clearance; if none is, the nearest, with any error; unseen, the first."""
    _, seen = retarget_and_play("affine_ik")
    near = dc.replace(planned_goal("cylinder"), p_BF_open=seen.p_BF[0], clearance=0.01)
    far, farther = moved(near, 0.3), moved(near, 0.5)
    kept, attainable = select_reachable([far, near, moved(near, 0.0)], seen)
    assert attainable and kept.p_BF_open is near.p_BF_open and kept.clearance == 0.01
    for plans, frames in (([farther, far], seen), ([far, near], seen._replace(p_BF=seen.p_BF[:0]))):
        kept, attainable = select_reachable(plans, frames)
        assert not attainable and kept.p_BF_open is far.p_BF_open and kept.clearance == np.inf


def test_free_play_shows_where_the_robots_fingertips_go():
    """They move through a map, stay with one that holds, and are not seen with one that fails."""
    person = person_who_plays()
    seen = retarget_and_play("affine_ik")[1].p_BF
    assert seen.std(axis=0).min() > 1e-3 and len(seen) == 900
    still = seen_fingertips(METHODS["hold"].fit(allegro()), allegro(), person).p_BF
    assert still.std(axis=0).max() < 1e-9

    def failing(_):
        raise ArithmeticError

    failing.joint_names = allegro().joint_names
    assert len(seen_fingertips(failing, allegro(), person).p_BF) == 0


def test_nobody_approaches_farther_off_than_the_clearance():
    """Before 4 s are over: an open hand out of reach is waited for; with room for the error, it is not."""
    scenario = scenario_with("cylinder", "{timeout: 3.0, operator: {visual_depth_noise: 0.002}}")
    unreachable = moved(planned_goal("cylinder"), 0.04)
    phases = [
        run_trial(scenario, centred_map(), (person_who_plays(), dc.replace(unreachable, clearance=room)))[0]
        for room in (0.012, 0.1)
    ]
    assert phases[0].operator_phase == "reach"
    assert phases[1].operator_phase != "reach"


def test_a_misaligned_tracker_turns_the_directions_of_motion(rng):
    """By its angle; the keypoints stay."""
    p_HK, X_WH = rng.uniform(-0.1, 0.1, 63), RigidTransform([0.1, 0.2, 0.3])
    p_HK[:3] = 0.0  # the wrist is the origin
    bench = SystemBench(WornGlove(WornGloveConfig(misalignment=0.2), 10.0, rng))
    bench.fix(keypoints=p_HK, wrist_pose=X_WH, valid=1.0)
    np.testing.assert_allclose(bench.value("keypoints"), p_HK, atol=1e-12)
    pose = bench.value("wrist_pose")
    turn = pose.rotation() @ X_WH.rotation().inverse()
    assert turn.ToAngleAxis().angle() == pytest.approx(0.2)
    np.testing.assert_allclose(pose.translation(), turn @ X_WH.translation())
    assert bench.value("valid") == 1


def test_dropouts_have_their_rate_and_their_duration():
    """Two a second of 40 ms: the hand is lost for 8 % of the time."""
    system = WornGlove(WornGloveConfig(dropout_rate=2.0), 500.0, np.random.default_rng(0))
    lost = np.array([system._in_gap(t) for t in np.arange(0, 500, 0.001)])
    assert lost.mean() == pytest.approx(0.08, abs=0.01)
    starts = np.flatnonzero(np.diff(lost.astype(int)) == 1)
    assert np.median(np.flatnonzero(np.diff(lost.astype(int)) == -1)[: len(starts)] - starts) == 40


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_object_is_lifted_with_every_fault_at_once(seed):
    """A person corrects what they see."""
    faults = "{misalignment: 0.1, shift: 0.005, turn: 0.05, dropout_rate: 1.0}"
    text = f"{{random_seed: {seed}, glove: {faults}, task_settings: {{hold_time: 0.5}}}}"
    result, glove = run_trial(scenario_with("cylinder", text), centred_map(), human_with())
    assert result.success and not glove.valid.all()


def test_another_person_has_another_hand():
    """The same one for the same number."""
    play = synthesize_play(seed=0, duration_s=10)
    builder = TrialBuilder(allegro(), play)
    own, first, other, again = (builder.person(number) for number in (0, 1, 2, 1))
    np.testing.assert_array_equal(first.lengths, again.lengths)
    assert len({hand.lengths.sum() for hand in (own, first, other)}) == 3


def test_a_person_who_hardly_moved_in_the_recording_can_do_so_in_a_trial():
    timid = next(person for number in range(20) if (person := sample_person(1, number)).amplitude.max() < 0.6)
    recorded = HumanHand.fit(timid.record(20.0))
    person = TrialBuilder(allegro(), timid.record(20.0)).person(0)
    adult = HumanHand.measured_adult()
    assert np.mean(recorded.upper - recorded.lower) < 0.8 * np.mean(adult.upper - adult.lower)
    assert (person.lower <= adult.lower).all() and (person.upper >= adult.upper).all()
    np.testing.assert_array_equal(person.lengths, recorded.lengths)


@pytest.mark.parametrize("name", shipped_maps())
def test_the_people_of_trials_are_in_no_shipped_maps_training(name):
    """A map that had seen them would have an advantage over other methods."""
    info = load_retargeter(name).info
    stages = [info.get(stage, {}) for stage in ("first_config", "config")]
    seeds = {stage["seed"] for stage in stages if "seed" in stage}
    assert seeds and _POPULATION not in seeds
