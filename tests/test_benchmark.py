"""The benchmark in its folder: how it runs, continues and is extended, faults of methods, and the report."""

import json
import shutil

import numpy as np
import pytest
import yaml
from grasp_setup import TOO_SHORT, human_with, judged, plan_once, planned_goal, reach_goal, started

from geort_drake import Hand, load_hand, load_scenario, make_trial_diagram, run_trial
from geort_drake.benchmark import run as benchmark_run
from geort_drake.benchmark import workers
from geort_drake.benchmark.log import TrialKey, key_of, read_rows
from geort_drake.benchmark.run import Benchmark, Settings, Variant, read_scenarios, read_settings, vary
from geort_drake.cli import main, run_command
from geort_drake.errors import BenchmarkError, ScenarioError, UsageError
from geort_drake.live.web.session import watched_trial
from geort_drake.methods import resolve
from geort_drake.resources import models_dir
from geort_drake.retargeting.universal import UniversalRetargeter
from geort_drake.simulation.following import robot_model
from geort_drake.simulation.plan.grasp import GraspPlanner
from geort_drake.simulation.trial import TrialBuilder

pytestmark = pytest.mark.usefixtures("light_benchmark")
GRASP = ("grasp", "servo", "")


def key(method: str, seed: int, case: str = "cylinder", condition: str = "", training: int = 0) -> TrialKey:
    return TrialKey(method, training, "grasp", "servo", condition, case, 0, seed)


@pytest.fixture(autouse=True)
def quick_plans(monkeypatch):
    """One plan: no trial lasts long enough to follow it."""
    monkeypatch.setattr(GraspPlanner, "plans", lambda *_: [reach_goal()])


def run(folder, *more: str) -> int:
    """Runs the command on a small benchmark; later options take precedence."""
    small = [
        "--output", str(folder), "--methods", "hold", "affine_ik", "--objects", "cylinder", "--jobs", "1",
        "--scenario-text", TOO_SHORT, "--trials", "2",
    ]  # fmt: skip
    return run_command("benchmark", [*small, *more])


@pytest.fixture(scope="module")
def finished(tmp_path_factory, light_benchmark):
    """A folder with four finished trials, not to be changed."""
    folder = tmp_path_factory.mktemp("benchmark") / "finished"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GraspPlanner, "plans", lambda *_: [reach_goal()])
        assert run(folder) == 0
    return folder


@pytest.fixture
def copy(finished, tmp_path):
    """A copy of the finished benchmark, to change."""
    return shutil.copytree(finished, tmp_path / "copy")


def rows_of(folder) -> dict[TrialKey, dict]:
    return {key_of(row): row for row in read_rows(folder / "trials.jsonl")}


def test_every_trial_has_its_row_and_the_report_its_figures(finished):
    """Seeds outermost, so that every prefix compares the methods with the same trials."""
    assert list(rows_of(finished)) == [key(name, seed) for seed in (0, 1) for name in ("hold", "affine_ik")]
    report = (finished / "report.md").read_text()
    assert "| hold | 2 | 0 [0, " in report and "| affine_ik | 2 | 0 [0, " in report
    assert "2 × timeout: reach (" in report and "Simulated latencies: those of the scenarios" in report
    for name in ("success.svg", "completion.svg"):
        assert f"]({name})" in report and "<svg" in (finished / name).read_text()


def test_a_run_stopped_within_a_row_continues_as_if_it_had_not_been(copy, capsys):
    """No trial is lost, repeated or different."""
    path = copy / "trials.jsonl"
    whole = path.read_text().splitlines(keepends=True)
    path.write_text("".join(whole[:2]) + whole[2][:100])
    assert run(copy) == 0
    assert "line 3: not the row of a trial" in " ".join(capsys.readouterr().err.split())
    after = path.read_text().splitlines(keepends=True)
    assert after[:2] == whole[:2]
    assert [judged(json.loads(row)) for row in after] == [judged(json.loads(row)) for row in whole]


def test_methods_objects_people_and_conditions_can_be_added(copy):
    """Finished trials and latencies stay; names given twice are run once; the report shows everything."""
    settings = json.loads((copy / "settings.json").read_text())
    settings["methods"]["hold"]["latency_s"] = 0.0123
    (copy / "settings.json").write_text(json.dumps(settings))
    before = rows_of(copy)
    added = ["--methods", "anyteleop", "anyteleop", "--objects", "sphere", "--trials", "1"]
    assert run(copy, *added) == 0
    more = ["--methods", "hold", "--trials", "1", "--persons", "0", "3", "--vary"]
    assert run(copy, *more, "operator.visual_delay=0,0.18", "object.mass_factor=2.0") == 0
    after = rows_of(copy)
    new = [each for each in after if each not in before]
    assert list(after)[:4] == list(before)
    assert new == [
        key("anyteleop", 0, "sphere"),
        key("hold", 0)._replace(person=3),
        key("hold", 0, condition="operator.visual_delay=0"),
        key("hold", 0, condition="object.mass_factor=2.0"),
    ]
    settings = read_settings(copy)
    assert list(settings.methods) == ["hold", "affine_ik", "anyteleop"]
    assert settings.objects == ["cylinder", "sphere"] and settings.trials == 2 and settings.persons == [0, 3]
    assert settings.methods["hold"]["latency_s"] == 0.0123
    report = (copy / "report.md").read_text()
    assert "## grasp, servo people, operator.visual_delay=0" in report
    assert "hold, object.mass_factor=2.0<" in (copy / "success.svg").read_text()


def test_a_field_of_the_scenario_is_varied_by_its_name():
    scenario = load_scenario()
    varied = vary(scenario, ["operator.touch=false,true", "object.mass_factor=2.0", "person=2"])
    assert list(varied) == ["operator.touch=false", "object.mass_factor=2.0", "person=2"]
    assert not varied["operator.touch=false"].operator.touch and scenario.operator.touch
    assert varied["object.mass_factor=2.0"].object.mass_factor == 2.0 and varied["person=2"].person == 2
    for text in ("operator.delay=1", "operator.visual_delay=slow", "timeout=-1", "timeout"):
        with pytest.raises(ScenarioError, match=text.split("=", maxsplit=1)[0]):
            vary(scenario, [text])


@pytest.mark.slow
def test_a_submitted_method_adds_its_row_with_the_settings_of_the_others(copy, tmp_path):
    before = rows_of(copy)
    assert run_command("benchmark", ["--output", str(copy), "--jobs", "1", "--submit", "anyteleop"]) == 0
    new = {each: row for each, row in rows_of(copy).items() if each not in before}
    assert list(new) == [key("anyteleop", 0), key("anyteleop", 1)]
    assert {row["timeout"] for row in new.values()} == {0.3}
    with pytest.raises(BenchmarkError, match=r"settings\.json: no such file"):
        run_command("benchmark", ["--output", str(tmp_path), "--submit", "hold"])
    with pytest.raises(UsageError, match="leave out --trials"):
        run_command("benchmark", ["--output", str(copy), "--submit", "hold", "--trials", "3"])


def test_other_settings_are_refused_by_name_and_other_versions_cause_a_warning(copy, capsys):
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    for options, message in (
        (["--scenario-text", "{timeout: 0.4}"], r"another grasp servo\.timeout: 0\.3, not 0\.4"),
        (["--seed", "3"], "another seed: 0, not 3"),
        (["--measure-latency"], "another measure_latency: False, not True"),
    ):
        with pytest.raises(BenchmarkError, match=message):
            run(copy, *options)
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before
    settings = json.loads((copy / "settings.json").read_text())
    settings["provenance"]["code_sha256"] = "of before"
    (copy / "settings.json").write_text(json.dumps(settings))
    assert run(copy) == 0
    assert "trials were made with another code_sha256" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("text", ["", "[]", '{"trials": 1, "unknown": 2}'])
def test_damaged_settings_are_refused_by_their_file(copy, text):
    (copy / "settings.json").write_text(text)
    with pytest.raises(BenchmarkError, match=r"settings\.json: not the settings of a benchmark"):
        run(copy)


def test_a_trial_that_raises_is_recorded_and_stops_no_other(tmp_path, monkeypatch):
    """The exit code is 1, until a repetition succeeds."""

    def failing(scenario, *rest, **options):
        if scenario.random_seed == 1:
            raise ArithmeticError("the <map> has failed")
        return run_trial(scenario, *rest, **options)

    with monkeypatch.context() as patch:
        patch.setattr(workers, "run_trial", failing)
        assert run(tmp_path, "--methods", "hold") == 1
    row = rows_of(tmp_path)[key("hold", 1)]
    assert row["error"] == "ArithmeticError: the <map> has failed" and "in failing" in row["traceback"]
    assert "error" not in rows_of(tmp_path)[key("hold", 0)]
    assert "ArithmeticError: the <map> has failed" in (tmp_path / "report.md").read_text()
    assert run(tmp_path, "--methods", "hold") == 0
    assert "ArithmeticError" not in (tmp_path / "report.md").read_text()


METHOD = """
import time
def make(hand):
    calls = []
    def retarget(p_HK):
        calls.append(0)
        if {condition}:
            {fault}
        return 0.5 * (hand.lower + hand.upper)
    return retarget
"""


FAULTS = {
    "raises.py": ("raise ValueError('no')", "raised ValueError: no"),
    "not_finite.py": ("return hand.lower * float('nan')", "not finite"),
    "short.py": ("return hand.lower[1:]", "of shape (15,)"),
    "outside.py": ("return hand.upper + 1", "outside the limits"),
    "slow.py": ("time.sleep(0.4)", "may take at most 0.3 s"),
}


def test_a_method_that_fails_at_once_gets_rows_that_say_so(tmp_path):
    """Its trials are not simulated; those of the others are."""
    for name, (fault, _) in FAULTS.items():
        (tmp_path / name).write_text(METHOD.format(condition="True", fault=fault))
    files = [str(tmp_path / name) for name in FAULTS]
    assert run(tmp_path / "out", "--methods", "hold", *files, "--trials", "1") == 1
    rows = rows_of(tmp_path / "out")
    assert "error" not in rows[key("hold", 0)]
    for name, (_, message) in FAULTS.items():
        assert message in rows[key(name, 0)]["error"]


def test_a_method_that_fails_later_has_its_faults_counted(tmp_path):
    (tmp_path / "mine.py").write_text(METHOD.format(condition="len(calls) > 9", fault="return None"))
    assert run(tmp_path / "out", "--methods", str(tmp_path / "mine.py"), "--trials", "1") == 0
    (row,) = rows_of(tmp_path / "out").values()
    assert list(row["faults"]) == ["of shape ()"]
    assert "outputs of shape ()" in (tmp_path / "out" / "report.md").read_text()


def test_a_case_that_the_hand_cannot_do_is_reported_first_and_left_out(tmp_path, monkeypatch, capsys):
    """It is no failure of a method; the others run."""
    reason = "the robot cannot grasp object 'rod'"
    monkeypatch.setattr(
        benchmark_run, "plan", lambda text: reason if "name: rod" in text else [planned_goal("cylinder")]
    )
    assert run(tmp_path, "--methods", "hold", "--objects", "rod", "cylinder") == 0
    assert {each.object for each in rows_of(tmp_path)} == {"cylinder"}
    assert read_settings(tmp_path).refused == {"grasp rod": reason}
    assert f"left out: grasp rod: {reason}" in " ".join(capsys.readouterr().err.split())
    assert reason in (tmp_path / "report.md").read_text()


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
    assert f"left out: keys keys: {reason}" in " ".join(capsys.readouterr().err.split())
    assert rows_of(tmp_path / "out") == {}


def test_several_tasks_share_one_folder(tmp_path, monkeypatch):
    """They have one log and one report."""
    plan_once(monkeypatch, "keys")
    options = ["--methods", "hold", "--trials", "1", "--kinds", "servo"]
    assert run(tmp_path, *options, "--tasks", "keys", "grasp", "--objects", "cylinder") == 0
    assert [each.task for each in rows_of(tmp_path)] == ["keys", "grasp"]
    report = (tmp_path / "report.md").read_text()
    assert "## keys, servo people" in report and "## grasp, servo people" in report


@pytest.mark.slow
def test_a_trial_is_the_same_in_a_benchmark_in_the_command_grasp_and_on_the_page(tmp_path):
    """Bit for bit, for the same method, object and seed."""
    options = ["--scenario-text", "{timeout: 2.5, random_seed: 4}", "--objects", "cylinder", "--trials", "1"]
    folder = tmp_path / "benchmark"
    assert run_command("benchmark", ["--output", str(folder), "--methods", "universal", *options]) == 0
    row = rows_of(folder)[key("universal", 4)]
    assert run_command("grasp", ["--output", str(tmp_path / "grasp"), "--no-rerun", *options]) == 0
    (result,) = json.loads((tmp_path / "grasp" / "results.json").read_text())["trials"]
    assert result["operator_phase"] != "reach" and judged(result) == judged({n: row[n] for n in result})
    scenario = read_scenarios(folder)[Variant("grasp", "servo")]
    builder = TrialBuilder(Hand("allegro_right"))
    parts, page = watched_trial(builder, scenario, resolve("universal", Hand("allegro_right"))[0])
    simulator = started(parts)
    simulator.AdvanceTo(scenario.timeout)
    metrics = page.outcome(simulator.get_context()).metrics
    assert metrics == {name: row[name] for name in metrics}


@pytest.mark.slow
def test_trained_methods_are_trained_several_times_and_others_once(tmp_path, monkeypatch):
    """Each training has its seed and its rows."""
    made = []

    def resolve(method, hand, recording, seed, *_):
        made.append((method, seed))
        return find_hold(hand), None

    from geort_drake.retargeting import METHODS

    def find_hold(hand):
        return METHODS["hold"].fit(hand)

    monkeypatch.setattr(benchmark_run, "resolve", resolve)
    assert run(tmp_path, "--methods", "hold", "geort", "--trainings", "2", "--trials", "1") == 0
    assert made == [("hold", 0), ("geort", 0), ("geort", 1)]
    assert list(rows_of(tmp_path)) == [key("hold", 0), key("geort", 0), key("geort", 0, training=1)]


def test_every_method_has_the_scenarios_latency_or_the_measured_one(tmp_path, monkeypatch):
    """It is in the settings and in the scenario of its trials, which share a model of the robot."""
    used = []

    def use(scenario, *_):
        used.append((scenario.retargeting.latency, robot_model(scenario, load_hand(scenario.hand))))

    monkeypatch.setattr(workers, "run_trial", use)
    stored = {}
    for name, measure in (("measured", True), ("scenario", False)):
        settings = Settings(measure_latency=measure)
        text = TOO_SHORT.replace("}", ", retargeting: {latency: 0.004}}")
        scenarios = {Variant("grasp", "servo"): load_scenario(text=text)}
        methods = {"hold": "hold", "anyteleop": "anyteleop"}
        benchmark = Benchmark(tmp_path / name, settings, scenarios, methods)
        list(benchmark.plan([key("hold", 0)], 1))
        workers.simulate(key("hold", 0), benchmark.trial(key("hold", 0)))
        stored[name] = {method: entry["latency_s"] for method, entry in settings.methods.items()}
    assert stored["measured"]["anyteleop"] > stored["measured"]["hold"] > 0
    assert [latency for latency, _ in used] == [stored["measured"]["hold"], 0.004]
    assert used[0][1] is used[1][1] and stored["scenario"] == {"hold": None, "anyteleop": None}


def test_seeds_are_paired_across_methods(tmp_path):
    """One seed is one place, mass, friction and noise, whatever the method; another seed differs in each."""
    methods = {"hold": "hold", "anyteleop": "anyteleop"}
    scenarios = {Variant("grasp", "servo"): load_scenario(text=TOO_SHORT)}
    benchmark = Benchmark(tmp_path, Settings(), scenarios, methods)
    keys = benchmark.keys(methods, ["cylinder"], [0], 2)
    assert [each.seed for each in keys] == [0, 0, 1, 1]
    human = human_with()
    seen = []
    for each in keys[:3]:
        scenario = load_scenario(text=f"{{timeout: 0.4, random_seed: {each.seed}}}")
        retarget = benchmark._maps[each.method, 0]
        stage = make_trial_diagram(scenario, retarget, human).stage
        glove = run_trial(scenario, retarget, human)[1]
        # The person first decides at the sample after the visual delay, and sees what the method does with it
        # one sample later. The arm moves without the method.
        first = round(scenario.operator.visual_delay / scenario.operator.period)
        assert not np.array_equal(glove.p_HK[first], glove.p_HK[0])
        place = stage.plant.GetDefaultFloatingBaseBodyPose(stage.handled.body).GetAsMatrix4()
        geometry, *_ = stage.plant.GetCollisionGeometriesForBody(stage.handled.body)
        properties = stage.scene_graph.model_inspector().GetProximityProperties(geometry)
        friction = properties.GetProperty("material", "coulomb_friction").static_friction()
        seen.append((place, stage.handled.mass_factor, friction, glove.p_HK[: first + 1], glove.X_WH))
    for value, of_same_seed, of_other_seed in zip(*seen, strict=True):
        np.testing.assert_array_equal(value, of_same_seed)
        assert not np.array_equal(value, of_other_seed)


@pytest.mark.parametrize("task", ["grasp", "keys"])
def test_a_trial_goes_on_with_the_fixed_map_that_the_person_saw_in_free_play(tmp_path, task, monkeypatch):
    if task != "grasp":
        plan_once(monkeypatch, task)
    scenario = load_scenario(task=task, text=TOO_SHORT)
    scenarios = {Variant(task, scenario.kind): scenario}
    benchmark = Benchmark(tmp_path, Settings(), scenarios, {"universal": "universal"})
    wanted = benchmark.keys(["universal"], [], [0], 1)[0]
    list(benchmark.plan([wanted], 1))
    trial = benchmark.trial(wanted)
    assert not isinstance(trial.retarget, UniversalRetargeter)
    if task != "grasp":
        own, seen = trial.human[1].play.p_HF[-1], trial.human[1].play.p_BF[-1]
        np.testing.assert_allclose(benchmark.hand.fingertips(trial.retarget(own)), seen, atol=1e-6)
