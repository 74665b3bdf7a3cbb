"""The grasp benchmark in its folder: running, continuing, conditions, pairing, the report and repetitions."""

import fcntl
import json
import os
import shutil

import numpy as np
import pytest
from grasp_setup import TOO_SHORT, human_with, planned_goal

from geort_drake import load_scenario, make_trial_diagram, run_trial
from geort_drake.benchmark import trials
from geort_drake.benchmark.config import read_config
from geort_drake.benchmark.folder import open_benchmark
from geort_drake.benchmark.records import TrialKey, key_of, read_records
from geort_drake.cli import run_command
from geort_drake.comparison.retargeters import names_of
from geort_drake.errors import BenchmarkError, UnknownNameError, UsageError
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.simulation.tasks import find_task


@pytest.fixture(scope="module", autouse=True)
def quick(light_benchmark):
    """One plan: no trial lasts long enough to follow it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trials, "plan", lambda *_: [planned_goal("cylinder")])
        yield


def run(folder, *more: str) -> int:
    """Runs the command on a small benchmark; later options take precedence."""
    small = [
        "--output", str(folder), "--methods", "hold", "affine_ik", "--objects", "cylinder",
        "--jobs", "1", "--scenario-text", TOO_SHORT, "--trials", "2",
    ]  # fmt: skip
    return run_command("benchmark", [*small, *more])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with four finished trials, not to be changed; made once for all workers of pytest-xdist."""
    root = tmp_path_factory.getbasetemp()
    folder = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / "finished"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = folder.with_suffix(".done")
        if not done.exists():
            assert run(folder) == 0
            done.touch()
    return folder


@pytest.fixture
def copy(finished, tmp_path):
    """A copy of the finished benchmark, to change."""
    return shutil.copytree(finished, tmp_path / "copy")


def test_every_trial_has_its_line_and_its_place_in_the_report(finished):
    """The summary counts all trials."""
    records = read_records(finished / "trials.jsonl")
    keys = {TrialKey(m, "cylinder", seed) for m in ("hold", "affine_ik") for seed in (0, 1)}
    assert len(records) == 4 and {key_of(record) for record in records} == keys
    summary = json.loads((finished / "summary.json").read_text())
    assert summary["reference"] == "hold"
    failures = summary["methods"]["hold"]["overall"]["failures"]
    assert sum(failures.values()) == 2 and all(name.startswith("timeout: reach (") for name in failures)
    assert summary["differences"]["affine_ik"]["overall"]["pairs"] == 2
    assert summary["methods"]["hold"]["classes"]["tripod"] == summary["methods"]["hold"]["overall"]
    report = (finished / "report.md").read_text()
    # Overall, in its class and by itself.
    assert report.count("| hold | 0 % [0, 66] |") == 3
    assert report.count("| affine_ik | 2 | +0 [+0, +0] | 0 : 0 |") == 3
    assert "](completion.svg)" in report and (finished / "completion.svg").read_text().startswith("<svg")


def test_methods_objects_and_conditions_can_be_added(copy):
    """Finished trials and latencies stay; names given twice are run once; the report shows everything."""
    config = read_config(copy)
    config["methods"]["hold"]["latency_s"] = 0.0123
    (copy / "config.json").write_text(json.dumps(config))
    before = read_records(copy / "trials.jsonl")
    added = ["--methods", "vector_online", "vector_online", "--objects", "sphere", "--trials", "1"]
    assert run(copy, *added) == 0
    more = ["--methods", "hold", "--trials", "1", "--sensitivity", "delay=0,180", "stiffness=2"]
    assert run(copy, *more) == 0
    records = read_records(copy / "trials.jsonl")
    assert records[:4] == before
    new = ["vector_online sphere 0", "hold cylinder 0 delay=0", "hold cylinder 0 stiffness=2"]
    assert [str(key_of(record)) for record in records[4:]] == new
    config = read_config(copy)
    assert list(config["methods"]) == ["hold", "affine_ik", "vector_online"]
    assert config["objects"] == ["cylinder", "sphere"] and config["trials"] == 2
    assert config["methods"]["hold"]["latency_s"] == 0.0123
    changes = {"delay=0": {"operator": {"visual_delay": 0.0}}, "stiffness=2": {"hand_stiffness_factor": 2.0}}
    assert config["conditions"] == changes
    summary = json.loads((copy / "summary.json").read_text())
    assert summary["methods"]["vector_online"]["objects"]["sphere"]["trials"] == 1
    assert summary["methods"]["hold"]["overall"]["trials"] == 2
    assert [c["value"] for c in summary["sensitivity"]["delay"]["conditions"]] == [0, 180]
    assert "| **180** | – | 0 % [0, 79] |" in (copy / "report.md").read_text()
    assert (copy / "sensitivity.svg").read_text().startswith("<svg")


def test_a_submitted_method_adds_its_row_with_the_settings_of_the_others(copy, tmp_path):
    """No option but the folder is needed; a folder without a benchmark is refused."""
    before = json.loads((copy / "summary.json").read_text())
    assert run_command("benchmark", ["--output", str(copy), "--jobs", "1", "--submit", "vector_online"]) == 0
    after = json.loads((copy / "summary.json").read_text())
    assert list(after["methods"]) == [*before["methods"], "vector_online"]
    assert after["methods"]["vector_online"]["overall"]["trials"] == 2
    assert after["methods"]["hold"] == before["methods"]["hold"]
    assert after["config"]["settings"] == before["config"]["settings"]
    with pytest.raises(BenchmarkError, match=r"config\.json: no such file"):
        run_command("benchmark", ["--output", str(tmp_path), "--submit", "vector_online"])
    for option, value in (("--methods", "hold"), ("--trials", "3")):
        with pytest.raises(UsageError, match=f"leave out {option}"):
            run_command("benchmark", ["--output", str(copy), "--submit", "hold", option, value])


def test_a_trial_that_raises_is_recorded_and_stops_no_other(tmp_path, monkeypatch):
    """Its traceback is in a file and the exit code is 1, until a repetition succeeds."""

    def failing(scenario, *rest, **options):
        if scenario.random_seed == 1:
            raise ArithmeticError("the <map> has failed")
        return run_trial(scenario, *rest, **options)

    with monkeypatch.context() as patch:
        patch.setattr(trials, "run_trial", failing)
        assert run(tmp_path, "--methods", "hold") == 1
    records = {key_of(record): record for record in read_records(tmp_path / "trials.jsonl")}
    record = records[TrialKey("hold", "cylinder", 1)]
    assert record["error"] == "ArithmeticError: the <map> has failed"
    assert "in failing" in (tmp_path / record["traceback"]).read_text()
    assert "error" not in records[TrialKey("hold", "cylinder", 0)]
    assert "ArithmeticError: the <map> has failed" in (tmp_path / "report.md").read_text()
    assert run(tmp_path, "--methods", "hold") == 0
    assert "ArithmeticError" not in (tmp_path / "report.md").read_text()
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 3


def test_an_object_that_the_hand_cannot_grasp_is_left_out_and_named(tmp_path, monkeypatch):
    """The others run, nothing is missing, and an object that is refused is no failure of a method."""
    reason = "the robot cannot grasp object 'rod'"
    plans = {"cylinder": [planned_goal("cylinder")], "rod": reason}
    monkeypatch.setattr(trials, "plan", lambda _, name: plans[name])
    assert run(tmp_path, "--methods", "hold", "--objects", "rod", "cylinder") == 0
    assert {record["object"] for record in read_records(tmp_path / "trials.jsonl")} == {"cylinder"}
    assert json.loads((tmp_path / "summary.json").read_text())["refused"] == {"rod": reason}
    report = (tmp_path / "report.md").read_text()
    assert reason in report and "2 of 2 trials" in report


def test_another_configuration_is_refused_by_the_name_of_its_field(copy, play):
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    for field, scenario, seed in (
        ("scenario.timeout: 0.3, not 0.4", "{timeout: 0.4}", 0),
        ("training_seed: 0, not 3", TOO_SHORT, 3),
    ):
        with pytest.raises(BenchmarkError, match=f"begun with another {field}"):
            open_benchmark(copy, load_scenario(text=scenario), play, ["hold"], ["cylinder"], 2, seed)
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before


def test_a_checkpoint_is_named_after_its_directory_however_that_is_given(tmp_path, monkeypatch):
    """Also from within it; two directories of one name are refused."""
    for folder in ("one/map", "other/map"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "config.json").write_text("{}")
    monkeypatch.chdir(tmp_path / "one" / "map")
    path = str(tmp_path / "one" / "map")
    assert names_of([".", "hold", path, "hold", "../map"]) == {"map": path, "hold": "hold"}
    with pytest.raises(BenchmarkError, match=r"two methods have the name 'map': .*one/map and .*other/map"):
        names_of([".", "../../other/map"])


def test_a_trial_can_be_recorded_and_must_come_out_the_same(copy, capsys):
    """The recording is written and linked; changed code is a warning, another outcome an error."""
    config = read_config(copy)
    config["settings"]["code_sha256"] = "of before"
    (copy / "config.json").write_text(json.dumps(config))
    repeat = ["benchmark", ["--output", str(copy), "--rrd", "affine_ik", "cylinder", "1"]]
    assert run_command(*repeat) == 0
    assert "code has changed since" in capsys.readouterr().err and read_config(copy) == config
    name = "rrd/affine_ik-cylinder-1.rrd"
    assert (copy / name).stat().st_size > 20_000
    path = copy / "trials.jsonl"
    path.write_text(path.read_text().replace('"peak_height": ', '"peak_height": 1'))
    with pytest.raises(BenchmarkError, match="differs in peak_height"):
        run_command(*repeat)
    with pytest.raises(UnknownNameError, match=r"finished trial 'hold cylinder 7'.*hold cylinder 0"):
        run_command("benchmark", ["--output", str(copy), "--rrd", "hold", "cylinder", "7"])


def test_every_method_has_its_measured_latency_unless_none_is_wanted(tmp_path, play, monkeypatch):
    """It is in the configuration and in the scenario of its trials, which share a model of the robot."""
    arguments = (load_scenario(text=TOO_SHORT), play, ["hold", "vector_online"], ["cylinder"], 1)
    measured = open_benchmark(tmp_path / "measured", *arguments)
    stored = {name: entry["latency_s"] for name, entry in measured.config["methods"].items()}
    assert stored["vector_online"] > stored["hold"] > 0
    zero = open_benchmark(tmp_path / "zero", *arguments, zero_latency=True)
    assert zero.config["methods"]["hold"]["latency_s"] == 0
    used = []
    monkeypatch.setattr(trials, "run_trial", lambda s, *_, model: used.append((s.retargeting.latency, model)))
    for made in (measured, zero):
        key = TrialKey("hold", "cylinder", 0)
        trials.simulate(made.trial(key, [planned_goal("cylinder")]))
    assert [latency for latency, _ in used] == [stored["hold"], 0.0] and used[0][1] is used[1][1]


def test_seeds_are_paired_across_methods(tmp_path, play):
    """One seed is one place, mass, friction and noise, whatever the method; another seed differs in each."""
    scenario = load_scenario(text=TOO_SHORT)
    made = open_benchmark(tmp_path, scenario, play, ["hold", "vector_online"], ["cylinder"], 2)
    keys = made.keys(["hold", "vector_online"], ["cylinder"], 2)
    assert [key.seed for key in keys] == [0, 0, 1, 1]
    human = human_with()
    seen = []
    for key in keys[:3]:
        scenario = load_scenario(text=f"{{timeout: 0.4, random_seed: {key.seed}}}")
        retarget, _ = made.methods[key.method]
        drawn = make_trial_diagram(scenario, retarget, human).stage.scene.placement
        glove = run_trial(scenario, retarget, human)[1]
        # The person first decides at the sample after the visual delay, and sees what the method does with it
        # one sample later. The arm moves without the method.
        first = round(scenario.operator.visual_delay / scenario.operator.period)
        assert not np.array_equal(glove.p_HK[first], glove.p_HK[0])
        place = drawn.X_WO.GetAsMatrix4()
        seen.append((place, drawn.mass_factor, drawn.friction_factor, glove.p_HK[: first + 1], glove.X_WH))
    for value, of_same_seed, of_other_seed in zip(*seen, strict=True):
        np.testing.assert_array_equal(value, of_same_seed)
        assert not np.array_equal(value, of_other_seed)


@pytest.mark.parametrize(("task", "begins_cold"), [("grasp", True), ("keys", False)])
def test_people_who_learn_a_map_in_free_play_go_on_with_the_map_that_they_saw(
    tmp_path, play, task, begins_cold
):
    """A grasp sees the person first in the trial."""
    scenario = load_scenario(*find_task(task).scenario, TOO_SHORT)
    made = open_benchmark(tmp_path, scenario, play, ["universal"], [find_task(task).case_of(scenario)], 1)
    plans = (
        [planned_goal("cylinder")] if begins_cold else find_task(task).plans(scenario, made.hand.description)
    )
    (key,) = made.keys(["universal"], [find_task(task).case_of(scenario)], 1)
    trial = made.trial(key, plans)
    assert isinstance(trial.retarget, UniversalRetargeter) == begins_cold
    if not begins_cold:
        own, seen = trial.human[1].play.p_HF[-1], trial.human[1].play.p_BF[-1]
        np.testing.assert_allclose(made.hand.fingertips(trial.retarget(own)), seen, atol=1e-6)
