"""Sessions of real people beside the trials of the simulated person."""

import itertools
import json
import shutil

import numpy as np
import pytest
from grasp_setup import planned_goal

from geort_drake.benchmark import trials as trial_runner
from geort_drake.benchmark.motion import motion_of
from geort_drake.benchmark.people import read_people, summarize_people
from geort_drake.cli import run_command
from geort_drake.errors import BenchmarkError
from geort_drake.people.recording import Recording
from geort_drake.simulation.wrist_motion import minimum_jerk


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


def test_a_hand_that_was_hardly_followed_has_no_figures():
    recording = session()
    recording.valid[30:] = False
    assert set(motion_of(recording).values()) == {None}


def save(folder, person, number, **changes):
    (folder / person).mkdir(parents=True, exist_ok=True)
    session(**changes).save(folder / person / f"{number}.npz")


def test_people_are_told_apart_by_folder_and_maps_by_name(tmp_path):
    """Times run from the engagement; failures, and who was too slow, count as the timeout."""
    for person in ("p1", "p2"):
        save(tmp_path, person, 1)
        save(tmp_path, person, 2, success=person == "p1")
        save(tmp_path, person, 3, map_name="mine")
    guided = session()
    del guided.metadata["consent"]
    guided.save(tmp_path / "p1" / "guided.npz")
    people = read_people(tmp_path)
    assert len(people) == 6
    trials = [
        {"method": "geort", "object": thing, "seed": seed, "success": thing == "cylinder",
         "completion_time": 7.0, "motion": motion_of(session())}
        for thing in ("cylinder", "cube") for seed in (0, 1)
    ]  # fmt: skip
    summary = summarize_people(
        people, [*trials, {"method": "geort", "object": "cylinder", "error": "x"}], 30.0
    )
    everyone = summary["people"]["universal map"]
    assert everyone["persons"] == 2 and everyone["success"]["successes"] == 3
    assert everyone["completion_time"]["mean"] == pytest.approx((3 * 5.0 + 30.0) / 4)
    assert summary["people"]["mine"]["success"]["trials"] == 2
    simulated = summary["simulated"]["geort"]
    assert simulated["success"]["rate"] == 1.0, "only with the object that people grasped"
    assert simulated["wrist_speed"]["mean"] == pytest.approx(everyone["wrist_speed"]["mean"])
    slow = summarize_people(people, trials, 4.0)["people"]["universal map"]
    assert slow["success"]["successes"] == 0 and slow["completion_time"]["mean"] == 4.0


def test_a_folder_without_sessions_or_facts_is_refused(tmp_path):
    with pytest.raises(BenchmarkError, match="no session"):
        read_people(tmp_path)
    save(tmp_path, "p1", 1, outcome={"success": "perhaps"})
    with pytest.raises(BenchmarkError, match=r"outcome\.success"):
        read_people(tmp_path)


def test_the_report_sets_people_beside_the_simulated_person(tmp_path, light_benchmark, monkeypatch):
    monkeypatch.setattr(trial_runner, "plan", lambda *_: [planned_goal("cylinder")])
    save(tmp_path / "study", "p1", 1)
    options = ["--methods", "hold", "--objects", "cylinder", "--trials", "1", "--zero-latency", "--jobs", "1"]
    options += ["--output", str(tmp_path / "run"), "--scenario-text", "{timeout: 2.0}"]
    assert run_command("benchmark", [*options, "--people", str(tmp_path / "study")]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())["people"]
    assert summary["people"]["universal map"]["success"]["rate"] == 0.0  # it took longer than the timeout
    assert summary["simulated"]["hold"]["wrist_speed"]["mean"] > 0.0
    for name in ("report.md", "report.html"):
        assert "1 people, universal map" in (tmp_path / "run" / name).read_text()
    shutil.rmtree(tmp_path / "study")
    assert run_command("benchmark", [*options, "--report"]) == 0
    assert "people, universal" not in (tmp_path / "run" / "report.md").read_text()
