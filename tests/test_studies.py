"""Studies and benchmarks start; the sweep trains what is missing and compares it with the default run."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from geort_drake.comparison.metric_table import mean
from geort_drake.errors import TrainingError, UnknownNameError
from geort_drake.retargeting.checkpoint import METRICS
from studies import sweep

ROOT = Path(__file__).resolve().parents[1]
STUDIES = {path.stem for path in (ROOT / "studies").glob("*.py")} - {"human_hand_model"}
BENCHMARKS = {path.stem for path in (ROOT / "benchmarks").glob("bench_*.py")}
PROGRAMS = [*(f"studies.{name}" for name in STUDIES), *(f"benchmarks.{name}" for name in BENCHMARKS)]


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_a_program_starts_and_explains_itself(program, capsys, monkeypatch):
    """Everything it imports exists, and its help names its options."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(program).main(["--help"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")


def test_a_sweep_compares_every_run_with_the_default_of_its_seed(tmp_path, monkeypatch):
    """A failed run leaves the others alone; the same command trains only what is missing."""
    trained = []

    def train(hand, recording, output, method, seed, *, show_progress, settings):
        trained.append(output.name)
        weight = settings.get("coverage_weight", 7.0)
        if weight == 3.5 and seed == 1:
            raise TrainingError("the loss is not finite")
        output.mkdir(parents=True)
        metrics = {**mean([]), "motion_preservation": 0.1 * weight + 0.01 * seed, "flatness": np.pi}
        (output / METRICS).write_text(json.dumps(metrics))

    monkeypatch.setattr(sweep, "train_checkpoint", train)
    command = [
        "coverage_weight=0,3.5", "--recording", "hand.npz", "--method", "geort", "--seeds", "0", "1",
        "--output", str(tmp_path),
    ]  # fmt: skip
    assert sweep.main(command) == 1
    assert len(trained) == 6
    rows = [line.strip("| ").split(" | ") for line in (tmp_path / "sweep.md").read_text("utf-8").splitlines()]
    table = {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[2:]}
    assert table["default"]["motion_preservation"] == "0.705 ± 0.007"
    assert table["coverage_weight=0.0"]["motion_preservation"] == "-0.700 ± 0.000"
    assert table["coverage_weight=3.5"]["seeds"] == "0"
    assert (tmp_path / "frontier.png").read_bytes().startswith(b"\x89PNG")
    assert sweep.main(command) == 1
    assert trained[6:] == ["geort-coverage_weight=3.5-seed1"]


def test_a_sweep_without_names_varies_every_loss_weight():
    """Each is removed, halved and doubled; an unknown setting is refused."""
    changes = list(sweep.changes_of("geort", {"steps": 9, "coverage_weight": 4.0, "pinch_weight": 1.0}, []))
    assert changes[:4] == [{}, *({"coverage_weight": value} for value in (0.0, 2.0, 8.0))]
    assert len(changes) == 7
    with pytest.raises(UnknownNameError, match=r"'nothing'.*coverage_weight"):
        list(sweep.changes_of("geort", {}, ["nothing=1"]))
