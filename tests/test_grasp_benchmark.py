"""The grasp benchmark: going on after an interruption, errors, pairing and the report."""

import json

import numpy as np
import pytest
import yaml
from grasp_setup import TOO_SHORT, judged, person_and_rest, planned_goal
from script_modules import load_script

from geort_drake.benchmark import folder as grasp_benchmark
from geort_drake.benchmark import methods as grasp_methods
from geort_drake.benchmark import trial as grasp_trial
from geort_drake.benchmark.config import read_config
from geort_drake.benchmark.folder import keep_error, open_benchmark
from geort_drake.benchmark.methods import measure_latency, names_of
from geort_drake.benchmark.trial_log import TrialKey, TrialLog, key_of, read_records
from geort_drake.errors import BenchmarkError, OutputError, TrainingError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.people.play import synthesize_play
from geort_drake.resources import models_dir
from geort_drake.simulation.diagram import make_grasp_diagram
from geort_drake.simulation.scenario import load_scenario
from geort_drake.simulation.trial import run_trial


@pytest.fixture(scope="module")
def play():
    return synthesize_play(seed=0, duration_s=60)


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory, play):
    """One object, a method without and one with a memory."""
    folder = tmp_path_factory.mktemp("benchmark")
    return open_benchmark(
        folder, load_scenario(text=TOO_SHORT), play, ["hold", "vector_online"], ["cylinder"], 2
    )


@pytest.fixture
def script(monkeypatch, play):
    """The script, with a person made already, and with one plan: no trial lasts long enough to follow it."""
    module = load_script("benchmark_grasping.py")
    monkeypatch.setattr(module, "read_person", lambda *_: (play, {"recording": None}))
    monkeypatch.setattr(grasp_benchmark, "plan", lambda *_: planned_goal("cylinder"))
    return module


def arguments(folder, *more: str) -> list[str]:
    return [
        "--output", str(folder), "--methods", "hold", "nearest_neighbour", "--objects", "cylinder",
        "--jobs", "1", "--scenario_text", TOO_SHORT, "--trials", "2", *more,
    ]  # fmt: skip


# -- running, and going on


def test_a_benchmark_runs_all_trials_and_reports_them(script, tmp_path, capsys):
    """Every trial has its line; the summary counts them; the page stands alone and names every command."""
    assert script.main(arguments(tmp_path)) == 0
    records = read_records(tmp_path / "trials.jsonl")
    keys = {TrialKey(m, "cylinder", seed) for m in ("hold", "nearest_neighbour") for seed in (0, 1)}
    assert len(records) == 4 and {key_of(record) for record in records} == keys
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["reference"] == "hold"
    failures = summary["methods"]["hold"]["overall"]["failures"]
    assert sum(failures.values()) == 2 and all(name.startswith("timeout: reach (") for name in failures)
    assert summary["differences"]["nearest_neighbour"]["overall"]["pairs"] == 2
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 3
    assert "<script" not in page and 'href="http' not in page and "src=" not in page
    for key in keys:
        assert f"--output {tmp_path} --rrd {key.method} {key.object} {key.seed}" in page
    report = (tmp_path / "report.md").read_text()
    # Overall, in its class and by itself.
    assert report.count("| hold | 0 % [0, 66] |") == 3
    assert report.count("| nearest_neighbour | 2 | +0 [+0, +0] | 0 : 0 |") == 3
    assert "### tripod: cylinder" in report and "### cylinder (tripod)" in report
    assert "](completion.svg)" in report and (tmp_path / "completion.svg").read_text().startswith("<svg")
    assert summary["methods"]["hold"]["classes"]["tripod"] == summary["methods"]["hold"]["overall"]
    assert "4 trials, 0 of them finished before" in capsys.readouterr().err


def test_names_given_twice_are_run_once(script, tmp_path):
    """Methods and objects keep their order; the folder stays one that can be gone on with."""
    doubled = [
        "--methods",
        "vector_online",
        "hold",
        "vector_online",
        "--objects",
        "sphere",
        "cylinder",
        "sphere",
    ]
    for _ in range(2):
        assert script.main([*arguments(tmp_path, "--trials", "1"), *doubled]) == 0
    config = read_config(tmp_path)
    assert config["objects"] == ["sphere", "cylinder"]
    assert list(config["methods"]) == ["vector_online", "hold"]
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 4


def test_a_checkpoint_is_named_after_its_directory_however_that_is_given(tmp_path, monkeypatch):
    """Also from within it; two directories of one name are refused, and one given twice is taken once."""
    for folder in ("one/map", "other/map"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "config.json").write_text("{}")
    monkeypatch.chdir(tmp_path / "one" / "map")
    path = str(tmp_path / "one" / "map")
    assert names_of([".", "hold", path, "hold", "../map"]) == {"map": path, "hold": "hold"}
    with pytest.raises(BenchmarkError, match=r"two methods have the name 'map': .*one/map and .*other/map"):
        names_of([".", "../../other/map"])


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
    with monkeypatch.context() as patch:
        patch.setattr(grasp_benchmark, "simulate", _simulate_one_that_fails)
        assert script.main(arguments(tmp_path)) == 1
    records = {key_of(record): record for record in read_records(tmp_path / "trials.jsonl")}
    assert len(records) == 4
    record = records[TrialKey("hold", "cylinder", 1)]
    assert record["error"] == "ArithmeticError: the <map> has failed"
    assert "in _failing" in (tmp_path / record["traceback"]).read_text()
    assert "error" not in records[TrialKey("hold", "cylinder", 0)]
    assert "ArithmeticError: the &lt;map&gt; has failed" in (tmp_path / "report.html").read_text()
    assert script.main(arguments(tmp_path)) == 0
    assert "ArithmeticError" not in (tmp_path / "report.html").read_text()
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 6  # two raised; the others were not repeated


def _simulate_one_that_fails(key, *arguments):
    """In a worker, where nothing is patched."""
    with pytest.MonkeyPatch.context() as patch:
        if key.seed == 1:
            patch.setattr(grasp_trial, "run_trial", _failing)
        return grasp_trial.simulate(key, *arguments)


def _failing(*_):
    raise ArithmeticError("the <map> has failed")


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
    assert open_benchmark(folder, load_scenario(text=TOO_SHORT), play, *fresh).config == benchmark.config
    for field, scenario, recording, options in (
        ("scenario.timeout: 0.3, not 0.4", "{timeout: 0.4}", play, {}),
        ("scenario.operator.visual_delay", "{timeout: 0.3, operator: {visual_delay: 0.2}}", play, {}),
        ("recording_sha256", TOO_SHORT, other_play, {}),
        ("training_seed: 0, not 3", TOO_SHORT, play, {"seed": 3}),
        ("latency: measured, not zero", TOO_SHORT, play, {"zero_latency": True}),
    ):
        with pytest.raises(BenchmarkError, match=f"begun with another {field}"):
            open_benchmark(folder, load_scenario(text=scenario), recording, *fresh, **options)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_results_without_their_configuration_are_not_taken_over(tmp_path, play):
    """They might be anything's."""
    (tmp_path / "trials.jsonl").write_text('{"method": "hold", "object": "cylinder", "seed": 0}\n')
    with pytest.raises(BenchmarkError, match=r"holds trials without their config\.json"):
        open_benchmark(tmp_path, load_scenario(text=TOO_SHORT), play, ["hold"], ["cylinder"], 1)
    (tmp_path / "config.json").write_text('{"settings"')
    with pytest.raises(BenchmarkError, match=r"config\.json: not a benchmark's configuration"):
        open_benchmark(tmp_path, load_scenario(text=TOO_SHORT), play, ["hold"], ["cylinder"], 1)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("settings",), {}, "settings.code_sha256, settings.hand.* missing"),
        (("settings", "latency"), "none", "settings.latency must be .measured. or .zero., not .none."),
        (
            ("settings", "scenario", "timeout"),
            "25",
            "settings.scenario.timeout must be a finite number, not .25.",
        ),
        (("methods", "hold"), {}, "methods.hold.latency_s, methods.hold.weights_sha256 missing"),
        (("methods", "hold", "latency_s"), float("nan"), "methods.hold.latency_s must be a finite number"),
        (("methods",), {}, "methods must name at least one"),
        (("objects",), ["cylinder", 1], r"objects\[1\] must be a text, not 1"),
        (("trials",), 2.5, "trials must be a whole number, not 2.5"),
        (("conditions",), {"delay=0": None}, "conditions.delay=0 must be an object, not null"),
        (("notes", "recording"), 3, "notes.recording must be a text or null, not 3"),
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused_by_its_field(
    benchmark, tmp_path, path, value, message
):
    """The report says so, and nothing else is written."""
    config = json.loads((benchmark.folder / "config.json").read_text())
    *outer, last = path
    within = config
    for name in outer:
        within = within[name]
    within[last] = value
    (tmp_path / "config.json").write_text(json.dumps(config))
    (tmp_path / "trials.jsonl").write_text("")
    with pytest.raises(BenchmarkError, match=rf"config\.json: .*{message}"):
        load_script("benchmark_grasping.py").main(["--output", str(tmp_path), "--report"])
    assert len(list(tmp_path.iterdir())) == 2


def test_a_result_that_is_not_finite_is_kept_as_an_error(tmp_path, benchmark):
    """It does not stop the other trials, and leaves a file that can be read."""
    key, *rest = benchmark.arguments(TrialKey("hold", "cylinder", 0), planned_goal("cylinder"))
    record = {**grasp_trial.simulate(key, *rest), "peak_force": float("nan")}
    kept = keep_error(tmp_path, record)
    assert set(kept) == {"method", "object", "seed", "error", "traceback"}
    assert kept["error"].endswith("peak_force must be a finite number, not NaN")
    assert (tmp_path / kept["traceback"]).read_text() == kept["error"]


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
    "option",
    [["--trials", "0"], ["--jobs", "0"], ["--seed", "-1"], ["--rrd", "a", "b", "c"], ["--rrd", "a", "b"]],
)
def test_senseless_numbers_are_refused(script, tmp_path, option, capsys):
    """With the option's name."""
    with pytest.raises(SystemExit):
        script.main(arguments(tmp_path, *option))
    assert option[0] in capsys.readouterr().err


# -- one trial again


def test_one_trial_can_be_watched_and_must_come_out_the_same(script, tmp_path, capsys):
    """The recording is written and linked; code that has changed is said, another outcome is an error."""
    script.main(arguments(tmp_path))
    watch = ["--output", str(tmp_path), "--rrd", "nearest_neighbour", "cylinder", "1"]
    assert script.main(watch) == 0
    name = "rrd/nearest_neighbour-cylinder-1.rrd"
    assert (tmp_path / name).stat().st_size > 20_000
    assert f'href="{name}"' in (tmp_path / "report.html").read_text()
    with pytest.raises(UnknownNameError, match=r"finished trial 'hold cylinder 7'.*hold cylinder 0"):
        script.main(["--output", str(tmp_path), "--rrd", "hold", "cylinder", "7"])
    config = read_config(tmp_path)
    config["settings"]["code_sha256"] = "of before"
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert script.main(watch) == 0
    assert "code has changed since" in capsys.readouterr().err and read_config(tmp_path) == config
    path = tmp_path / "trials.jsonl"
    path.write_text(path.read_text().replace('"peak_height": ', '"peak_height": 1'))
    with pytest.raises(BenchmarkError, match="differs in peak_height"):
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
        tmp_path, load_scenario(text=TOO_SHORT), play, ["hold"], ["cylinder"], 1, zero_latency=True
    )
    assert zero.config["methods"]["hold"]["latency_s"] == 0 and zero.methods["hold"].latency == 0
    key, text, *rest = benchmark.arguments(TrialKey("vector_online", "cylinder", 0), planned_goal("cylinder"))
    retarget, _, human = rest
    longer = text.replace("timeout: 0.3", "timeout: 4.5")
    slow = grasp_trial.simulate(key, longer, retarget, 0.1, human)
    quick = grasp_trial.simulate(key, longer, retarget, 0.0, human)
    assert judged(slow) != judged(quick)


def test_seeds_are_paired_across_methods(benchmark):
    """One seed is one place, mass, friction and noise, whatever the method; another seed differs in each."""
    keys = benchmark.keys(["hold", "vector_online"], ["cylinder"], 2)
    assert [key.seed for key in keys] == [0, 0, 1, 1]
    human = (person_and_rest()[0], planned_goal("cylinder"))
    seen = []
    for key in keys:
        scenario = load_scenario(text=f"{{timeout: 0.4, random_seed: {key.seed}}}")
        scenario.object.name = key.object
        retarget = benchmark.methods[key.method].retarget
        drawn = make_grasp_diagram(scenario, retarget, human).placement
        glove = run_trial(scenario, retarget, human)[1]
        # The person first decides at the sample after the visual delay, and does not see before the next one
        # what the method makes of it. The arm moves without the method.
        first = round(scenario.operator.visual_delay / scenario.operator.period)
        assert not np.array_equal(glove.p_HK[first], glove.p_HK[0])
        place = drawn.X_WO.GetAsMatrix4()
        seen.append((place, drawn.mass_factor, drawn.friction_factor, glove.p_HK[: first + 1], glove.X_WH))
    for one, other in ((0, 1), (2, 3)):
        for value, again in zip(seen[one], seen[other], strict=True):
            np.testing.assert_array_equal(value, again)
    for value, of_other_seed in zip(seen[0], seen[2], strict=True):
        assert not np.array_equal(value, of_other_seed)
