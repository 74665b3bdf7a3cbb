"""The results file of the grasp benchmark, line by line."""

import json

import pytest
from trial_records import error, trial

from geort_drake.benchmark.records import TrialLog, read_records
from geort_drake.errors import BenchmarkError


def test_a_torn_last_line_is_dropped_from_the_file(tmp_path):
    """Also one that lacks nothing but its end: the trial is repeated, and the next line stands alone."""
    path = tmp_path / "trials.jsonl"
    for torn in ('{"method": "ho', json.dumps(error(seed=1))):
        path.write_text(json.dumps(error()) + "\n" + torn)
        assert read_records(path) == [error()]
        with TrialLog(path) as log:
            assert log.torn and log.records == [error()]
            log.append(error(seed=2))
        assert path.read_text() == json.dumps(error()) + "\n" + json.dumps(error(seed=2)) + "\n"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ('{"method": "ho', "line 2: not a trial's result"),
        ('{"method": "hold", "object": "cube", "seed": 1}', "line 2: .*missing.*; repair or delete"),
        (json.dumps(trial(seed=1)) + "\n" + json.dumps(trial(seed=1)), "line 3: a second result of hold"),
        (json.dumps(trial(seed=1, slip=float("nan"))), "line 2: .*slip must be finite, not nan"),
        (
            json.dumps(trial(seed=1, outcome="thrown: lift")),
            "line 2: .*success is True, .*contradicts .*thrown",
        ),
    ],
)
def test_a_corrupt_line_is_refused_by_file_and_number(tmp_path, bad, message):
    """With what was expected and what was given, and the file stays as it is."""
    path = tmp_path / "trials.jsonl"
    content = json.dumps(error()) + "\n" + bad + "\n" + json.dumps(error(seed=2)) + "\n"
    path.write_text(content)
    for read in (TrialLog, read_records):
        with pytest.raises(BenchmarkError, match=f"trials.jsonl, {message}"):
            read(path)
    assert path.read_text() == content


@pytest.mark.parametrize(
    "changes", [{}, {"time": None}, {"first_attempt": None, "attempts": None}, {"note": "x"}]
)
def test_every_way_to_end_is_read(tmp_path, changes):
    """Success, failure, a replay in which nobody decides; also with a field of a later version."""
    path = tmp_path / "trials.jsonl"
    path.write_text(json.dumps(trial(**changes)) + "\n")
    assert read_records(path) == [trial(**changes)]


def test_two_processes_do_not_write_to_one_file(tmp_path):
    """The second one is turned away as long as the first has the file open."""
    path = tmp_path / "trials.jsonl"
    with TrialLog(path), pytest.raises(BenchmarkError, match="another process is writing"):
        TrialLog(path)
    TrialLog(path).close()
