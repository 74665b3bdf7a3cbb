"""The grasp benchmark: going on after an interruption, errors, backends and the report."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from grasp_setup import person_and_rest, planned_goal

from geort_drake.errors import BenchmarkError, GeortError, OutputError, TrainingError, UnknownNameError
from geort_drake.evaluation import grasp_benchmark, grasp_methods, grasp_trial
from geort_drake.evaluation.grasp_benchmark import open_benchmark, read_config
from geort_drake.evaluation.grasp_methods import measure_latency
from geort_drake.evaluation.trial_log import TrialKey, TrialLog, key_of, read_records
from geort_drake.gloves.play import synthesize_play
from geort_drake.hands.description import load_hand
from geort_drake.resources import models_dir
from geort_drake.simulation.scenario import load_scenario

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "benchmark_grasping.py"
# Too short to grasp anything, long enough to run through every part.
SHORT = "{timeout: 0.3}"


@pytest.fixture(scope="module")
def play():
    return synthesize_play(seed=0, duration_s=60)


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory, play):
    """One object, a method without and one with a memory."""
    folder = tmp_path_factory.mktemp("benchmark")
    return open_benchmark(folder, load_scenario(text=SHORT), play, ["hold", "vector_online"], ["cylinder"], 2)


@pytest.fixture
def script(monkeypatch, play):
    """The script, with a person made already, and with one plan: no trial lasts long enough to follow it."""
    spec = importlib.util.spec_from_file_location("benchmark_grasping", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "read_person", lambda *_: (play, {"recording": None}))
    monkeypatch.setattr(grasp_benchmark, "plan", lambda *_: planned_goal("cylinder"))
    return module


def arguments(folder, *more: str) -> list[str]:
    return [
        "--output", str(folder), "--methods", "hold", "nearest_neighbour", "--objects", "cylinder",
        "--jobs", "1", "--scenario_text", SHORT, "--trials", "2", *more,
    ]  # fmt: skip


def judged(record: dict) -> dict:
    """A line without the time that the trial took."""
    return {name: value for name, value in record.items() if name != "wall_time"}


# -- running, and going on


def test_a_benchmark_runs_all_trials_and_reports_them(script, tmp_path, capsys):
    """Every trial has its line; the summary counts them; the page stands alone and names every command."""
    assert script.main(arguments(tmp_path)) == 0
    records = read_records(tmp_path / "trials.jsonl")
    keys = {TrialKey(m, "cylinder", seed) for m in ("hold", "nearest_neighbour") for seed in (0, 1)}
    assert len(records) == 4 and {key_of(record) for record in records} == keys
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["reference"] == "hold"
    assert summary["methods"]["hold"]["overall"]["failures"] == {"timeout: reach": 2}
    assert summary["differences"]["nearest_neighbour"]["overall"]["pairs"] == 2
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 3
    assert "<script" not in page and 'href="http' not in page and "src=" not in page
    for key in keys:
        assert f"--output {tmp_path} --rrd {key.method} {key.object} {key.seed}" in page
    assert "| hold | 0 % [0, 66] |" in (tmp_path / "report.md").read_text()
    assert "4 trials, 0 of them finished before" in capsys.readouterr().err


def test_an_interrupted_benchmark_goes_on_without_losing_or_repeating(script, tmp_path, monkeypatch):
    """Stopped after its first line and within its second, it ends with what an unbroken one has."""
    unbroken = tmp_path / "unbroken"
    script.main(arguments(unbroken))
    append = TrialLog.append

    def stop(log, record):
        if log.path.stat().st_size == 0:
            return append(log, record)
        log.path.open("ab").write(b'{"method": "hol')
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(TrialLog, "append", stop)
        with pytest.raises(KeyboardInterrupt):
            script.main(arguments(tmp_path / "broken"))
    (before,) = read_records(tmp_path / "broken" / "trials.jsonl")
    assert script.main(arguments(tmp_path / "broken")) == 0
    after = read_records(tmp_path / "broken" / "trials.jsonl")
    assert after[0] == before
    assert list(map(judged, after)) == list(map(judged, read_records(unbroken / "trials.jsonl")))


def test_trials_objects_and_methods_can_be_added(script, tmp_path):
    """What was run stays, with the same latency; the report is about everything."""
    folder = tmp_path
    script.main(arguments(folder, "--trials", "1"))
    config = read_config(folder)
    config["methods"]["hold"]["latency_s"] = 0.0123
    (folder / "config.json").write_text(json.dumps(config))
    before = read_records(folder / "trials.jsonl")
    script.main([*arguments(folder), "--methods", "vector_online", "--objects", "sphere", "--trials", "1"])
    script.main(arguments(folder))
    records = read_records(folder / "trials.jsonl")
    assert records[:2] == before and len(records) == 5
    config = read_config(folder)
    assert list(config["methods"]) == ["hold", "nearest_neighbour", "vector_online"]
    assert config["objects"] == ["cylinder", "sphere"] and config["trials"] == 2
    assert config["methods"]["hold"]["latency_s"] == 0.0123
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["methods"]["vector_online"]["objects"]["sphere"]["trials"] == 1


def test_a_trial_that_raises_is_recorded_and_stops_no_other(script, tmp_path, monkeypatch):
    """Its traceback is in a file and the exit status is 1, until it has been repeated and comes to an end."""
    run_trial = grasp_trial.run_trial

    def failing(scenario, *rest):
        if scenario.random_seed == 1:
            raise ArithmeticError("the <map> has failed")
        return run_trial(scenario, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(grasp_trial, "run_trial", failing)
        assert script.main(arguments(tmp_path)) == 1
    records = {key_of(record): record for record in read_records(tmp_path / "trials.jsonl")}
    assert len(records) == 4
    record = records[TrialKey("hold", "cylinder", 1)]
    assert record["error"] == "ArithmeticError: the <map> has failed"
    assert "in failing" in (tmp_path / record["traceback"]).read_text()
    assert "error" not in records[TrialKey("hold", "cylinder", 0)]
    assert "ArithmeticError: the &lt;map&gt; has failed" in (tmp_path / "report.html").read_text()
    assert script.main(arguments(tmp_path)) == 0
    assert "ArithmeticError" not in (tmp_path / "report.html").read_text()
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 6  # two raised; the others were not repeated


def test_a_hand_given_as_a_file_is_the_one_that_is_trained(tmp_path, play, monkeypatch):
    """Its name stands for nothing that is shipped, so training must be asked for by the file."""
    facts = yaml.safe_load((models_dir() / "hands" / "allegro_right.yaml").read_text(encoding="utf-8"))
    path = tmp_path / "hand.yaml"
    path.write_text(yaml.safe_dump(facts | {"name": "my_hand"}), encoding="utf-8")

    def train(hand_name, *_):
        raise TrainingError(f"trained for {load_hand(hand_name).name}")

    monkeypatch.setattr(grasp_methods, "cached_checkpoint", train)
    scenario = load_scenario(text=f"{{timeout: 0.3, hand: {path}}}")
    with pytest.raises(TrainingError, match="trained for my_hand"):
        open_benchmark(tmp_path / "benchmark", scenario, play, ["geort"], ["cylinder"], 1)


# -- what is the same, and what is refused


def test_another_configuration_is_refused_by_the_name_of_its_field(benchmark, play):
    """Nothing is written then."""
    folder = benchmark.folder
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    fresh = (["hold"], ["cylinder"], 2)
    other_play = synthesize_play(seed=1, duration_s=60)
    for field, scenario, recording, options in (
        ("scenario.timeout: 0.3, not 0.4", "{timeout: 0.4}", play, {}),
        ("scenario.operator.visual_delay", "{timeout: 0.3, operator: {visual_delay: 0.2}}", play, {}),
        ("recording_sha256", SHORT, other_play, {}),
        ("training_seed: 0, not 3", SHORT, play, {"seed": 3}),
        ("latency: measured, not zero", SHORT, play, {"zero_latency": True}),
    ):
        with pytest.raises(BenchmarkError, match=f"begun with another {field}"):
            open_benchmark(folder, load_scenario(text=scenario), recording, *fresh, **options)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_results_without_their_configuration_are_not_taken_over(tmp_path, play):
    """They might be anything's."""
    (tmp_path / "trials.jsonl").write_text('{"method": "hold", "object": "cylinder", "seed": 0}\n')
    with pytest.raises(BenchmarkError, match=r"holds trials without their config\.json"):
        open_benchmark(tmp_path, load_scenario(text=SHORT), play, ["hold"], ["cylinder"], 1)
    (tmp_path / "config.json").write_text('{"settings"')
    with pytest.raises(BenchmarkError, match=r"config\.json: not a benchmark's configuration"):
        open_benchmark(tmp_path, load_scenario(text=SHORT), play, ["hold"], ["cylinder"], 1)


def test_unknown_names_are_refused_with_the_choices_before_anything_is_written(script, tmp_path):
    """Methods, objects, finished trials and folders."""
    folder = tmp_path / "new"
    with pytest.raises(UnknownNameError, match=r"method or checkpoint 'nothing'.*dexpilot_online, geort"):
        script.main(arguments(folder, "--methods", "nothing"))
    with pytest.raises(UnknownNameError, match=r"object 'cone'.*bottle.*cylinder"):
        script.main(arguments(folder, "--objects", "cone"))
    with pytest.raises(BenchmarkError, match=r"config\.json: there is no such file"):
        script.main(["--output", str(folder), "--report"])
    assert not folder.exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="not a directory"):
        script.main(arguments(tmp_path / "file"))


@pytest.mark.parametrize(
    "option", [["--trials", "0"], ["--jobs", "0"], ["--seed", "-1"], ["--rrd", "a", "b", "c"]]
)
def test_senseless_numbers_are_refused(script, tmp_path, option, capsys):
    """With the option's name."""
    with pytest.raises(SystemExit):
        script.main(arguments(tmp_path, *option))
    assert option[0] in capsys.readouterr().err


# -- one trial again


def test_one_trial_can_be_watched_and_must_come_out_the_same(script, tmp_path):
    """The recording is written and linked; a line that says otherwise is an error."""
    script.main(arguments(tmp_path))
    watch = ["--output", str(tmp_path), "--rrd", "nearest_neighbour", "cylinder", "1"]
    assert script.main(watch) == 0
    name = "rrd/nearest_neighbour-cylinder-1.rrd"
    assert (tmp_path / name).stat().st_size > 20_000
    assert f'href="{name}"' in (tmp_path / "report.html").read_text()
    with pytest.raises(UnknownNameError, match=r"finished trial 'hold cylinder 7'.*hold cylinder 0"):
        script.main(["--output", str(tmp_path), "--rrd", "hold", "cylinder", "7"])
    path = tmp_path / "trials.jsonl"
    path.write_text(path.read_text().replace('"peak_height": ', '"peak_height": 1'))
    with pytest.raises(BenchmarkError, match="came out otherwise in peak_height"):
        script.main(watch)


# -- latency


def test_the_latency_is_the_median_of_successive_calls(play, monkeypatch):
    """By a clock that the method moves on; neither warm-up nor a few slow calls count."""
    clock, calls = [0.0], [0]

    def retarget(keypoints):
        assert keypoints.shape == (21, 3)
        clock[0] += 1.0 if calls[0] % 40 < 10 or calls[0] % 3 == 0 else 0.004
        calls[0] += 1

    monkeypatch.setattr(grasp_methods.time, "thread_time", lambda: clock[0])
    assert measure_latency(retarget, play) == pytest.approx(0.004)


def test_every_method_has_its_measured_latency_unless_none_is_wanted(benchmark, tmp_path, play):
    """It is in the configuration and acts in the loop."""
    stored = benchmark.config["methods"]
    assert stored["vector_online"]["latency_s"] > stored["hold"]["latency_s"] > 0
    assert benchmark.methods["vector_online"].latency == stored["vector_online"]["latency_s"]
    zero = open_benchmark(
        tmp_path, load_scenario(text=SHORT), play, ["hold"], ["cylinder"], 1, zero_latency=True
    )
    assert zero.config["methods"]["hold"]["latency_s"] == 0 and zero.methods["hold"].latency == 0
    key, text, *rest = benchmark.arguments(TrialKey("vector_online", "cylinder", 0), planned_goal("cylinder"))
    retarget, _, human = rest
    longer = text.replace("timeout: 0.3", "timeout: 4.5")
    slow = grasp_trial.simulate(key, longer, retarget, 0.1, human)
    quick = grasp_trial.simulate(key, longer, retarget, 0.0, human)
    assert judged(slow) != judged(quick)


# -- workers


def run_all(benchmark, jobs: int, backend: str = "loky") -> list[dict]:
    """Every trial's line in order, and without the time it took."""
    goals = {"cylinder": planned_goal("cylinder")}
    keys = benchmark.keys(["hold", "vector_online"], ["cylinder"], 2)
    return sorted(map(judged, benchmark.run(keys, goals, jobs, backend)), key=key_of)


def test_processes_give_what_one_process_gives(benchmark):
    """Bit by bit, also for a method that remembers its last answer."""
    alone = run_all(benchmark, 1)
    assert [key_of(record) for record in alone] == [
        TrialKey(method, "cylinder", seed) for method in ("hold", "vector_online") for seed in (0, 1)
    ]
    assert not any("error" in record for record in alone)
    assert run_all(benchmark, 2) == alone


def test_a_ray_cluster_gives_what_one_process_gives(benchmark, monkeypatch):
    """On a local cluster of two workers that the test starts."""
    ray = pytest.importorskip("ray")
    # The workers find the tests' own modules, and this package where it is not installed.
    environment = {"env_vars": {"PYTHONPATH": ":".join(map(str, sys.path)), "OMP_NUM_THREADS": "1"}}
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    ray.init(num_cpus=2, include_dashboard=False, runtime_env=environment, log_to_driver=False)
    try:
        assert run_all(benchmark, 2, "ray") == run_all(benchmark, 1)
    finally:
        ray.shutdown()


def test_without_ray_the_backend_says_what_to_install(benchmark, monkeypatch):
    """The extra's name is in the message."""
    monkeypatch.setitem(sys.modules, "ray.util.joblib.ray_backend", None)
    with pytest.raises(GeortError, match=r"pip install 'geort-drake\[ray\]'"):
        run_all(benchmark, 2, "ray")


def test_a_worker_that_dies_leaves_a_message_that_helps(benchmark, monkeypatch):
    """What is finished is kept, and one can go on."""
    monkeypatch.setattr(grasp_benchmark, "simulate", _die)
    with pytest.raises(BenchmarkError, match=r"a worker process ended.*run the same command again"):
        run_all(benchmark, 2)


def _die(*_):
    import os

    os._exit(1)


def test_a_worker_loads_neither_torch_nor_what_draws():
    """They would cost every worker seconds and memory."""
    code = (
        "import sys, geort_drake.evaluation.grasp_trial; "
        "print([name for name in ('torch', 'matplotlib', 'rerun') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_seeds_are_paired_across_methods(benchmark):
    """One seed is one placement and mass, whatever the method; another seed is another."""
    keys = benchmark.keys(["hold", "vector_online"], ["cylinder"], 2)
    assert [key.seed for key in keys] == [0, 0, 1, 1]
    person = person_and_rest()[0]
    glove = [
        grasp_trial.run_trial(
            load_scenario(text=f"{{timeout: 0.3, random_seed: {key.seed}}}"),
            benchmark.methods[key.method].retarget,
            (person, planned_goal("cylinder")),
        )[1]
        for key in keys
    ]
    # The person has not seen the robot move yet, so the noise is all that moves the hand.
    early = [recording.p_HK[:15] for recording in glove]
    np.testing.assert_array_equal(early[0], early[1])
    np.testing.assert_array_equal(early[2], early[3])
