"""Sweeps: what is run, what is not run again, what a failure does, and the tables."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from script_modules import load_script

from geort_drake.comparison import sweep as sweeping
from geort_drake.comparison.metric_table import mean
from geort_drake.comparison.pipeline import training_config
from geort_drake.comparison.sweep import SWEEP, Ground, Run, Sweep, plan, read_sweep
from geort_drake.errors import CheckpointError, GeortError, OutputError, TrainingError, UnknownNameError
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.play import synthesize_play
from geort_drake.retargeting.checkpoint import METRICS, WEIGHTS, save_checkpoint

GROUND = Ground(
    "toy",
    Path("hand.npz"),
    {
        "hand": "toy",
        "hand_sha256": "a",
        "recording_sha256": "b",
        "code_sha256": "c",
        "settings": {"steps": 7},
    },
)
RUNS = plan(["geort"], [0, 1], ["coverage_weight=0,3.5"], ["steps=7"])


def trainer(names: list[str], hand_sha256: str = "a", recording_sha256: str = "b"):
    """Stands in for training: notes the run's name and writes a whole checkpoint that has learned nothing."""

    def train(hand, recording, output, method, seed, show_progress, settings):
        names.append(Path(output).name)
        config = training_config(method, settings)
        if config.coverage_weight == 3.5 and seed == 1:
            raise TrainingError("the loss is not finite")
        hand = {
            "name": hand, "joint_names": ["j"], "finger_names": ["thumb"],
            "lower": [0], "upper": [1], "model_sha256": hand_sha256,
        }  # fmt: skip
        timings = {"recording_s": 0, "robot_data_s": 1, "fit_s": 2, "evaluation_s": 3}
        recording = {"sha256": recording_sha256}
        save_checkpoint(
            output, {"x": np.zeros(1)}, method=method, hand=hand, human_keypoints=[4],
            training={**asdict(config), "seed": seed, "device": "cpu"},
            provenance={"recording": recording, "warnings": ["no pinch"], "timings": timings},
            history=[],
            metrics={**mean([]), "motion_preservation": 0.1 * config.coverage_weight + 0.01 * seed},
        )  # fmt: skip

    return train


@pytest.fixture
def trained(monkeypatch):
    """The names of the runs that were trained."""
    names: list[str] = []
    monkeypatch.setattr(sweeping, "train_checkpoint", trainer(names))
    return names


def done(runs, ground, folder, jobs=1) -> list[dict]:
    """The records of all runs that are there after what was missing is trained."""
    sweep = Sweep(runs, ground, folder)
    names = [record["name"] for record in sweep.train(jobs)]
    assert sorted(names) == sorted(run.name for run in sweep.missing)
    return list(sweep.records.values())


def test_without_names_every_weight_is_removed_halved_and_doubled():
    """For each method those that it has; the default runs come first, with every seed."""
    runs = plan(["geort", "geort_coupled"], [3, 4])
    assert runs[0].name == "geort-default-seed3" and runs[1].name == "geort-default-seed4"
    changes = [run.change for run in runs if run.method == "geort" and run.seed == 3]
    assert changes[1:4] == [("coverage_weight", factor * 7.0) for factor in (0, 0.5, 2)]
    assert {name for name, _ in changes[1:]} == {
        "coverage_weight", "flatness_weight", "pinch_weight", "collision_weight",
    }  # fmt: skip
    coupled = {run.change[0] for run in runs if run.method == "geort_coupled" and run.change}
    assert "cross_talk_weight" in coupled and len(coupled) == 10
    assert len({run.name for run in runs}) == len(runs) == 2 * (1 + 3 * 4) + 2 * (1 + 3 * 10)


def test_the_settings_of_all_runs_are_what_weights_are_halved_from():
    """A value that is the default's is no run of its own."""
    runs = plan(["geort"], [0], common=["coverage_weight=4", "steps=7"])
    assert all(run.settings["steps"] == 7 for run in runs)
    assert [run.settings["coverage_weight"] for run in runs][:4] == [4.0, 0.0, 2.0, 8.0]
    again = plan(["geort"], [0, 0], ["coverage_weight=7,1,1", "hidden=64"])
    assert [run.change for run in again] == [None, ("coverage_weight", 1.0), ("hidden", 64)]
    assert again[2].name == "geort-hidden=64-seed0"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["none"], [0]), "unknown retargeting method 'none'.*geort_coupled"),
        ((["geort"], [0], ["cover=1"]), "setting of geort 'cover'.*coverage_weight"),
        ((["geort", "geort_coupled"], [0], ["track_weight=1"]), "setting of geort 'track_weight'"),
        ((["geort"], [0], [], ["epochs=1"]), "setting of geort 'epochs'.*steps"),
        ((["geort"], [0], ["coverage_weight=a"]), "coverage_weight.*wants float, not 'a'"),
        ((["geort"], [0], ["coverage_weight"]), "coverage_weight.*wants float, not ''"),
        ((["geort"], [0], ["coverage_weight=-1"]), "coverage_weight must be zero or positive"),
        ((["geort"], [0], ["fk=exact,neural"]), "setting fk of geort is none"),
    ],
)
def test_what_cannot_be_run_is_refused_by_name(arguments, message):
    """Before anything is trained, with the names that there are."""
    with pytest.raises(GeortError, match=message):
        plan(*arguments)
    with pytest.raises(UnknownNameError):
        plan(["geort"], [0], ["nothing=1"])


def test_a_second_run_trains_only_what_failed(trained, tmp_path):
    """One failure leaves the other runs alone and is recorded; a rerun tries it again, and nothing else."""
    records = done(RUNS, GROUND, tmp_path)
    assert trained == [run.name for run in RUNS] and len(records) == 6
    (failed,) = (record for record in records if "error" in record)
    assert failed["name"] == "geort-coverage_weight=3.5-seed1"
    assert failed["error"] == "TrainingError: the loss is not finite" and "metrics" not in failed
    content = read_sweep(tmp_path)
    assert content["runs"] == records
    assert content["ground"] == {"recording": "hand.npz", **GROUND.facts}
    first = content["runs"][0]
    assert (first["changed"], first["seconds"], first["warnings"]) == (None, 6, ["no pinch"])
    assert first["settings"]["steps"] == 7 and first["metrics"]["motion_preservation"] == pytest.approx(0.7)
    trained.clear()
    again = done(RUNS, GROUND, tmp_path)
    assert trained == [failed["name"]]
    assert sorted(again, key=lambda r: r["name"]) == sorted(records, key=lambda r: r["name"])


def test_a_damaged_run_is_trained_again(trained, tmp_path):
    """Altered weights, or no metrics; whatever is whole stays."""
    runs = RUNS[:4]
    done(runs, GROUND, tmp_path)
    (tmp_path / "runs" / runs[1].name / WEIGHTS).write_bytes(b"torn")
    (tmp_path / "runs" / runs[2].name / METRICS).unlink()
    trained.clear()
    assert len(done(runs, GROUND, tmp_path)) == 4
    assert trained == [runs[1].name, runs[2].name]


def test_other_runs_join_a_sweep(trained, tmp_path):
    """What an earlier command trained stays in the table."""
    done(RUNS[:2], GROUND, tmp_path)
    done(RUNS[2:4], GROUND, tmp_path)
    assert [record["name"] for record in read_sweep(tmp_path)["runs"]] == [run.name for run in RUNS[:4]]


@pytest.mark.parametrize("fact", ["hand_sha256", "recording_sha256", "code_sha256", "settings"])
def test_a_folder_holds_a_sweep_on_one_ground(trained, tmp_path, fact):
    """Another hand, recording, code or common setting is refused by name, and nothing is changed."""
    done(RUNS[:1], GROUND, tmp_path)
    before = (tmp_path / SWEEP).read_bytes()
    other = Ground(GROUND.hand, GROUND.recording, {**GROUND.facts, fact: "other"})
    with pytest.raises(OutputError, match=f"differs in {fact}"):
        done(RUNS[:1], other, tmp_path)
    assert (tmp_path / SWEEP).read_bytes() == before and len(trained) == 1


def test_another_checkpoint_in_a_runs_place_is_refused(trained, tmp_path):
    """It is neither taken for the run nor replaced."""
    done(RUNS[:1], GROUND, tmp_path)
    (tmp_path / "runs" / RUNS[0].name).rename(tmp_path / "runs" / RUNS[2].name)
    with pytest.raises(CheckpointError, match=r"another run: coverage_weight differ"):
        done(RUNS[2:3], GROUND, tmp_path)


@pytest.mark.parametrize("content", ["{", "[]", '{"runs": []}'])
def test_a_damaged_table_is_refused(trained, tmp_path, content):
    """Also runs without a table: what they were trained with is not known."""
    done(RUNS[:1], GROUND, tmp_path)
    (tmp_path / SWEEP).write_text(content, encoding="utf-8")
    with pytest.raises(OutputError, match=r"sweep\.json: is not the table of a sweep"):
        done(RUNS[:1], GROUND, tmp_path)
    (tmp_path / SWEEP).unlink()
    with pytest.raises(OutputError, match=r"runs holds runs without sweep\.json"):
        done(RUNS[:1], GROUND, tmp_path)


def test_processes_of_their_own_record_their_failures(tmp_path):
    """Two workers: a recording that is not there is every run's error, and the table is whole."""
    ground = Ground("allegro_right", tmp_path / "none.npz", GROUND.facts)
    records = done([Run("geort", seed) for seed in range(3)], ground, tmp_path / "sweep", jobs=2)
    assert sorted(record["seed"] for record in records) == [0, 1, 2]
    assert all(record["error"].startswith("RecordingError: ") for record in records)
    assert len(json.loads((tmp_path / "sweep" / SWEEP).read_text("utf-8"))["runs"]) == 3


def test_the_script_writes_table_and_plot_and_goes_on(monkeypatch, tmp_path, capsys):
    """A failure ends with code 1 after everything else is written; the same command tries only it again."""
    play = synthesize_play(0, duration_s=20.0, rate_hz=30.0)
    play.save(tmp_path / "hand.npz")
    names: list[str] = []
    train = trainer(names, HandModel(load_hand("allegro_right")).digest, play.digest)
    monkeypatch.setattr(sweeping, "train_checkpoint", train)
    command = [
        "--recording", str(tmp_path / "hand.npz"), "--methods", "geort", "--sweep", "coverage_weight=0,3.5",
        "--seeds", "0", "1", "--set", "steps=7", "--output", str(tmp_path / "sweep"),
    ]  # fmt: skip
    assert load_script("evaluate_retargeting.py").main(command) == 1
    files = [tmp_path / "sweep" / name for name in ("sweep.json", "ablation.md", "frontier.png")]
    said = capsys.readouterr()
    assert said.out == ""
    assert f"Figures: {files[0]}\n" in said.err and f"Tables: {files[1]}\n" in said.err
    assert f"Plot: {files[2]}\n" in said.err
    assert "geort-coverage_weight=3.5-seed1: TrainingError: the loss is not finite" in said.err
    assert "| `coverage_weight` = 0 | 0, 1 | -0.700 ± 0.000 |" in files[1].read_text("utf-8")
    assert files[2].read_bytes().startswith(b"\x89PNG")
    assert read_sweep(tmp_path / "sweep")["ground"]["settings"] == {"steps": 7}
    assert len(names) == 6
    assert load_script("evaluate_retargeting.py").main(command) == 1
    assert names[6:] == ["geort-coverage_weight=3.5-seed1"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sweep", "--methods", "geort"], "--sweep needs --methods and --output"),
        (["--sweep", "--output", "out"], "--sweep needs --methods and --output"),
        (["--sweep", "--methods", "geort", "--output", "out", "--json"], "--json: not with --sweep"),
        (["--output", "out", "--jobs", "2"], "--output, --jobs: only with --sweep"),
        (["--sweep", "--methods", "geort", "--output", "out", "--jobs", "0"], "--jobs: must be at least 1"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arguments, message, capsys):
    """Before anything is read."""
    with pytest.raises(SystemExit):
        load_script("evaluate_retargeting.py").main(["--recording", "none.npy", *arguments])
    assert message in capsys.readouterr().err
