"""Benchmarks of several tasks."""

import json

import yaml
from grasp_setup import TOO_SHORT, plan_once, reach_goal

from geort_drake.cli import main
from geort_drake.resources import models_dir
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner


def test_the_benchmark_runs_several_tasks_and_goes_on(tmp_path, light_benchmark, monkeypatch, capsys):
    """Each kind in its own folder; the summary has all, and a second run adds only what is missing."""
    mine = tmp_path / "mine.py"  # a user's method, whose faults are reported
    mine.write_text("def make(hand, n=[]):\n    return lambda p: n.append(p) or hand.lower[len(n) > 2 :]\n")
    monkeypatch.setattr(GraspPlanner, "plans", lambda _: [reach_goal()])
    plan_once(monkeypatch, "keys")
    command = ["benchmark", "--kinds", "servo", "--quiet", "--scenario-text", TOO_SHORT]
    command += ["--output", str(tmp_path), "--methods", "hold"]
    assert main([*command, "--trials", "1", "--tasks", "keys", "grasp", "--objects", "cylinder"]) == 0
    folder = tmp_path / "keys" / "servo"
    before = (folder / "trials.jsonl").read_text()
    assert main([*command, str(mine), "--trials", "2", "--tasks", "keys"]) == 0
    assert "faulty outputs of mine.py in keys (servo)" in " ".join(capsys.readouterr().err.split())
    after = (folder / "trials.jsonl").read_text()
    assert after.startswith(before) and len(after.splitlines()) == 4
    tasks = json.loads((tmp_path / "summary.json").read_text())["tasks"]
    assert {task: list(kinds) for task, kinds in tasks.items()} == {"grasp": ["servo"], "keys": ["servo"]}
    figures = tasks["keys"]["servo"]["methods"]["hold"]
    assert figures["trials"] == 2 and figures["score"]["mean"] == 0.0
    assert main(["benchmark", "--output", str(folder), "--rrd", "hold", "keys", "0", "--quiet"]) == 0
    assert (folder / "rrd" / "hold-keys-0.rrd").is_file()
    of_kind = json.loads((folder / "summary.json").read_text())["tasks"]
    assert of_kind["keys"]["servo"] == tasks["keys"]["servo"]


def test_a_task_that_the_hand_cannot_do_is_left_out_with_its_reason(tmp_path, capsys):
    """Nothing is simulated, and the run ends well."""
    description = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text())
    for joint in description["fingers"].pop()["joints"]:
        del description["default_positions"][joint]
    hand = tmp_path / "three.yaml"
    hand.write_text(yaml.safe_dump(description))
    command = ["benchmark", "--tasks", "keys", "--kinds", "servo", "--methods", "hold", "--trials", "1"]
    assert main([*command, "--hand", str(hand), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    reason = "the keys need a ring; hand 'allegro_right' has: thumb, index, middle"
    assert f"left out: {reason}" in " ".join(capsys.readouterr().err.split())
    figures = json.loads((tmp_path / "out" / "summary.json").read_text())["tasks"]["keys"]["servo"]
    assert figures["refused"] == {"keys": reason} and figures["methods"]["hold"]["trials"] == 0
