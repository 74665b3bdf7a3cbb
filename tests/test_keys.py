"""The task of keys: its places, its judgement, its people, and how the benchmark runs it."""

import dataclasses as dc
import hashlib
import json

import numpy as np
import pytest
import yaml
from grasp_setup import TOO_SHORT, allegro, planned_goal
from task_bench import judged, plans

from geort_drake.cli import main
from geort_drake.errors import ScenarioError, UnknownNameError
from geort_drake.people.keypoints import mirrored
from geort_drake.resources import models_dir
from geort_drake.simulation.operators.config import OperatorConfig
from geort_drake.simulation.operators.intention import IntentionConfig, LearnedMotion
from geort_drake.simulation.scenario_files import load_scenario
from geort_drake.simulation.tasks import find_task, task_names
from geort_drake.simulation.tasks.grasp.planner import GraspPlanner
from geort_drake.simulation.tasks.keys.goal import PITCH
from geort_drake.simulation.tasks.keys.monitor import KeysMonitor, KeysOutcome, KeysSettings
from geort_drake.simulation.tasks.keys.planner import HOVER, TRAVEL, KeysPlanner

# Of the parameters with which results were made; a change needs new results, and then this line.
FROZEN = "167fc503d8db25bd4a1b258ef7c5ec6fdc418fb9a32cae4ec2a3d4e3401c43e8"

SHORT = "{task_settings: {presses: 3, enough: 3, ready_time: 4.0, cue_time: 2.0}}"


def outcome_of(travel: list[list[float]], **settings) -> KeysOutcome:
    """The judgement of keys' travel, (T, 3) m at 10 Hz from the first cue on, with cues of 1 s."""
    rules = KeysSettings(presses=2, ready_time=0.1, cue_time=1.0, rest_time=0.5, enough=2, **settings)
    t = 0.1 + 0.1 * np.arange(len(travel))
    outcome = judged(
        KeysMonitor(3, 4, [0, 2], rules), 10.0, joints=(t, np.hstack([travel, np.zeros_like(travel)]))
    )
    assert outcome.t < 3.0  # it terminates after the last cue
    return outcome


def pressed(key: int, depth: float, others: float = 0.0) -> list[list[float]]:
    """A press that is over after half of the 1.5 s that a cue and a rest take at most."""
    travel = np.full((15, 3), others)
    travel[:, key] = 0.0
    travel[3:6, key] = depth
    travel[10:] = 0.0
    return travel.tolist()


@pytest.mark.parametrize(
    ("first", "second", "score", "success"),
    [
        (pressed(0, 0.004), pressed(2, 0.004), 1.0, True),
        (pressed(0, 0.004), pressed(2, 0.002), 0.5, False),  # not deep enough
        (pressed(0, 0.004), pressed(2, 0.004, 0.002), 0.5, False),  # with others
        (pressed(1, 0.004), pressed(0, 0.004), 0.0, False),  # the wrong keys
    ],
)
def test_a_press_counts_if_the_cued_key_goes_down_and_no_other(first, second, score, success):
    outcome = outcome_of(first + second)
    assert (outcome.score, outcome.success) == (score, success)


def test_the_time_of_a_press_runs_from_its_cue():
    """Which ends when the key is up again."""
    outcome = outcome_of(pressed(0, 0.004) + pressed(2, 0.004))
    first = outcome.presses[0]
    assert outcome.completion_time == pytest.approx(2.2, abs=0.03)
    assert first.time == pytest.approx(0.275, abs=0.02) and first.depth == pytest.approx(0.004)


def test_every_planned_key_is_reached_above_and_pressed():
    """By its own finger, while the other fingertips stay above theirs."""
    hand = allegro()
    for plan in (plans("keys")[0], plans("keys")[-1]):
        goal = plan.goal
        np.testing.assert_allclose(np.diff(goal.p_BK[:, 1]), -PITCH)
        np.testing.assert_allclose(
            hand.fingertips(plan.q_open)[goal.touches], goal.p_BF_open[goal.touches], atol=1e-3
        )
        for key, q in enumerate(plan.q_pressed):
            moved = hand.fingertips(q) - goal.p_BF_open
            expected = np.where((goal.key_of == key)[:, None], [HOVER + TRAVEL, 0, 0], 0.0)
            np.testing.assert_allclose(moved[goal.touches], expected[goal.touches], atol=2e-3)


def test_the_mirror_has_the_same_places():
    goal = plans("keys")[0].goal
    seen = goal.mirrored()
    for name in ("p_BK", "p_BF_open", "p_BF_pressed"):
        np.testing.assert_array_equal(getattr(seen, name), mirrored(getattr(goal, name)))


def test_a_person_learns_how_the_robots_fingertip_follows():
    """A gain and a rotation, from half a minute of noisy comparisons; and so which own motion is needed."""
    rng, config = np.random.default_rng(0), IntentionConfig()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    learned = LearnedMotion.unlearned(2, config)
    for _ in range(120):
        own = rng.normal(0, 0.01, 3)
        seen = 1.5 * turn @ own + rng.normal(0, 0.003, 3)
        learned = learned.compared(1, own, seen, 0.003, 0.25, config.jacobian_drift)
    np.testing.assert_allclose(learned.J[1], 1.5 * turn, atol=0.15)
    np.testing.assert_array_equal(learned.J[0], np.eye(3))
    np.testing.assert_allclose(
        1.5 * turn @ learned.own_motion(1, np.array([0.01, 0, 0])), [0.01, 0, 0], atol=1e-3
    )


def test_the_persons_parameters_are_those_of_the_published_results():
    """Results made with other ones cannot be compared."""
    defaults = [dc.asdict(OperatorConfig()), dc.asdict(IntentionConfig())]
    assert hashlib.sha256(json.dumps(defaults, sort_keys=True).encode()).hexdigest() == FROZEN


def test_tasks_are_folders_and_say_what_is_wrong():
    assert {"grasp", "keys"} <= set(task_names())
    with pytest.raises(UnknownNameError, match="grasp, keys"):
        find_task("juggle")
    for text, error, message in (
        ("{task: grasp, kind: adaptive}", UnknownNameError, "kind of person for task grasp"),
        ("{task_settings: {presses: -1}}", ScenarioError, "task_settings.presses"),
        ("{task_settings: {fingers: 3}}", ScenarioError, "task_settings has no 'fingers'"),
        (
            "{task: grasp, kind: servo, task_settings: {presses: 3}}",
            ScenarioError,
            "must be empty for task grasp",
        ),
    ):
        with pytest.raises(error, match=message):
            load_scenario(*find_task("keys").scenario, text)


def test_the_benchmark_runs_several_tasks_and_goes_on(tmp_path, light_benchmark, monkeypatch):
    """Each kind in its own folder; the summary has all, and a second run adds only what is missing."""
    goal = planned_goal("cylinder")  # no trial lasts long enough to follow it
    monkeypatch.setattr(GraspPlanner, "plans", lambda _: [goal])
    found = plans("keys")
    monkeypatch.setattr(KeysPlanner, "plans", lambda _: found)
    command = ["benchmark", "--kinds", "servo", "--methods", "hold", "--quiet"]
    command += ["--scenario-text", TOO_SHORT, "--output", str(tmp_path)]
    assert main([*command, "--trials", "1", "--tasks", "keys", "grasp", "--objects", "cylinder"]) == 0
    folder = tmp_path / "keys" / "servo"
    before = (folder / "trials.jsonl").read_text()
    assert main([*command, "--trials", "2", "--tasks", "keys"]) == 0
    after = (folder / "trials.jsonl").read_text()
    assert after.startswith(before) and len(after.splitlines()) == 2
    tasks = json.loads((tmp_path / "summary.json").read_text())["tasks"]
    assert {task: list(kinds) for task, kinds in tasks.items()} == {"grasp": ["servo"], "keys": ["servo"]}
    figures = tasks["keys"]["servo"]["methods"]["hold"]
    assert figures["trials"] == 2 and figures["score"]["mean"] == 0.0
    assert main(["benchmark", "--output", str(folder), "--rrd", "hold", "keys", "0", "--quiet"]) == 0
    assert (folder / "rrd" / "hold-keys-0.rrd").is_file()
    assert (
        json.loads((folder / "summary.json").read_text())["tasks"]["keys"]["servo"] == tasks["keys"]["servo"]
    )


def test_a_task_that_the_hand_cannot_do_is_left_out_with_its_reason(tmp_path, capsys):
    """Nothing is simulated, and the run ends well."""
    description = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text())
    ring = description["fingers"].pop()
    for joint in ring["joints"]:
        del description["default_positions"][joint]
    hand = tmp_path / "three.yaml"
    hand.write_text(yaml.safe_dump(description))
    command = ["benchmark", "--tasks", "keys", "--kinds", "servo", "--methods", "hold", "--trials", "1"]
    assert main([*command, "--hand", str(hand), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    reason = "the keys need a ring; hand 'allegro_right' has: thumb, index, middle"
    assert f"left out: {reason}" in " ".join(capsys.readouterr().err.split())
    figures = json.loads((tmp_path / "out" / "summary.json").read_text())["tasks"]["keys"]["servo"]
    assert figures["refused"] == {"keys": reason} and figures["methods"]["hold"]["trials"] == 0
