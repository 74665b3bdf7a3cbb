"""The results file of the grasp benchmark, line by line."""

import json

import pytest

from geort_drake.benchmark.records import TrialKey, TrialLog, read_records
from geort_drake.errors import BenchmarkError


def line(method="hold", thing="cylinder", seed=0) -> dict:
    """A line for the results file."""
    return {
        "method": method, "object": thing, "seed": seed, "error": "ValueError: no", "traceback": "a.txt",
    }  # fmt: skip


def result(seed=0, **changes) -> dict:
    """A line for the results file, of a trial that did not raise."""
    return {
        "method": "hold", "object": "cylinder", "seed": seed, "success": True, "outcome": "success",
        "completion_time": 4, "first_attempt": True, "attempts": 1, "simulated_time": 6.0,
        "task": "grasp", "score": 0.0, "tip_success": False, "holding": {}, "phase_times": {"REACH": 0.0},
        "phase_durations": {"REACH": 4.0}, "drops": 0, "slip": None,
        "peak_force": 1.5, "peak_height": 0.15, "operator_phase": None, "self_contact": 0.0,
        "wall_time": 2.0, **changes,
    }  # fmt: skip


def test_a_torn_last_line_is_dropped_from_the_file(tmp_path):
    """Also one that lacks nothing but its end: the trial is repeated, and the next line stands alone."""
    path = tmp_path / "trials.jsonl"
    for torn in ('{"method": "ho', json.dumps(line(seed=1))):
        path.write_text(json.dumps(line()) + "\n" + torn)
        assert read_records(path) == [line()]
        with TrialLog(path) as log:
            assert log.torn and log.records == [line()]
            log.append(line(seed=2))
        assert path.read_text() == json.dumps(line()) + "\n" + json.dumps(line(seed=2)) + "\n"


FAILED = {"success": False, "outcome": "timeout: touch", "completion_time": None, "first_attempt": False}


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ('{"method": "ho', "line 2: not a trial's result"),
        ('{"method": "hold", "object": "cylinder", "seed": 1}', "line 2: .*missing.*; repair or delete"),
        (json.dumps(result(1)) + "\n" + json.dumps(result(1)), "line 3: a second result of hold"),
        (json.dumps(result(1, slip=float("nan"))), "line 2: .*slip must be finite, not nan"),
        (
            json.dumps(result(1, outcome="thrown: lift")),
            "line 2: .*success is True, .*contradicts .*thrown",
        ),
    ],
)
def test_a_corrupt_line_is_refused_by_file_and_number(tmp_path, bad, message):
    """With what was expected and what was given, and the file stays as it is."""
    path = tmp_path / "trials.jsonl"
    content = json.dumps(line()) + "\n" + bad + "\n" + json.dumps(line(seed=2)) + "\n"
    path.write_text(content)
    for read in (TrialLog, read_records):
        with pytest.raises(BenchmarkError, match=f"trials.jsonl, {message}"):
            read(path)
    assert path.read_text() == content


@pytest.mark.parametrize("changes", [{}, FAILED, {"first_attempt": None, "attempts": None}, {"note": "x"}])
def test_every_way_to_end_is_read(tmp_path, changes):
    """Success, failure, a replay in which nobody decides; also with a field of a later version."""
    path = tmp_path / "trials.jsonl"
    path.write_text(json.dumps(result(**changes)) + "\n")
    assert read_records(path) == [result(**changes)]


def test_a_trial_that_raised_is_not_finished(tmp_path):
    """What comes of its repetition stands in its place, also where that raises again."""
    path = tmp_path / "trials.jsonl"
    with TrialLog(path) as log:
        for record in (line(), line(seed=1), result(seed=2), line(), result(seed=1)):
            log.append(record)
    with TrialLog(path) as log:
        assert log.records == [line(), result(seed=1), result(seed=2)]
        keys = [TrialKey("hold", "cylinder", seed) for seed in range(4)]
        assert log.unfinished(keys) == [keys[0], keys[3]]


def test_two_processes_do_not_write_to_one_file(tmp_path):
    """The second one is turned away as long as the first has the file open."""
    path = tmp_path / "trials.jsonl"
    with TrialLog(path), pytest.raises(BenchmarkError, match="another process is writing"):
        TrialLog(path)
    TrialLog(path).close()
