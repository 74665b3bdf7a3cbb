"""Recorded sessions: replayed, and those of real people beside the simulated person."""

import itertools
import json
import shutil

import numpy as np
import pytest
from grasp_setup import allegro, reach_goal, resting_glove, scenario_with
from trial_records import error, trial

from geort_drake import Recording
from geort_drake.benchmark import replay
from geort_drake.benchmark import trials as trial_runner
from geort_drake.benchmark.motion import motion_of
from geort_drake.benchmark.people import read_people, summarize_people
from geort_drake.benchmark.records import read_records
from geort_drake.benchmark.replay import as_recorded, summarize_replay
from geort_drake.cli import run_command
from geort_drake.errors import BenchmarkError, ScenarioError
from geort_drake.retargeting.methods.trivial import Hold
from geort_drake.simulation.world import draw_placement
from geort_drake.simulation.wrist_motion import minimum_jerk


def test_a_session_meets_the_object_as_it_was_or_where_the_scenario_says():
    """Of a simulated one, place, yaw and mass are those that its seed drew; nothing is left to chance.

    A session without a note of its object needs the name of the object.
    """
    scenario = scenario_with("cylinder")
    drawn = draw_placement(scenario_with("cube"), -0.05, np.random.default_rng(7))
    again = as_recorded(scenario, resting_glove(0.1, object="cube", seed=7), None)
    assert again.object.name == "cube" and scenario.object.name == "cylinder"
    assert again.timeout == pytest.approx(0.09 + scenario.monitor.hold_time)
    for seed in (0, 1):
        placement = draw_placement(again, -0.05, np.random.default_rng(seed))
        X_WO, wanted = (each.X_WO.GetAsMatrix4() for each in (placement, drawn))
        np.testing.assert_allclose(X_WO, wanted, rtol=0, atol=1e-12)
        assert placement.mass_factor == drawn.mass_factor
    own = as_recorded(scenario, resting_glove(0.1), "sphere").object
    assert (own.name, own.position) == ("sphere", scenario.object.position)
    assert (own.yaw, own.mass_factor) == (0.0, 1.0)
    with pytest.raises(ScenarioError, match="give it with --object"):
        as_recorded(scenario, resting_glove(0.1), None)


def test_the_summary_pools_sessions_and_begins_without_a_change():
    """A size's share is over all sessions; errors are counted apart."""

    def line(name, success, condition="", seed=0):
        return trial(name, seed=seed, time=5.0 if success else None, condition=condition)

    records = [
        line("a", True),
        line("b", False),
        *[line(name, k < 3, "position=10", k) for name in "ab" for k in range(4)],
        error("a", condition="position=10"),
    ]
    summary = summarize_replay(records)
    (panel,) = summary["perturbations"].values()
    shares = [(c["value"], c["methods"]["replay"]["rate"]) for c in panel["conditions"]]
    assert shares == [(0.0, 0.5), (10.0, 0.75)]
    assert summary["trials"] == 10 and summary["errors"] == 1
    assert summary["sessions"]["b"]["unchanged"] == "timeout: lift"
    assert summary["sessions"]["b"]["changed"]["successes"] == 3


def test_sessions_are_replayed_under_every_change_and_gone_on_with(light_benchmark, tmp_path, monkeypatch):
    """One trial without a change, some with each; more trials add to them; another map is refused."""
    # A method that needs no training in place of a checkpoint.
    monkeypatch.setattr(replay, "load_retargeter", lambda *_: Hold(allegro().kinematics()))
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / replay.WEIGHTS).write_bytes(b"a known map")
    resting_glove(0.1, object="cube", seed=3).save(tmp_path / "cube-3.glove.npz")
    folder = tmp_path / "out"
    common = [
        str(tmp_path / "cube-3.glove.npz"), "--retargeter", str(tmp_path / "map"), "--output", str(folder),
        "--jobs", "1", "--scenario-text", "{monitor: {hold_time: 0.01}}", "--perturb", "position=0,20",
        "mass=0.5",
    ]  # fmt: skip
    assert run_command("replay", [*common, "--trials", "1"]) == 0
    before = read_records(folder / "trials.jsonl")
    assert [record.get("condition", "") for record in before] == ["", "position=20", "mass=0.5"]
    assert {record["method"] for record in before} == {"cube-3"}
    assert run_command("replay", [*common, "--trials", "2"]) == 0
    records = read_records(folder / "trials.jsonl")
    assert records[:3] == before and len(records) == 5
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary["perturbations"]) == {"position", "mass"}
    assert "| 20 | 2 | 0 % [0, 66] |" in (folder / "report.md").read_text()
    assert (folder / "success.svg").read_text().startswith("<svg")
    (tmp_path / "map" / replay.WEIGHTS).write_bytes(b"another map")
    with pytest.raises(BenchmarkError, match="begun with another weights; use the same, or"):
        run_command("replay", [*common, "--trials", "2"])


def session(targets=(0.0, 0.3), seconds=1.0, rate=60.0, success=True, map_name="universal map", **changes):
    """A wrist that moves from target to target along x, m, and rests after each; a still hand."""
    t = np.arange(0.0, 2 * seconds * (len(targets) - 1), 1.0 / rate)
    x = np.full(len(t), targets[0], float)
    for number, (begin, end) in enumerate(itertools.pairwise(targets)):
        share = np.clip((t - 2 * number * seconds) / seconds, 0.0, 1.0)
        x += (end - begin) * np.array([minimum_jerk(one) for one in share])
    X_WH = np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(t), 1))
    X_WH[:, 4] = x
    outcome = {"phase": "done", "success": success, "seconds": 9.0 if success else None, "over": success}
    facts = {"consent": True, "object": "cylinder", "map": map_name, "began": 4.0, "outcome": outcome}
    return Recording(t, np.ones((len(t), 21, 3)), np.ones(len(t), bool), X_WH, facts | changes)


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_speeds_and_movements_are_those_of_the_wrist(rate):
    """At any rate, with noise of a tracker; a correction is one more movement."""
    rng = np.random.default_rng(0)
    for targets in ((0.0, 0.3), (0.0, 0.3, 0.25), (0.0, 0.3, 0.25, 0.3)):
        recording = session(targets, rate=rate)
        recording.X_WH[:, 4:] += rng.normal(0.0, 3e-4, (len(recording), 3))
        motion = motion_of(recording)
        assert motion["movements"] == len(targets) - 1
        assert motion["fingertip_speed"] == 0.0
    # A minimum-jerk movement of 0.3 m in 1 s peaks at 0.56 m/s; its mean without the slow ends is lower.
    assert 0.3 < motion_of(session(rate=rate))["wrist_speed"] < 0.45
    recording = session()  # of a hand that was hardly followed
    recording.valid[30:] = False
    assert set(motion_of(recording).values()) == {None}


def save(folder, person, number, **changes):
    (folder / person).mkdir(parents=True, exist_ok=True)
    session(**changes).save(folder / person / f"{number}.npz")


def test_people_are_told_apart_by_folder_and_maps_by_name(tmp_path):
    """Times run from the engagement; failures, and who was too slow, count as the timeout.

    A folder without sessions or facts is refused.
    """
    with pytest.raises(BenchmarkError, match="no session"):
        read_people(tmp_path)
    for person in ("p1", "p2"):
        save(tmp_path, person, 1)
        save(tmp_path, person, 2, success=person == "p1")
        save(tmp_path, person, 3, map_name="mine")
    guided = session()
    del guided.metadata["consent"]
    guided.save(tmp_path / "p1" / "guided.npz")
    (tmp_path / "p1" / ".unfinished.npz").touch()
    people = read_people(tmp_path)
    assert len(people) == 6
    trials = [
        {"method": "geort", "object": thing, "seed": seed, "success": thing == "cylinder",
         "completion_time": 7.0, "motion": motion_of(session())}
        for thing in ("cylinder", "cube") for seed in (0, 1)
    ]  # fmt: skip
    raised = {"method": "geort", "object": "cylinder", "error": "x"}
    summary = summarize_people(people, [*trials, raised], 30.0)
    everyone = summary["people"]["universal map"]
    assert everyone["persons"] == 2 and everyone["success"]["successes"] == 3
    assert everyone["completion_time"]["mean"] == pytest.approx((3 * 5.0 + 30.0) / 4)
    assert summary["people"]["mine"]["success"]["trials"] == 2
    simulated = summary["simulated"]["geort"]
    assert simulated["success"]["rate"] == 1.0, "only with the object that people grasped"
    assert simulated["wrist_speed"]["mean"] == pytest.approx(everyone["wrist_speed"]["mean"])
    slow = summarize_people(people, trials, 4.0)["people"]["universal map"]
    assert slow["success"]["successes"] == 0 and slow["completion_time"]["mean"] == 4.0
    save(tmp_path, "p1", 1, outcome={"success": "perhaps"})
    with pytest.raises(BenchmarkError, match=r"outcome\.success"):
        read_people(tmp_path)


def test_the_report_sets_people_beside_the_simulated_person(tmp_path, light_benchmark, monkeypatch, capsys):
    monkeypatch.setattr(trial_runner, "plan", lambda *_: [reach_goal()])
    save(tmp_path / "study", "p1", 1)
    options = ["--methods", "hold", "--objects", "cylinder", "--trials", "1", "--zero-latency", "--jobs", "1"]
    options += ["--output", str(tmp_path / "run"), "--scenario-text", "{timeout: 2.0}"]
    assert run_command("benchmark", [*options, "--people", str(tmp_path / "study")]) == 0
    assert "┃ fingertips ┃" in capsys.readouterr().err, "whole words in 80 columns"
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())["people"]
    assert summary["people"]["universal map"]["success"]["rate"] == 0.0  # it took longer than the timeout
    assert summary["simulated"]["hold"]["wrist_speed"]["mean"] > 0.0
    for name in ("report.md", "report.html"):
        assert "real (1), universal map" in (tmp_path / "run" / name).read_text()
    shutil.rmtree(tmp_path / "study")
    assert run_command("benchmark", [*options, "--report"]) == 0
    assert "), universal" not in (tmp_path / "run" / "report.md").read_text()
