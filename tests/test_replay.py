"""Replayed sessions: the object stands as it did, changes are drawn, and what is finished is kept."""

import json

import numpy as np
import pytest
from grasp_setup import allegro, resting_glove, scenario_with
from trial_records import error, trial

from geort_drake.benchmark import replay
from geort_drake.benchmark.records import read_records
from geort_drake.benchmark.replay import as_recorded, summarize_replay
from geort_drake.cli import run_command
from geort_drake.errors import BenchmarkError, ScenarioError
from geort_drake.retargeting.methods.trivial import Hold
from geort_drake.simulation.world import draw_placement


def test_a_simulated_session_meets_the_object_as_it_was():
    """Place, yaw and mass are those that its seed drew, and nothing is left to chance."""
    scenario = scenario_with("cylinder")
    drawn = draw_placement(scenario_with("cube"), -0.05, np.random.default_rng(7))
    again = as_recorded(scenario, resting_glove(0.1, object="cube", seed=7), None)
    assert again.object.name == "cube" and scenario.object.name == "cylinder"
    assert again.timeout == pytest.approx(0.09 + scenario.monitor.hold_time)
    for seed in (0, 1):
        placement = draw_placement(again, -0.05, np.random.default_rng(seed))
        np.testing.assert_allclose(
            placement.X_WO.GetAsMatrix4(), drawn.X_WO.GetAsMatrix4(), rtol=0, atol=1e-12
        )
        assert placement.mass_factor == drawn.mass_factor


def test_another_session_meets_it_where_the_scenario_says():
    """A session without a note of its object needs the name of the object."""
    scenario = scenario_with("cylinder")
    own = as_recorded(scenario, resting_glove(0.1), "sphere").object
    assert (own.name, own.position, own.yaw, own.mass_factor) == (
        "sphere", scenario.object.position, 0.0, 1.0,
    )  # fmt: skip
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


@pytest.fixture
def untrained(light_benchmark, monkeypatch, tmp_path):
    """A method that needs no training in place of a checkpoint."""
    monkeypatch.setattr(replay, "load_retargeter", lambda *_: Hold(allegro().kinematics()))
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / replay.WEIGHTS).write_bytes(b"a known map")


def test_sessions_are_replayed_under_every_change_and_gone_on_with(untrained, tmp_path):
    """One trial without a change, some with each; more trials add to them; another map is refused."""
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
    with pytest.raises(BenchmarkError, match="begun with another weights_sha256"):
        run_command("replay", [*common, "--trials", "2"])
